"""Several lines of one sensor, each a finding by itself, and strong ones that are none beside them."""

from __future__ import annotations

import re
import tracemalloc
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt
from scipy.special import ive

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis import stream
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import direct_checks
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.noise.lines import spectral_line
from stillcal.calib_core.diagnosis.noise.lines.intermittent_line import scaled_bessel
from stillcal.calib_core.diagnosis.noise.lines.line import COMES_AND_GOES, is_line, middle_hz
from stillcal.calib_core.diagnosis.noise.lines.line_put_in import would_show
from stillcal.calib_core.diagnosis.noise.lines.line_spectrum import faint_lines
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import AtRest, tones
from stillcal.calib_core.diagnosis.noise.lines.steady_period import steady_period
from stillcal.calib_core.diagnosis.noise.lines.steady_segments import Places
from stillcal.calib_core.streams.samples import Samples, Sensor

T = np.arange(0.0, 600.0, 0.01)
NOISE = 0.01


def lying(added: Array, seed: int = 0, sensor: Sensor = Sensor.ACCELEROMETER) -> Samples:
    """Return ten minutes on a table; added: (n,) along z."""
    xyz = np.random.default_rng(seed).normal(0.0, NOISE, (T.size, 3))
    xyz[:, 2] += added + (9.81 if sensor is Sensor.ACCELEROMETER else 0.0)
    return Samples(sensor, frozen(T), frozen(xyz))


def humming(lines: Mapping[float, float]) -> Array:
    """Return sines (n,) by frequency, Hz, and amplitude."""
    return np.asarray(sum(a * np.sin(2.0 * np.pi * f * T) for f, a in lines.items()))


def heard(added: Array, seed: int = 0) -> list[float]:
    """Return the frequencies of the lines found, Hz."""
    found = tones(lying(added, seed), "accel")
    return sorted(round(float(np.mean(f.where.band_hz)), 1) for f in found)


@pytest.mark.parametrize(
    "lines",
    [
        {17.3: 0.004, 31.7: 0.004},
        {17.3: 0.004, 31.7: 0.02, 40.1: 0.002},
        {21.6: 0.003, 23.0: 0.003},  # the sidebands of a modulation
        {21.6: 0.003, 22.1: 0.003},  # in each other's neighbourhood
        {17.3: 1.0, 31.7: 0.004},  # 48 dB apart: the strong one's leakage would drown the other
        {12.4: 0.004, 24.8: 0.001},  # faint beside a plain one: only long stretches show it
    ],
)
def test_each_of_several_lines_is_found_with_its_own_frequency_and_amplitude(
    lines: Mapping[float, float],
) -> None:
    found = [
        (round(float(np.mean(f.where.band_hz)), 1), f.parameters["amplitude"].value[2])  # type: ignore[index]
        for f in tones(lying(humming(lines)), "accel")
    ]
    assert sorted(frequency for frequency, _ in found) == sorted(lines), "each once"
    assert dict(found) == pytest.approx(lines, rel=0.1)


def test_the_bessel_function_from_a_table_is_that_of_its_order() -> None:
    x = np.geomspace(1e-6, 1e8, 300)
    assert np.allclose(scaled_bessel(x), ive(2, x), rtol=1e-12, atol=0.0)
    assert scaled_bessel(np.zeros(1)) == 0.0


def test_of_faint_lines_of_40_nats_most_are_found() -> None:
    """By the matched filter in white noise: a^2 n / (4 sigma^2), of which the search costs some 22."""
    n = 20000
    line = humming({17.3: 2.0 * NOISE * float(np.sqrt(40.0 / n))})
    found = [[round(middle_hz(f), 1) for f in tones(lying(line, seed)[:n], "accel")] for seed in range(8)]
    assert found.count([17.3]) >= 6


@pytest.mark.parametrize("amplitude", [0.004, 0.03, 1.0])
def test_one_line_is_one(amplitude: float) -> None:
    """What is left of it, its leakage, and what breathes with it are no further lines."""
    breathing = humming({17.3: amplitude}) * (1.0 + 0.2 * np.sin(2.0 * np.pi * T / 97.0))
    assert heard(breathing) == [17.3]


def on_and_off(on: float, off: float) -> Array:
    """Return 1 for `on` s and 0 for `off` s, again and again."""
    return np.asarray((T % (on + off) < on).astype(np.float64))


@pytest.mark.parametrize(
    ("on", "off", "amplitude"),
    [
        (60.0, 40.0, 0.03),
        (60.0, 40.0, 0.004),
        (10.0, 10.0, 0.01),
        (40.0, 160.0, 0.1),  # spells each too short for a line by itself
    ],
)
def test_a_vibration_that_comes_and_goes_has_no_name(on: float, off: float, amplitude: float) -> None:
    """Stated are its frequency, the amplitude while it is there, and how much of the time that is."""
    found = tones(lying(humming({30.0: amplitude}) * on_and_off(on, off)), "accel")
    assert [(f.effect, f.where.driver) for f in found] == [("unknown", COMES_AND_GOES)]
    (frequency, size, fraction) = (found[0].parameters[n] for n in ("frequency", "amplitude", "fraction"))
    assert frequency.value == pytest.approx(30.0, abs=0.01)
    assert size.value[2] == pytest.approx(amplitude, rel=0.1)  # type: ignore[index]
    assert fraction.value == pytest.approx(on / (on + off), abs=0.05)


@pytest.mark.parametrize("amplitude", [0.0015, 0.002, 0.004, 0.03])
@pytest.mark.parametrize("span", [(0.0, 600.0), (100.0, 450.0)])
def test_a_steady_vibration_and_one_for_a_while_keep_their_name(
    amplitude: float, span: tuple[float, float]
) -> None:
    there = ((span[0] <= T) & (span[1] > T)) * (1.0 + 0.2 * np.sin(2.0 * np.pi * T / 97.0))
    for seed in range(3):
        found = tones(lying(humming({30.0: amplitude}) * there, seed), "accel")
        assert all(f.effect == "vibration_tone" for f in found)
        assert found or amplitude < 0.004, "a faint one may be missed"


def test_the_text_says_how_long_a_vibration_lasts() -> None:
    (brief,) = tones(lying(humming({30.0: 0.02}) * (T < 300.0)), "accel")
    (always,) = tones(lying(humming({30.0: 0.02})), "accel")
    assert brief.where.t_end == pytest.approx(300.0, abs=60.0)
    assert brief.statement.startswith(f"From 0 to {brief.where.t_end:.0f} s: vibration at 30.00 Hz")
    assert always.statement.startswith("Vibration at 30.00 Hz")


def test_the_ends_of_strong_spells_make_no_other_lines() -> None:
    """Five minutes of twenty, 50 times the noise, in rests of 58 s: few stretches have power off the line."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 3600.0, 0.04)
    in_turn = t % 60.0 - 58.0
    xyz = rng.normal(0.0, NOISE, (t.size, 3))
    xyz[:, 0] += np.where(in_turn >= 0.0, 5.0 * np.sin(np.pi * in_turn / 2.0), 0.0)
    xyz[:, 2] += 9.81 + 0.5 * np.sin(2.0 * np.pi * 8.4 * t) * (t % 1200.0 < 300.0)
    found = tones(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), "accel")
    assert [(f.where.driver, round(middle_hz(f), 1)) for f in found] == [(COMES_AND_GOES, 8.4)]


@pytest.mark.parametrize(("rest", "spell"), [(36.0, 6.0), (33.0, 10.0)])
def test_a_motor_in_short_spells_makes_no_other_lines(rest: float, spell: float) -> None:
    """It runs in every 40 s of a phone moved again and again: lines 2 to 6 Hz beside it were stated."""
    rng, t = np.random.default_rng(2), np.arange(0.0, 675.0, 1.0 / 208.0)
    begins = np.concatenate([[0.0], np.cumsum(rng.uniform(rest - 10.0, rest + 10.0, 60))])
    moved = t - begins[np.searchsorted(begins[1:], t)] < 5.0
    xyz = rng.normal([0.0, 0.0, 9.81], 0.008, (t.size, 3))
    xyz[:, 0] += np.where(moved, 5.0 * np.sin(0.4 * np.pi * t), 0.0)
    motor = 0.45 * np.sin(2.0 * np.pi * 62.0 * t) * (t % 40.0 < spell)
    xyz += motor[:, None] * [0.3, 0.0, 1.0]
    found = tones(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), "accel")
    assert [(f.where.driver, round(middle_hz(f), 1)) for f in found] == [(COMES_AND_GOES, 62.0)]


@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e9])
def test_silence_has_no_lines_nor_has_noise_of_any_size(scale: float) -> None:
    assert faint_lines(np.random.default_rng(2).normal(0.0, scale, 6000), 1.0).max() < 20.0


def test_a_single_pause_of_a_long_vibration_is_told() -> None:
    pause = (T < 250.0) | (T > 330.0)
    assert [f.effect for f in tones(lying(humming({30.0: 0.01}) * pause), "accel")] == ["unknown"]


def test_the_three_surest_are_stated() -> None:
    assert heard(humming({11.0: 0.02, 17.3: 0.004, 31.7: 0.008, 40.1: 0.016})) == [11.0, 31.7, 40.1]


@pytest.mark.parametrize("steady", [True, False])
def test_a_brief_or_broad_strong_one_hides_no_steady_one(*, steady: bool) -> None:
    rng = np.random.default_rng(3)
    brief = 0.2 * np.sin(2.0 * np.pi * 11.0 * T) * (T < 50.0)
    broad = 0.1 * np.sin(2.0 * np.pi * 20.0 * T + np.cumsum(rng.normal(0.0, 0.2, T.size)))
    line = humming({31.7: 0.004}) if steady else np.zeros(T.size)
    for strong, own in ((brief, [11.0]), (broad, [])):
        assert heard(strong + line) == own + ([31.7] if steady else [])


@pytest.mark.parametrize(("width", "lines"), [(0.0, [11.0]), (0.5, [])])
def test_a_vibration_of_half_a_minute_is_told_with_its_time_and_a_hand_is_none(
    width: float, lines: list[float]
) -> None:
    """A hand trembles at frequencies `width` Hz apart, at a phase that it soon forgets."""
    wander = np.cumsum(np.random.default_rng(5).normal(0.0, np.sqrt(2.0 * np.pi * width * 0.01), T.size))
    there = (T > 200.0) & (T < 230.0)
    found = tones(lying(0.05 * np.sin(2.0 * np.pi * 11.0 * T + wander) * there), "accel")
    assert [round(middle_hz(f), 1) for f in found] == lines
    for line in found:
        assert line.effect == "vibration_tone" and line.axes == ["z"]
        assert (line.where.t_start, line.where.t_end) == pytest.approx((200.0, 230.0), abs=2.0)
        assert line.parameters["amplitude"].value[2] == pytest.approx(0.05, rel=0.03)  # type: ignore[index]


@pytest.mark.parametrize("steady", [True, False])
def test_overtones_of_a_heart_are_no_lines_and_hide_none(*, steady: bool) -> None:
    """Nineteen overtones of 1.1 Hz, each weaker than the one before, as of a watch on a wrist."""
    beats = humming({1.1 * n: 0.03 / n for n in range(1, 20)})
    assert heard(beats + (humming({31.7: 0.006}) if steady else 0.0)) == ([31.7] if steady else [])


def test_a_line_that_both_sensors_feel_is_the_forces_alone() -> None:
    force = lying(humming({17.3: 0.004, 31.7: 0.004}))
    rate = lying(humming({31.7: 0.003, 40.1: 0.003, 12.4: 0.003}), 1, Sensor.GYROSCOPE)
    found = [s.finding for s in examine(force, rate, sought=()).statements]
    by_sensor = {
        s: sorted(
            round(float(np.mean(f.where.band_hz)), 1)
            for f in found
            if (f.effect, f.sensor) == ("vibration_tone", s)
        )
        for s in ("accel", "gyro")
    }
    assert by_sensor == {"accel": [17.3, 31.7], "gyro": [12.4, 40.1]}
    remarks = {round(middle_hz(f), 1): f.remark for f in found if f.sensor == "accel"}
    assert re.search(r"The gyroscope has it too, amplitude z 0\.00\d+ rad/s\.", remarks[31.7])
    one = next(f for f in found if f.remark == remarks[31.7])
    (told,) = stream._without_echoes([replace(one, remark="", echoes=()), *one.echoes])
    assert told.remark.startswith("The gyroscope"), "no blank before the only sentence"
    assert "gyroscope" not in remarks[17.3]


def test_every_axis_that_has_the_line_is_told_however_weak_beside_the_others() -> None:
    samples = lying(humming({17.3: 0.1}))
    xyz = samples.xyz.copy()
    xyz[:, 1] += humming({17.3: 0.01})
    (found,) = tones(Samples(samples.sensor, T, frozen(xyz)), "accel")
    assert found.axes == ["y", "z"]
    assert re.search(r"amplitude y 0\.0\d+, z 0\.\d+ m/s\^2", found.statement)


def test_shaking_that_all_axes_share_makes_no_lines_by_chance() -> None:
    """A support that rings at 9 Hz, 2 Hz wide, five times the noise, along one direction."""
    for seed in range(9, 13):
        rng, r = np.random.default_rng(seed), np.exp(-2.0 * np.pi * 0.01)
        ringing = lfilter([1.0], [1.0, -2.0 * r * np.cos(2.0 * np.pi * 0.09), r * r], rng.normal(size=30000))
        xyz = rng.normal(0.0, NOISE, (30000, 3)) + 0.05 * np.outer(ringing / ringing.std(), [0.6, -0.5, 0.7])
        xyz[:, 2] += 9.81
        assert tones(Samples(Sensor.ACCELEROMETER, frozen(T[:30000]), frozen(xyz)), "accel") == []


def test_a_strong_line_that_wanders_a_little_has_its_own_amplitude() -> None:
    """By 0.3 in 1000, which takes it out of step with itself in some minutes."""
    rng = np.random.default_rng(3)
    wander = np.convolve(rng.normal(0.0, 1.0, T.size), np.ones(6000) / np.sqrt(6000.0), "same")
    wandering = np.sin(2.0 * np.pi * 17.3 * np.cumsum(1.0 + 3e-4 * wander) * 0.01)
    (found,) = tones(lying(0.5 * wandering), "accel")
    assert found.parameters["amplitude"].value[2] == pytest.approx(0.5, rel=0.05)  # type: ignore[index]


def test_a_faint_line_is_not_lost_in_the_stretches_in_which_a_car_drives() -> None:
    rng, drives = np.random.default_rng(4), (T % 120.0 > 60.0)
    (found,) = tones(lying(humming({17.3: 0.006}) + rng.normal(0.0, 0.2, T.size) * drives), "accel")
    low, high = np.asarray(found.parameters["amplitude"].ci95, dtype=np.float64)[2]
    assert low < 0.006 < high and high - low < 0.002


@pytest.mark.parametrize("seed", [27, 230])
def test_bands_that_shake_for_a_minute_are_no_line(seed: int) -> None:
    """Of three bands, 0.6 to 2 Hz wide, the power is largest up to 0.7 Hz further from fifth to fifth."""
    t = T[:20000]
    rng, shaken = np.random.default_rng(seed), (t > 60.0) & (t < 125.0)
    xyz = rng.normal(0.0, NOISE, (t.size, 3))
    xyz[:, 2] += 9.81
    for _ in range(3):
        r, pitch = np.exp(-np.pi * rng.choice([0.6, 1.0, 2.0]) * 0.01), rng.uniform(5.0, 20.0)
        poles = [1.0, -2.0 * r * np.cos(2.0 * np.pi * pitch * 0.01), r * r]
        ringing = lfilter([1.0], poles, rng.normal(size=int(shaken.sum())))
        xyz[shaken] += np.outer(ringing / ringing.std(), rng.normal(0.0, 0.2, 3))
    assert tones(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), "accel") == []


def test_a_line_for_a_while_that_keeps_its_phase_has_the_frequency_that_this_tells() -> None:
    """Single stretches of 20 s would tell it to 1e-4 Hz."""
    (found,) = tones(lying(humming({17.30071: 0.02}) * (T > 150.0) * (T < 450.0)), "accel")
    assert middle_hz(found) == pytest.approx(17.30071, abs=1e-5)


def test_a_line_that_is_always_there_lasts_as_long_as_the_recording() -> None:
    samples = lying(humming({17.3: 0.02}))
    xyz = samples.xyz.copy()
    xyz[:3000, 0] += 5.0 * np.sin(2.0 * np.pi * 0.3 * T[:3000])  # moved at first
    (found,) = tones(Samples(samples.sensor, T, frozen(xyz)), "accel")
    assert (found.where.t_start, found.where.t_end) == (T[0], T[-1])


def slow_phone(amplitude: float, seed: int) -> Samples:
    """Return 40 minutes at 10 Hz with a tone of 4.09 Hz on all axes, rests of 52 s between movements."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 2400.0, 0.1)
    xyz = rng.normal(0.0, NOISE, (t.size, 3)) + amplitude * np.sin(2.0 * np.pi * 4.09 * t)[:, None]
    moved = t % 60.0 > 52.0
    xyz[moved] += rng.normal(0.0, 2.0, (int(moved.sum()), 3))
    xyz[:, 2] += 9.81
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz))


@pytest.mark.parametrize("amplitude", [0.0, 0.0009, 0.002, 0.02])
def test_what_keeps_its_phase_is_found_however_faint_each_rest_shows_it(
    amplitude: float,
) -> None:
    """A d' of 9 on each axis at 0.9 mm/s^2, at a frequency that bodies reach and near half of the rate."""
    found = tones(slow_phone(amplitude, 3), "accel")
    assert [f.effect for f in found] == ["vibration_tone"] * (amplitude > 0.0)
    for line in found:
        assert line.parameters["frequency"].value == pytest.approx(4.09, abs=1e-3)
        assert line.parameters["amplitude"].value == pytest.approx([amplitude] * 3, rel=0.25)


def test_what_gaps_between_rests_spread_of_a_line_is_no_error_of_its_amplitude() -> None:
    """Rests of 5 to 40 s, turns of 2 s: beside a plain line are its own side lobes, far above the noise."""
    rng = np.random.default_rng(8)
    lengths = np.where(np.arange(240) % 2 == 1, 20, rng.integers(50, 400, 240))
    moved = np.repeat(np.arange(240) % 2 == 1, lengths)
    t = 0.1 * np.arange(moved.size)
    xyz = rng.normal(0.0, NOISE, (t.size, 3))
    xyz[:, 2] += 9.81 + 0.02 * np.sin(2.0 * np.pi * 4.09 * t)
    xyz[moved] += rng.normal(0.0, 2.0, (int(moved.sum()), 3))
    (line,) = tones(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), "accel")
    low, high = np.asarray(line.parameters["amplitude"].ci95, dtype=np.float64)[2]
    bound = 1.96 * NOISE * np.sqrt(2.0 / np.count_nonzero(~moved))
    assert low < 0.02 < high and 0.5 * (high - low) < 3.0 * bound


def restless(nats: float, seed: int) -> Samples:
    """Return 60 rests of 30 s at 16 Hz with a line of 7.3 Hz on z whose phase is another in each.

    nats: of the matched filter, in all rests together.
    """
    rng, t = np.random.default_rng(seed), np.arange(0.0, 60 * 33.0, 1.0 / 16.0)
    in_turn = t % 33.0 - 30.0
    moved = in_turn >= 0.0
    amplitude = 2.0 * NOISE * np.sqrt(nats / (~moved).sum())
    phase = rng.uniform(0.0, 2.0 * np.pi, 60)[(t // 33.0).astype(int)]
    xyz = rng.normal(0.0, NOISE, (t.size, 3))
    xyz[:, 0] += np.where(moved, 5.0 * np.sin(np.pi * in_turn / 3.0), 0.0)
    xyz[:, 2] += 9.81 + amplitude * np.sin(2.0 * np.pi * 7.3 * t + phase)
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz))


def test_of_faint_lines_with_a_phase_in_each_of_many_rests_most_are_found() -> None:
    """At 85 nats; sixty phases cost more than the one of a line that keeps it."""
    found = [[round(middle_hz(f), 1) for f in tones(restless(85.0, seed), "accel")] for seed in range(6)]
    assert found.count([7.3]) >= 4


def test_stretches_of_each_length_are_laid_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []
    own = spectral_line.stretches

    def counted(*args: Any) -> Any:
        asked.append(args[2])
        return own(*args)

    monkeypatch.setattr(spectral_line, "stretches", counted)
    samples = lying(humming({30.0: 0.004}))
    rests = AtRest.of(samples, "accel")
    assert tones(samples, "accel", rests)
    assert steady_period(samples, "accel", rests) is None
    assert asked.count(spectral_line.SHORT) == 1
    assert len(asked) == len(set(asked))


def test_what_no_stretch_shows_is_not_narrow() -> None:
    samples = lying(humming({30.0: 0.004}))
    rests = AtRest.of(samples, "accel")
    (line,) = tones(samples, "accel", rests)
    elsewhere = replace(line, where=replace(line.where, t_start=1000.0, t_end=1030.0))
    assert rests.short is not None
    assert spectral_line._narrow(rests.short, line) and not spectral_line._narrow(rests.short, elsewhere)


def test_rests_hours_apart_need_no_more_memory_than_rests_minutes_apart() -> None:
    """A line whose frequency is not sure may have any of a million in them; a day took 11 GB."""
    rng, rate = np.random.default_rng(1), 50.0
    own = np.arange(0.0, 60.0, 1.0 / rate)
    t = np.concatenate([own + 1800.0 * k for k in range(40)])
    xyz = rng.normal([0.0, 0.0, 9.81], NOISE, (t.size, 3))
    xyz[:, 2] += np.concatenate(
        [0.01 * np.sin(2.0 * np.pi * (9.0 + rng.normal(0.0, 0.02)) * own) for _ in range(40)]
    )
    tracemalloc.start()
    found = tones(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), "accel")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [round(middle_hz(f)) for f in found] == [9]
    assert peak < 300e6


@pytest.mark.parametrize("seed", [0, 2])
def test_stamps_in_whole_milliseconds_make_no_images_of_a_line(seed: int) -> None:
    """Beside a line of 131.7 Hz there were two at 168.3 and 31.7 Hz, and the shaking's power in each."""
    rng, t = np.random.default_rng(seed), np.arange(40_000) / 400.0
    shaking = sosfilt(butter(2, [5.0, 20.0], "band", fs=400.0, output="sos"), rng.normal(size=t.size))
    xyz = rng.normal(0.0, 2e-3, (t.size, 3)) + np.array([0.0, 0.0, 9.8])
    xyz[:, 0] += 3e-3 * np.sin(2.0 * np.pi * 131.7 * t)
    xyz[:, 1] += 0.3 * shaking / shaking.std()
    (line,) = tones(Samples(Sensor.ACCELEROMETER, frozen(np.round(t, 3)), frozen(xyz)), "accel")
    assert middle_hz(line) == pytest.approx(131.7, abs=0.01)
    assert line.parameters["amplitude"].value == pytest.approx([3e-3, 0.0, 0.0], abs=2e-4)


@pytest.mark.parametrize(("scatter", "batch"), [(4e-4, 1), (0.0, 40)])
def test_stamps_are_evened_up_to_a_pause_and_no_further(scatter: float, batch: int) -> None:
    rng = np.random.default_rng(1)
    true = np.arange(30_000) * 0.0025003 + 7.0 * (np.arange(30_000) >= 13_000)
    stamps = np.sort(true + rng.uniform(-scatter, scatter, true.size))
    stamps = stamps[np.arange(true.size) // batch * batch] + 1e-6 * (np.arange(true.size) % batch)
    places = Places.of(Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(np.ones((true.size, 3)))))
    assert places is not None
    off = places.t[places.there] - true
    assert float(np.abs(off - np.median(off)).max()) < (1.5e-4 if batch == 1 else 0.03)
    assert float(off.std()) < (3e-5 if batch == 1 else 3e-3)


@pytest.mark.parametrize("pause", [3.0, 7.31])
def test_pauses_make_no_second_line(pause: float) -> None:
    """The rate of a recording with pauses was its samples over all of the time: 41 Hz were 39.05 Hz, too."""
    t = np.arange(30_000) / 100.0
    t = t + pause * (t // 60.0)
    xyz = np.random.default_rng(5).normal(0.0, 2e-3, (t.size, 3)) + np.array([0.0, 0.0, 9.8])
    xyz[:, 0] += 3e-3 * np.sin(2.0 * np.pi * 41.0 * t)
    (line,) = tones(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), "accel")
    assert middle_hz(line) == pytest.approx(41.0, abs=2e-3)


def test_stamps_that_scatter_leave_a_line_where_it_is() -> None:
    """Their usual interval was 0.26 % too long, and the frequency was sought beside the line: 32.987 Hz."""
    rng, t = np.random.default_rng(7), np.arange(30_000) / 100.0
    xyz = rng.normal(0.0, 2e-3, (t.size, 3)) + np.array([0.0, 0.0, 9.8])
    xyz[:, 0] += 3e-3 * np.sin(2.0 * np.pi * 33.0 * t)
    stamps = np.sort(t + rng.uniform(-4e-3, 4e-3, t.size))
    places = Places.of(Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(xyz)))
    assert places is not None and places.period == pytest.approx(0.01, rel=5e-5)
    (line,) = tones(Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(xyz)), "accel")
    assert middle_hz(line) == pytest.approx(33.0, abs=2e-3)
    assert line.parameters["amplitude"].value[0] == pytest.approx(3e-3, abs=1e-4)


def test_deliveries_that_stall_do_not_move_the_stamps_about_them() -> None:
    """A steady line was said to come and go, as stamps within seconds of a delay were evened with it."""
    rng, t = np.random.default_rng(1), np.arange(30_000) / 100.0
    xyz = rng.normal(0.0, 2e-3, (t.size, 3)) + np.array([0.0, 0.0, 9.8])
    xyz[:, 0] += 3e-3 * np.sin(2.0 * np.pi * 33.0 * t)
    stamps = t.copy()
    for at, waits in zip(np.arange(12.0, 290.0, 31.0), rng.uniform(0.1, 1.9, 9), strict=True):
        late = (t >= at) & (t < at + waits)
        stamps[late] = at + waits + 1e-4 * np.arange(late.sum())
    (line,) = tones(Samples(Sensor.ACCELEROMETER, frozen(np.sort(stamps)), frozen(xyz)), "accel")
    assert line.where.driver != COMES_AND_GOES
    assert line.parameters["amplitude"].value[0] == pytest.approx(3e-3, abs=5e-5)


def test_stamps_of_a_clock_that_goes_faster_after_a_pause_stay_as_they_are_at_its_ends() -> None:
    n = np.arange(20_000)
    stamps = n * 0.01 + np.where(n < 10_000, 1e-5 * n, 60.0 - 1e-5 * n)
    places = Places.of(Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(np.ones((n.size, 3)))))
    assert places is not None and places.t == pytest.approx(stamps, abs=1e-4)


def of_bursts(rng: np.random.Generator, lost: float) -> tuple[np.ndarray, np.ndarray]:
    """When (n,) s samples at 100 Hz were measured, and their stamps: bursts of seven, a part of them lost."""
    n = 40_000
    true, burst = np.arange(n) / 100.0, np.arange(n) // 7
    waits = lfilter([1.0], [1.0, -0.98], rng.normal(0.0, 0.003, burst[-1] + 1))
    delivered = true[np.minimum(burst * 7 + 6, n - 1)] + (waits - waits.min())[burst]
    there = (rng.random(burst[-1] + 1) >= lost)[burst]
    return true[there], (delivered + 1e-3 * (np.arange(n) % 7))[there]


@pytest.mark.parametrize("lost", [0.0, 0.02, 0.1])
def test_a_line_of_samples_in_bursts_has_its_size_and_is_put_in_as_it_is_sought(lost: float) -> None:
    """Evened over 5 s, the moments of bursts wandered so far that 41 Hz had half of its amplitude.

    With bursts lost whose places were not left empty, no line kept its phase.
    """
    rng = np.random.default_rng(6)
    true, stamps = of_bursts(rng, lost)
    quiet = rng.normal(0.0, NOISE, (true.size, 3)) + np.array([0.0, 0.0, 9.8])
    hums = quiet + np.outer(0.01 * np.sin(2.0 * np.pi * 41.0 * true), [1.0, 0.0, 0.0])
    silent, loud = (Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(x)) for x in (quiet, hums))
    (line,) = tones(loud, "accel")
    assert line.parameters["frequency"].value == pytest.approx(41.0, abs=0.01)
    assert line.parameters["amplitude"].value[0] == pytest.approx(0.01, rel=0.1)
    assert would_show(silent, "accel", [line]) == [True] and tones(silent, "accel") == []


def test_a_line_that_stands_out_at_four_hz_and_lies_below_is_none() -> None:
    """Of a phone in a car one of 3.97 Hz was told, where none below 4 Hz is."""
    assert heard(humming({3.98: 0.1})) == []
    assert heard(humming({4.1: 0.1})) == [4.1]


def test_faster_lines_that_one_may_be_an_alias_of_are_counted_from_the_sample_rate() -> None:
    """Of stretches of an odd number of samples, as clocks make them, half the rate came out 1 / 40 s too low.

    Of 7 Hz at 100 Hz 92.9 and 106.9 were told.
    """
    line = humming({7.0: 0.01})
    for clock in (1.0, 1.0 - 1e-6, 1.0 + 1e-6):
        steady = lying(line)
        (told,) = tones(replace(steady, t=frozen(steady.t * clock)), "accel")
        assert told.remark == "It may be an alias of one at 93.0 or 107.0 Hz."


@pytest.mark.parametrize(("frequency", "vibrates"), [(3.9996, False), (3.9999, False), (4.00005, True)])
def test_what_is_at_four_hz_is_a_vibration_or_a_steady_period_and_not_both(
    frequency: float, vibrates: bool
) -> None:
    """A line in phase was told below 4 Hz too, and one at 4 Hz twice; a slower period beside it is told."""
    samples = lying(humming({frequency: 0.05, 2.3: 0.02}))
    rests = AtRest.of(samples, "accel")
    period = steady_period(samples, "accel", rests)
    told = [middle_hz(line) for line in tones(samples, "accel", rests)]
    assert told == (pytest.approx([frequency], abs=2e-5) if vibrates else [])
    assert period is not None and "2.3" in period.statement and ("4 Hz" in period.statement) != vibrates


def moved_about(hums: list[tuple[float, float]], rests: int, rest_s: float = 44.0) -> Samples:
    """Return rests of a phone that is turned for 6 s between them, at 50 Hz. hums: s, spans of 17.3 Hz."""
    rng, each = np.random.default_rng(4), rest_s + 6.0
    t = np.arange(0.0, rests * each, 0.02)
    up = rng.normal(0.0, 1.0, (rests, 3))
    up *= 9.81 / np.linalg.norm(up, axis=1, keepdims=True)
    turning = (t % each > rest_s).astype(float)[:, None]
    xyz = up[(t / each).astype(int)] + rng.normal(0.0, NOISE, (t.size, 3)) * (1.0 + 200.0 * turning)
    for start, end in hums:
        xyz[:, 0] += 0.03 * np.sin(2.0 * np.pi * 17.3 * t) * ((t >= start) & (t < end))
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz))


@pytest.mark.parametrize(
    ("hums", "rests", "told"),
    [
        ([(200.0, 244.0)], 16, False),  # the fifth rest, whole
        ([(208.0, 236.0)], 16, True),  # it begins and ends while the phone lies still
        ([(200.0, 294.0)], 16, True),  # two rests
        ([(200.0, 244.0), (500.0, 544.0)], 16, True),
        ([(100.0, 144.0), (700.0, 744.0)], 16, True),  # one of the two is told
        ([(100.0, 144.0)], 4, True),  # of four nobody knows what is usual
        ([(100.0, 144.0)], 9, True),  # more than a tenth of the time at rest
        ([(208.0, 236.0)], 40, False),  # less than a fiftieth
        ([(208.0, 236.0), (1208.0, 1236.0)], 40, True),  # more, in two waits
    ],
)
def test_a_vibration_that_fills_one_rest_of_many_is_of_what_the_phone_lay_on(
    hums: list[tuple[float, float]], rests: int, told: bool
) -> None:
    """Vehicles that wait for half a minute were vibrations that a simulation of the phone lacks."""
    samples = moved_about(hums, rests)
    exam = examine(samples, None, sought=())
    (line,) = exam.streams[0].lines
    assert middle_hz(line) == pytest.approx(17.3, abs=0.05)
    assert any(is_line(s.finding) for s in exam.statements) == told
    checked = [c.reason for c in direct_checks(exam) if (c.effect, c.sensor) == ("vibration_tone", "accel")]
    share, when = line.parameters["fraction"].value, f"{line.where.t_start:.0f} to {line.where.t_end:.0f} s"
    why = f"what the device lay on vibrated at 17.3 Hz for {share:.2%} of the time at rest, from {when}"
    assert checked == [None if told else why]


@pytest.mark.parametrize(
    ("felt", "turned", "told"),
    [
        ([(0.0, 800.0)], [(200.0, 244.0)], ["accel"]),  # the gyroscope feels the loudest part of it
        ([(200.0, 244.0)], [(208.0, 236.0)], []),  # it fills one rest, as the accelerometer shows
    ],
)
@pytest.mark.slow
def test_of_what_the_phone_lay_on_both_sensors_say_the_same(
    felt: list[tuple[float, float]], turned: list[tuple[float, float]], told: list[str]
) -> None:
    """One of the two parts was a finding, and the other one was named under what is not compared."""
    accel, gyro = moved_about(felt, 16), moved_about(turned, 16)
    still = gyro.t % 50.0 <= 44.0
    rate = np.where(still[:, None], (gyro.xyz - moved_about([], 16).xyz), 1.0)
    rate += np.random.default_rng(5).normal(0.0, NOISE, rate.shape)
    exam = examine(accel, Samples(Sensor.GYROSCOPE, gyro.t, frozen(0.1 * rate)), sought=())
    assert all(len(s.lines) == 1 for s in exam.streams)
    lines = [s.finding for s in exam.statements if is_line(s.finding)]
    assert [f.sensor for f in lines] == told and all(f.echoes for f in lines)
    assert [bool(s.passing) for s in exam.streams] == [not told] * 2
