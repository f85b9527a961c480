"""Noise at rest that is neither white nor behind a low-pass has no name, and its band is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, cheby1, lfilter, sosfilt

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.direct import band_of_other, why_no_band
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import SHAKEN, density, why_no_density
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.direct.halves import quantities_of
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Claims, Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.noise.coloured_noise import (
    DRIVER,
    Coloured,
    coloured_noise,
    coloured_noise_finding,
    in_band,
    is_end_of_wander,
)
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet, Spectra, judged
from stillcal.calib_core.diagnosis.stream import direct_findings
from stillcal.calib_core.streams.samples import Samples, Sensor

WHERE = Where(0.0, 1.0, (0.0, 1.0), "noise at rest")
PIECES, LONG, RATE = 40, 1000, 100.0
RESONANCE = (15.0, 22.0)


def resonating(white: Array, gain: float, band: tuple[float, float] = RESONANCE) -> Array:
    """Return white noise (..., n, 3) with `gain` times itself, in a band, added."""
    b, a = butter(2, band, "band", fs=RATE)
    return np.asarray(white + gain * lfilter(b, a, white, axis=-2))


def noise(seed: int = 4) -> Array:
    return np.random.default_rng(seed).normal(size=(PIECES, LONG, 3))


def seen(pieces: Array) -> Spectra:
    found = judged(Quiet(tuple(pieces), tuple(10.0 * np.arange(len(pieces))), RATE))
    assert found is not None
    return found


def told(found: Coloured | None) -> Finding | None:
    if found is None:
        return None
    return coloured_noise_finding(found, "gyro", sound_phones()["noise_coloured"], WHERE)


@pytest.mark.parametrize(("gain", "least", "most"), [(3.0, 11.0, 17.0), (1.0, 3.0, 4.2), (-0.8, 0.03, 0.3)])
def test_a_band_that_stands_apart_in_every_rest_and_on_every_axis_is_told(
    gain: float, least: float, most: float
) -> None:
    """In the middle of the band its power is (1 + gain)^2 times the rest's."""
    found = told(coloured_noise(seen(resonating(noise(), gain))))
    assert found is not None
    assert (found.effect, found.axes, found.where.driver) == ("unknown", ["x", "y", "z"], DRIVER)
    low, high = found.where.band_hz
    assert abs(low - RESONANCE[0]) < 2.5 and abs(high - RESONANCE[1]) < 2.5
    assert least < float(np.asarray(found.parameters["ratio"].value)) < most


def test_a_difference_of_neighbours_has_least_at_low_frequency() -> None:
    found = told(coloured_noise(seen(np.diff(noise(), axis=1))))
    assert found is not None
    assert found.where.band_hz[0] < 3.0 and float(np.asarray(found.parameters["ratio"].value)) < 0.1


def test_white_noise_has_no_such_band_alone_and_in_any() -> None:
    for seed in range(8):
        assert told(coloured_noise(seen(noise(seed)))) is None
    one = in_band(seen(noise()), (15.0, 23.0))
    assert one is not None and abs(one.log_ratio.value) < 3.0 * one.log_ratio.error


def test_what_differs_between_axes_or_rests_is_not_the_sensors_own() -> None:
    """A phone is shaken by what it lies on along one axis more than another, and not always."""
    one_axis, some_rests = noise(), noise()
    one_axis[..., 2] = resonating(one_axis, 1.5)[..., 2]
    some_rests[::2] = resonating(some_rests, 1.5)[::2]
    assert coloured_noise(seen(one_axis)) is None
    assert told(coloured_noise(seen(some_rests))) is None


def test_rests_on_one_face_after_the_other_are_shaken_along_another_axis_each() -> None:
    """Over all six faces what shakes the phone is alike on all axes."""
    rests = noise()
    for k, rest in enumerate(rests):
        rest[:, k % 3] = resonating(rest, 3.0)[:, k % 3]
    assert coloured_noise(seen(rests)) is None


def test_of_few_quiet_rests_each_may_tremble() -> None:
    """Five rests of forty that tremble alike are even for they were chosen as the quietest."""
    tremor = resonating(noise(5), 2.0) - noise(5)
    rests = noise() + np.r_[np.ones(5), np.geomspace(1.5, 9.0, PIECES - 5)][:, None, None] * tremor
    assert told(coloured_noise(seen(rests))) is None
    assert told(coloured_noise(seen(resonating(noise()[:5], 2.0)))) is not None


def test_a_sharp_filter_near_half_the_rate_is_what_parts_come_with() -> None:
    fast = np.random.default_rng(3).normal(size=(PIECES, 4 * LONG, 3))
    for edge, is_told in ((40.0, False), (28.0, True)):
        sharp = sosfilt(cheby1(8, 0.5, edge, fs=4.0 * RATE, output="sos"), fast, axis=1)[:, ::4]
        found = seen(sharp + 0.1 * sharp.std() * noise())
        assert found.low_pass is None and (told(coloured_noise(found)) is not None) == is_told


def test_a_line_is_no_band_of_noise() -> None:
    t = np.arange(LONG) / RATE
    line = noise() + np.sin(2.0 * np.pi * 18.1 * t)[:, None]
    assert told(coloured_noise(seen(line))) is None
    beside = in_band(seen(line), RESONANCE)
    assert beside is not None and abs(beside.log_ratio.value) < 0.15


def test_what_a_low_pass_leaves_is_judged_before_it() -> None:
    b, a = butter(2, 15.0, fs=RATE)
    filtered = seen(lfilter(b, a, noise(), axis=1))
    assert filtered.low_pass is not None
    assert told(coloured_noise(filtered)) is None


def test_what_a_steep_filter_with_noise_behind_it_leaves_is_told() -> None:
    """Its spectrum is level again, as beside motion that falls, so it is no low-pass by name."""
    b, a = butter(6, 15.0, fs=RATE)
    behind = 0.01 * np.random.default_rng(3).normal(size=(PIECES, LONG, 3))
    steep = seen(lfilter(b, a, noise(), axis=1) + behind)
    assert steep.low_pass is None
    found = told(coloured_noise(steep))
    assert found is not None and float(np.asarray(found.parameters["ratio"].value)) > 100.0


def test_a_band_beyond_the_frequencies_that_are_judged_is_not_told() -> None:
    assert in_band(seen(noise()), (55.0, 70.0)) is None
    assert in_band(seen(noise()), (44.0, 70.0)) is None


def resting(seed: int, gain: float, band: tuple[float, float] = RESONANCE) -> Samples:
    """Return an accelerometer at rest for 200 s whose noise resonates."""
    white = np.random.default_rng(seed).normal(0.0, 0.02, (20_000, 3))
    force = np.array([0.3, -0.5, 9.78]) + resonating(white, gain, band)
    return Samples(Sensor.ACCELEROMETER, frozen(np.arange(20_000) / RATE), frozen(force))


def differing(one: Examination, other: Examination) -> list[tuple[str, str]]:
    found = compare(one, other, ("a.csv", "b.csv"))
    return [(d.relation, d.where.driver) for d in found.discrepancies if d.effect == "unknown"]


def test_a_band_is_compared_with_what_the_other_recording_has_in_it() -> None:
    resonant, alike, less, white, elsewhere = (
        examine(samples, None, sought=())
        for samples in (
            *(resting(k, gain) for k, gain in enumerate((3.0, 3.0, 1.0, 0.0))),
            resting(9, 3.0, (32.0, 40.0)),
        )
    )
    assert differing(resonant, white) == [("lacking", DRIVER)]
    assert differing(white, resonant) == [("superfluous", DRIVER)]
    assert differing(resonant, alike) == []
    assert differing(resonant, less) == [("too_small", DRIVER)]
    assert sorted(differing(resonant, elsewhere)) == [("lacking", DRIVER), ("superfluous", DRIVER)]


@pytest.mark.parametrize("turned", [False, True])
def test_what_shakes_all_axes_together_is_not_the_sensors_own(turned: bool) -> None:
    """A fan may shake a phone as much along each axis, in every rest, and no line stands out of it."""
    samples = resting(2, 0.0)
    b, a = butter(2, RESONANCE, "band", fs=RATE)
    rumble = lfilter(b, a, np.random.default_rng(7).normal(0.0, 0.06, len(samples)))
    sign = np.where(np.arange(len(samples)) // 4000 % 2, -1.0, 1.0) if turned else np.ones(len(samples))
    force = np.array(samples.xyz) + np.stack([rumble, sign * rumble, sign * rumble], axis=1)
    found = examine(Samples(Sensor.ACCELEROMETER, samples.t, frozen(force)), None, sought=())
    assert found.streams[0].spectra is not None and coloured_noise(found.streams[0].spectra) is not None
    assert all(s.finding.where.driver != DRIVER for s in found.statements)
    assert found.streams[0].coloured(RESONANCE) is None


def test_chance_moves_no_axes_together() -> None:
    """White noise tells that it has no more in a band than in any other."""
    for seed in range(3):
        found = examine(resting(seed, 0.0), None, sought=())
        for low in (5.0, 12.0, 20.0, 30.0):
            assert found.streams[0].coloured((low, 1.4 * low)) is not None


def test_what_another_recording_has_in_a_band_without_a_finding_of_its_own() -> None:
    """Less than sound phones have is none; what shakes that recording hides it, and that is said."""
    found = told(coloured_noise(seen(resonating(noise(), 3.0))))
    assert found is not None and quantities_of(found) == ("noise_coloured",)
    found = replace(found, sensor="accel")
    white, weak = (examine(resting(k, gain), None, sought=()) for k, gain in enumerate((0.0, 0.4)))
    assert band_of_other(found, white) is None and why_no_band(found, white) is None
    less = band_of_other(found, weak)
    assert less is not None and 1.4 < float(np.asarray(less.parameters["ratio"].value)) < 2.4
    moving = resting(5, 0.0)
    rumble = resonating(np.random.default_rng(8).normal(0.0, 0.02, (len(moving), 1)), 3.0)
    shaken = Samples(Sensor.ACCELEROMETER, moving.t, frozen(np.array(moving.xyz) + rumble))
    assert why_no_band(found, examine(shaken, None, sought=())) is not None


def test_what_all_axes_share_at_every_frequency_hides_no_band() -> None:
    samples = resting(3, 3.0)
    force = np.array(samples.xyz)
    force[:, :2] += 0.3 * (force[:, 2:] - force[:, 2].mean())
    found = examine(Samples(Sensor.ACCELEROMETER, samples.t, frozen(force)), None, sought=())
    assert found.streams[0].coloured() is not None


def test_where_a_vibration_wanders_nothing_is_said_of_its_band() -> None:
    t = np.arange(20_000) / RATE
    pace = 18.0 + np.cumsum(np.random.default_rng(1).normal(0.0, 0.02, t.size))
    samples = resting(1, 0.0)
    force = np.array(samples.xyz) + 0.1 * np.sin(2.0 * np.pi * np.cumsum(pace) / RATE)[:, None]
    found = examine(Samples(Sensor.ACCELEROMETER, samples.t, frozen(force)), None, sought=())
    assert all(s.finding.where.driver != DRIVER for s in found.statements)


def test_more_at_the_lowest_frequencies_alone_may_be_the_end_of_a_wander() -> None:
    falling, resonant = seen(lfilter([1.0], [1.0, -0.9], noise(), axis=1)), seen(resonating(noise(), 3.0))
    less = seen(np.diff(noise(), axis=1))
    for spectrum, end in ((falling, True), (resonant, False), (less, False)):
        found = told(coloured_noise(spectrum))
        assert found is not None and is_end_of_wander(found, spectrum) == end


def held(accel_gain: float, gyro_gain: float, gyro_noise: float) -> Examination:
    """Return five minutes at rest; each sensor's noise has a band with (1 + gain)^2 times the power.

    gyro_noise: rad/s a sample.
    """
    white = np.random.default_rng(9).normal(size=(2, 30_000, 3))
    t = np.arange(white.shape[1]) / RATE
    force = np.array([0.0, 0.0, 9.80665]) + 0.02 * resonating(white[0], accel_gain)
    rate = gyro_noise * resonating(white[1], gyro_gain)
    kinds = (Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, rate)
    return examine(*(Samples(kind, frozen(t), frozen(xyz)) for kind, xyz in kinds), sought=())


def bands(exam: Examination) -> set[str]:
    return {s.finding.sensor for s in exam.statements if s.finding.where.driver == DRIVER}


def test_what_both_sensors_have_in_a_band_shakes_the_phone() -> None:
    """A hand and an idling vehicle were told as noise of one sensor that is not white."""
    assert bands(held(3.0, 0.0, 1e-3)) == {"accel"}
    assert bands(held(3.0, -0.8, 1e-3)) == {"accel", "gyro"}
    assert bands(held(3.0, 3.0, 1e-3)) == set()


def test_beside_a_gyroscope_that_is_shaken_an_accelerometer_s_noise_is_not_its_own() -> None:
    """Its level, of a hand, was twice what the datasheet says."""
    exam = held(0.0, 12.0, 0.03)
    accel, gyro = exam.streams
    assert gyro.levels is not None and gyro.levels.loud and not gyro.levels.alike
    assert accel.shaken and not gyro.shaken
    assert density(accel) is None and why_no_density(accel) == SHAKEN
    band = held(3.0, 12.0, 0.03).streams[0]
    assert band.coloured() is None and replace(band, shaken=False).coloured() is not None
    quiet = held(0.0, 12.0, 1e-3).streams[0]
    assert not quiet.shaken and density(quiet) is not None
    white = held(0.0, 0.0, 0.05)
    assert white.streams[1].levels is not None and white.streams[1].levels.loud
    assert not white.streams[0].shaken
    claims = Claims(accel_noise_density=0.01 / np.sqrt(RATE / 2.0))
    for made, told_of in ((exam, set[str]()), (white, {"accel"})):
        found = direct_findings(made.streams, claims, sound_phones())
        assert {f.sensor for f in found if f.effect == "noise_level" and f.sensor == "accel"} == told_of
