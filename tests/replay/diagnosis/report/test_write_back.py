"""Effects found are written into a phone file; a simulation with it matches the recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from stillcal.replay.diagnosis.diagnose import bins_of, diagnosis_of
from stillcal.replay.diagnosis.judge_phone import judge_phone
from stillcal.replay.diagnosis.report.comparison import (
    Compared,
    compare,
    holm_corrected,
    side_of,
    stamps_measured,
)
from stillcal.replay.diagnosis.report.inputs import Case, case_of, resimulate_before_and_after
from stillcal.replay.diagnosis.report.phone_file import phone_text
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.phone import load_phone
from tests.support.report_days import THERMAL, TONE, phone_with, recorded

Maker = Callable[..., Recording]


@pytest.mark.slow
@pytest.mark.parametrize("effect", [THERMAL, TONE], ids=lambda e: e["name"])
def test_a_recording_with_the_written_phone_is_accepted_and_one_without_its_terms_is_not(
    effect: dict[str, object], case_with: Callable[..., Case], tmp_path: Path
) -> None:
    case = case_with(effect)
    assert [m.finding.effect for m in case.mapped] == [effect["name"]]
    (tmp_path / "better.toml").write_text(phone_text(case.phone(), case.mapped, "r"))
    better = load_phone(tmp_path / "better.toml")
    side = case.side()
    with_it = recorded(better, 17, claims=better)
    without = recorded(msgspec.structs.replace(better, effects=()), 17, claims=better)
    outcome = [compare(side, side_of(r, bins_of(r), case.gravity)) for r in (with_it, without)]
    assert outcome[0].accepted, outcome[0].tests[:3]
    assert not outcome[1].accepted


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


def test_before_and_after_on_the_recordings_own_day(case_with: Callable[..., Case]) -> None:
    before, after = resimulate_before_and_after(case_with(THERMAL))
    assert not before.comparison.accepted
    assert before.comparison.tests[0].statistic == "accel_bias_temperature"
    assert after.comparison.accepted, after.comparison.tests[:3]


@pytest.mark.slow
def test_what_has_no_place_in_a_phone_file_is_a_comment(recording: Maker) -> None:
    hidden = {"name": "accel_thermal_hysteresis", "coefficient": [0.03, 0.03, 0.03], "tau_s": 300.0}
    real = recording(hidden)
    case = case_of(real, diagnosis_of(real, "a\nname"))
    unnamed = [m for m in case.mapped if m.effect is None]
    text = phone_text(case.phone(), case.mapped, case.diagnosis.recording)
    assert unnamed
    assert text.count("# Not in this file: unknown") == len(unnamed)
    assert text.startswith("# A phone with the errors of a name, measured")


@pytest.mark.slow
def test_what_the_judged_phone_has_is_no_news_and_what_it_has_wrong_is(recording: Maker) -> None:
    real = recording(THERMAL)
    right = judge_phone(real, "r", phone_with(THERMAL))
    assert right.diagnosis.findings == []
    assert [k["effect"] for k in right.already_simulated] == ["accel_bias_temperature"]
    wrong = judge_phone(real, "r", phone_with(THERMAL | {"slope": [0.006, 0.004, -0.005]}))
    (left,) = wrong.diagnosis.findings
    assert left.effect == "accel_bias_temperature" and left.axes == ["y"]
    slope = left.parameters["slope"].value
    assert isinstance(slope, list)
    np.testing.assert_allclose(slope, [0.0, -0.004, 0.0], atol=4e-4)
    merged = case_of(real, wrong.diagnosis, wrong.known()).phone()
    total = sum(np.asarray(e.slope) for e in merged.effects if e.name == "accel_bias_temperature")  # type: ignore[union-attr]
    np.testing.assert_allclose(total, THERMAL["slope"], atol=4e-4)
    absent = judge_phone(recording(), "r", phone_with(TONE))
    assert [k["effect"] for k in absent.only_simulated] == ["vibration_tone"]


def test_p_values_are_corrected_by_holm() -> None:
    found = holm_corrected([Compared("s", str(p), 0.0, 0.0, "1", p) for p in (0.5, 0.004, 0.001)])
    assert [t.p_corrected for t in found.tests] == pytest.approx([0.003, 0.008, 0.5])
    assert not found.accepted


def test_the_clock_of_the_written_phone_scatters_and_loses_as_the_recording_does() -> None:
    """Less than a finding takes: half a per cent of the samples, stamps by 0.3 ms of 40."""
    uneven = msgspec.structs.replace(phone_with().clock, jitter_s=3e-4, drop_fraction=0.005)
    real = recorded(msgspec.structs.replace(phone_with(), clock=uneven), 3)
    scatter, missing = stamps_measured(real.accelerometer)
    assert scatter == pytest.approx(3e-4, rel=0.05)
    assert missing == pytest.approx(0.005, rel=0.3)
    case = case_of(real, diagnosis_of(real, "r"))
    told = {m.finding.effect for m in case.mapped}
    clock = case.phone().clock
    assert clock.jitter_s == (0.0 if "timestamp_jitter" in told else pytest.approx(scatter, rel=1e-3))
    assert clock.drop_fraction == (0.0 if "dropped_samples" in told else pytest.approx(missing, rel=1e-2))
