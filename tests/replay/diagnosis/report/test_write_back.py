"""Effects found are written into a phone file; a simulation with it matches the recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.direct import stamps_as_compared
from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter, Where
from stillcal.calib_core.streams.resample import interpolate
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.built_in import judge_built_in
from stillcal.replay.diagnosis.given_simulation import answered
from stillcal.replay.diagnosis.judged import examined, named
from stillcal.replay.diagnosis.phone.case import Case, case_of
from stillcal.replay.diagnosis.phone.phone_effects import map_findings
from stillcal.replay.diagnosis.phone.phone_file import phone_text, sample_rate
from stillcal.replay.diagnosis.phone.phone_simulation import judge_phone
from stillcal.replay.diagnosis.sample_changes import held_at
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.phone import load_phone
from stillcal.replay.phone.settings import per_axis
from tests.replay.diagnosis.report.conftest import diagnosed
from tests.support.diagnosis.turned_pairs import RATE, low_passed, turned
from tests.support.report_days import THERMAL, phone_with, recorded

Maker = Callable[..., Recording]


@pytest.mark.slow
def test_a_recording_with_the_written_phone_is_accepted_and_one_without_its_terms_is_not(
    case_with: Callable[..., Case], tmp_path: Path
) -> None:
    case = case_with(THERMAL)
    assert [m.finding.effect for m in case.mapped] == [THERMAL["name"]]
    (tmp_path / "better.toml").write_text(phone_text(case.phone(), case.mapped, "r"))
    better = load_phone(tmp_path / "better.toml")
    with_it = recorded(better, 17, claims=better)
    without = recorded(msgspec.structs.replace(better, effects=()), 17, claims=better)
    exam, *played = (
        examined(replace(r, name="sim.csv", gyroscope=None)) for r in (case.recording, with_it, without)
    )  # what is written is the accelerometer's
    names = ("real.csv", "sim.csv")
    right, wrong = (answered(compare(exam, one, names), None, exam, one, names) for one in played)
    assert right["verdict"] == "match", right["findings"]
    assert [(f["effect"], f["relation"]) for f in wrong["findings"]] == [(THERMAL["name"], "lacking")]


@pytest.mark.slow
def test_the_baseline_is_that_of_the_phone(case_with: Callable[..., Case]) -> None:
    case = case_with(THERMAL)
    found, true = case.phone(), phone_with()
    warmest = np.asarray(THERMAL["slope"]) * (case.conditions.reference_c - true.heat.reference_c)
    np.testing.assert_allclose(found.accel.bias, np.asarray(true.accel.bias) + warmest, atol=0.02)
    np.testing.assert_allclose(found.accel.scale, true.accel.scale, atol=0.002)
    assert found.gyro is not None and true.gyro is not None
    np.testing.assert_allclose(found.gyro.bias, true.gyro.bias, atol=3e-4)
    np.testing.assert_allclose(found.accel.noise.white, true.accel.noise.white, rtol=0.05)
    assert found.accel.lsb == pytest.approx(true.accel.lsb, rel=1e-4)
    assert found.accel.rate_hz == pytest.approx(true.accel.rate_hz, rel=1e-4)


@pytest.mark.slow
def test_the_phone_played_again_has_the_recordings_clock_gaps_and_limit() -> None:
    """The motion is known by a clock that is fast and up to the limit: neither may count twice."""
    phone = phone_with(
        {"name": "clock_skew", "relative": 0.008},
        {"name": "gyro_saturation", "limit": 1.5},
        {"name": "dropped_samples", "fraction": 0.05},
    )
    answer = judge_built_in(named(recorded(phone, 5), "real.csv")).answer
    assert {f["effect"] for f in answer["findings"]} == {"clock_skew", "gyro_saturation", "dropped_samples"}
    assert answer["verdict"] == "identified", answer["fit"]


@pytest.mark.slow
def test_what_comes_at_a_moment_is_found_again_in_the_corrected_simulation() -> None:
    """Beside what it was found beside: the slope alone would be steps too."""
    step = {"name": "accel_bias_step", "step": [0.05, 0.0, -0.05], "at_s": 1000.0}
    answer = judge_built_in(named(recorded(phone_with(THERMAL, step), 5), "real.csv")).answer
    assert {f["effect"] for f in answer["findings"]} == {"accel_bias_step", THERMAL["name"]}
    assert answer["verdict"] == "identified", answer["fit"]


@pytest.mark.slow
def test_what_has_no_place_in_a_phone_file_is_a_comment(recording: Maker) -> None:
    hidden = {"name": "accel_thermal_hysteresis", "coefficient": [0.03, 0.03, 0.03], "tau_s": 300.0}
    case = diagnosed(replace(recording(hidden), gyroscope=None))
    unnamed = [m for m in case.mapped if m.effect is None]
    text = phone_text(case.phone(), case.mapped, "a\nname")
    assert unnamed
    assert text.count("# Not in this file: unknown") == len(unnamed)
    assert text.startswith("# A phone with the errors of a name, measured")


@pytest.mark.slow
def test_a_phone_file_is_judged_as_any_simulation_is() -> None:
    real = named(recorded(phone_with(THERMAL), 5, part_s=200.0), "real.csv")
    right = judge_phone(real, phone_with(THERMAL), "phone.toml").answer
    assert right["verdict"] == "match", right["findings"]
    assert "accel_bias_temperature" in {a["effect"] for a in right["agreed"]}


@pytest.mark.slow
def test_a_phone_with_wrong_constants_and_slow_noise_is_told_so(recording: Maker) -> None:
    """Biases are 1.2 m/s^2 off, scales all 1, and the 1/f noise is twenty times too strong."""
    sound = phone_with()
    flicker = tuple(20.0 * float(f) for f in per_axis(sound.accel.noise.flicker))
    accel = msgspec.structs.replace(
        sound.accel,
        bias=tuple(b + 1.2 for b in sound.accel.bias),
        scale=tuple(map(tuple, np.eye(3).tolist())),
        noise=msgspec.structs.replace(sound.accel.noise, flicker=flicker),
    )
    off = msgspec.structs.replace(sound, accel=accel)
    real = replace(named(recording(), "real.csv"), gyroscope=None)
    findings = judge_phone(real, off, "phone.toml").answer["findings"]
    told = {f["effect"]: f for f in findings}
    assert {"accel_bias", "accel_scale", "accel_slow_noise"} <= set(told)
    np.testing.assert_allclose(told["accel_bias"]["difference"]["bias"]["value"], [-1.2] * 3, atol=0.02)
    assert told["accel_slow_noise"]["relation"] == "too_large"


def test_what_a_clock_cannot_be_is_not_in_the_phone_file(case_with: Callable[..., Case]) -> None:
    """A clock that loses three quarters of the time: no phone has one, and the file is still made."""
    case = case_with(THERMAL)
    where = Where(0.0, 1.0, (0.0, 1.0), "time stamps")
    slow = Finding(
        "clock_skew",
        "timing",
        [],
        where,
        {"relative": Parameter(-0.75, None, "1")},
        Evidence(9.0),
        [],
        "slow",
    )
    (mapped,) = map_findings([slow], case.bins, case.conditions)
    assert mapped.effect is None and "must be between" in mapped.why


@pytest.mark.slow
def test_the_clock_of_the_written_phone_scatters_loses_and_stalls_as_the_recording_does() -> None:
    """Less than a finding takes: half a per cent of the samples, stamps by 0.3 ms of 40."""
    uneven = msgspec.structs.replace(
        phone_with().clock, jitter_s=3e-4, drop_fraction=0.005, burst_fraction=0.02
    )
    real = recorded(msgspec.structs.replace(phone_with(), clock=uneven), 3)
    seen = stamps_as_compared(real.accelerometer)
    assert sample_rate(real.accelerometer) == pytest.approx(25.0, rel=1e-4), (
        "the samples that are missing count once"
    )
    assert seen.jitter_s == pytest.approx(3e-4, rel=0.05)
    assert seen.missing == pytest.approx(0.005, rel=0.3)
    assert seen.bursts == pytest.approx(0.02, rel=0.3)
    case = diagnosed(real)
    told = {m.finding.effect for m in case.mapped}
    clock = case.phone().clock
    assert clock.jitter_s == (0.0 if "timestamp_jitter" in told else pytest.approx(seen.jitter_s, rel=1e-3))
    assert clock.drop_fraction == (
        0.0 if "dropped_samples" in told else pytest.approx(seen.missing, rel=1e-2)
    )
    assert clock.burst_fraction == (0.0 if "arrival_bursts" in told else pytest.approx(seen.bursts, rel=1e-2))


def test_the_phone_has_the_low_pass_that_sound_phones_have_too() -> None:
    """On both sensors it is no finding, and what is simulated without it would differ all the same."""
    made = turned(1, turns=8)
    assert made.gyroscope is not None
    made = replace(
        made,
        accelerometer=low_passed(made.accelerometer, 0.2),
        gyroscope=low_passed(made.gyroscope, 0.2),
    )
    exam = examined(made, sought=())
    phone = case_of(made, exam, compare_with_ideal(exam)).phone()
    assert phone.gyro is not None
    for sensor in (phone.accel, phone.gyro):
        assert sensor.cutoff_hz == pytest.approx(0.2 * RATE, rel=0.15)
    assert case_of(made, exam, Comparison()).cutoffs.keys() == {"accel", "gyro"}
    plain = examined(turned(1, turns=8), sought=())
    assert case_of(made, plain, Comparison()).cutoffs == {}


def test_the_phone_holds_as_many_samples_as_the_recording_and_its_motion_none() -> None:
    """One in thirty is within what sound phones hold; played without them, it differed by 300 decades."""
    whole = turned(1, turns=8)
    assert whole.gyroscope is not None
    true = whole.gyroscope.xyz
    again = np.random.default_rng(4).random(len(whole.gyroscope)) < 0.03
    accel, gyro = (held_at(samples, again) for samples in (whole.accelerometer, whole.gyroscope))
    made = replace(whole, accelerometer=accel, gyroscope=gyro)
    exam = examined(made, sought=())
    case = case_of(made, exam, compare_with_ideal(exam))
    phone = case.phone()
    assert phone.gyro is not None and not case.effects
    for settings in (phone.accel, phone.gyro):
        assert settings.held_fraction == pytest.approx(0.03, rel=0.2)
    fresh = msgspec.structs.replace(phone.gyro, held_fraction=0.0)
    played = case.played(msgspec.structs.replace(phone, gyro=fresh)).gyroscope
    assert played is not None

    def off(samples: Samples) -> float:
        missed = interpolate(gyro.t, samples.t, samples.xyz) - true
        return float(np.sqrt(np.mean(missed[again] ** 2)))

    assert off(played) < 0.2 * off(gyro)


@pytest.mark.parametrize("sensor", ["accelerometer", "gyroscope"])
def test_what_a_low_pass_delayed_is_not_delayed_by_it_again(sensor: str) -> None:
    made = turned(1, turns=8)
    made = replace(made, **{sensor: low_passed(getattr(made, sensor), 0.1)})
    exam = examined(made, sought=())
    case = case_of(made, exam, compare_with_ideal(exam))
    read, again = (getattr(one, sensor) for one in (made, case.played(case.phone())))
    slope = np.gradient(read.xyz, read.t, axis=0)
    played = np.stack([np.interp(read.t, again.t, axis) for axis in again.xyz.T], axis=1)
    late = -float((slope * (played - read.xyz)).sum() / (slope**2).sum())
    assert abs(late) < 0.01, "of 0.08 s that the filter delays"


def test_a_low_pass_of_another_order_than_the_phones_leaves_no_delay_between_the_sensors() -> None:
    """Of the fourth order it delays twice as much as the phone's own of that cutoff."""
    made = turned(1, turns=24)
    made = replace(made, accelerometer=low_passed(made.accelerometer, 0.1, 4))
    exam = examined(made, sought=())
    case = case_of(made, exam, compare_with_ideal(exam))
    assert case.orders == {"accel": 4}
    played = examined(case.played(case.phone()), sought=())
    assert played.delay is not None and exam.delay is not None
    assert abs(played.delay.value - exam.delay.value) < 0.015, "of 0.08 s between the two orders"


@pytest.mark.slow
def test_the_gyroscopes_scale_in_the_phone_file_is_that_beside_its_nonlinearity() -> None:
    """The turns tell both: fitted without the nonlinearity, the scale held a part of it, 0.5 % here."""
    scale, quadratic = np.array([1.006, 0.996, 1.003]), np.array([0.0, 2e-2, 0.0])

    def flaw(force: Array, rate: Array) -> tuple[Array, Array]:
        return force, rate * scale + quadratic * rate**2

    case = diagnosed(turned(2, flaw, turns=40, motion=1))
    assert [m.finding.effect for m in case.mapped] == ["gyro_nonlinearity"]
    phone = case.phone()
    assert phone.gyro is not None
    # Between recordings of three motions it scatters by 5e-4; this is three times as much.
    np.testing.assert_allclose(np.diag(phone.gyro.scale), scale, atol=1.5e-3)
