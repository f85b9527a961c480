"""A vibration whose frequency wanders is told as one, with its amplitude; noise of a narrow band is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.line import COMES_AND_GOES, WANDERS, middle_hz
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import tones
from stillcal.calib_core.diagnosis.stream import of_one_vibration
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 50.0
T = np.arange(0.0, 300.0, 1.0 / RATE)


def wandering(seed: int, middle: float, part: float) -> Array:
    """Return the phase (n,) of a line whose frequency goes at random, `part` of it on either side at most."""
    course = np.cumsum(np.random.default_rng(seed).standard_normal(T.size))
    course -= np.linspace(course[0], course[-1], T.size)
    return 2.0 * np.pi * np.cumsum(middle * (1.0 + part * course / np.abs(course).max())) / RATE


def found(wave: Array, seed: int = 0) -> list[Finding]:
    """Return the lines of an accelerometer at rest that is shaken so on x, and by half of it on z."""
    xyz = np.random.default_rng(seed).normal([0.0, 0.0, 9.81], 0.02, (T.size, 3))
    xyz += np.outer(wave, [1.0, 0.0, 0.5])
    return tones(Samples(Sensor.ACCELEROMETER, frozen(T), frozen(xyz)), "accel")


@pytest.mark.parametrize("part", [0.02, 0.05])
@pytest.mark.parametrize("amplitude", [0.03, 0.1])
def test_a_fan_without_a_governor_is_one_line_that_wanders(part: float, amplitude: float) -> None:
    """By 5 % it was not seen at all, by 2 % it was a steady line of two thirds of the amplitude."""
    (line,) = found(amplitude * np.sin(wandering(1, 13.1, part)))
    assert (line.effect, line.where.driver) == ("unknown", WANDERS)
    low, high = line.where.band_hz
    assert 13.1 * (1.0 - part) - 0.1 < low < 13.1 - 0.04 and 13.1 + 0.04 < high < 13.1 * (1.0 + part) + 0.1
    assert f"wanders from {low:.2f} to {high:.2f} Hz" in line.statement
    size = line.parameters["amplitude"]
    assert np.allclose(size.value, [amplitude, 0.0, amplitude / 2.0], atol=0.15 * amplitude)
    assert line.parameters["fraction"].value == pytest.approx(1.0, abs=0.05)


def test_its_harmonics_are_not_told_as_lines_of_their_own() -> None:
    phase = wandering(2, 9.0, 0.01)
    lines = found(0.1 * np.sin(phase) + 0.05 * np.sin(2.0 * phase))
    assert [line.where.driver for line in lines] == [WANDERS]


@pytest.mark.parametrize(("part", "other"), [(0.02, 21.0), (0.05, 20.6)])
def test_another_line_beside_it_is_told(part: float, other: float) -> None:
    """Its second harmonic is at 18 Hz, the third folds back to 23 Hz."""
    lines = found(0.1 * np.sin(wandering(3, 9.0, part)) + 0.02 * np.sin(2.0 * np.pi * other * T))
    assert sorted((line.effect, round(middle_hz(line))) for line in lines) == [
        ("unknown", 9),
        ("vibration_tone", round(other)),
    ]


@pytest.mark.parametrize("width", [0.05, 0.2, 0.4, 1.0])
def test_noise_of_a_narrow_band_does_not_wander(width: float) -> None:
    """A hand that trembles goes from frequency to frequency at random, and its amplitude comes and goes."""
    rng = np.random.default_rng(int(100 * width))
    spectrum = np.fft.rfft(rng.standard_normal(T.size))
    spectrum *= np.exp(-0.5 * ((np.fft.rfftfreq(T.size, 1.0 / RATE) - 9.3) / (width / 2.0)) ** 2)
    wave = np.fft.irfft(spectrum, T.size)
    assert all(line.where.driver != WANDERS for line in found(0.1 * wave / wave.std()))


def test_a_rest_of_half_an_hour_with_noise_of_a_narrow_band_is_no_fan() -> None:
    """In half a minute its frequency goes its way too, but its amplitude comes and goes."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 900.0, 0.01)
    slow = np.fft.rfft(rng.standard_normal((2, t.size)), axis=1)
    slow *= 1.0 / (1.0 + (np.fft.rfftfreq(t.size, 0.01) / 0.03) ** 4)
    cosine, sine = np.fft.irfft(slow, t.size, axis=1)
    wave = cosine * np.cos(2.0 * np.pi * 13.55 * t) + sine * np.sin(2.0 * np.pi * 13.55 * t)
    xyz = rng.normal([0.0, 0.0, 9.81], 0.02, (t.size, 3)) + np.outer(0.3 * wave / wave.std(), [1.0, 0.0, 0.5])
    lines = tones(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), "accel")
    assert all(line.where.driver != WANDERS for line in lines)


@pytest.mark.parametrize(("pace", "most"), [(2.3, 3), (2.8, 3)])
def test_an_overtone_of_steps_whose_pace_wanders_is_none(pace: float, most: int) -> None:
    """A phone on a treadmill, at 6.9 and 8.4 Hz; a fan at this frequency, without the lower ones, is told."""
    phase = wandering(4, pace, 0.03)
    whole = sum(np.sin(n * phase + n) for n in range(1, most + 1))
    assert not found(0.05 * whole)
    assert [line.where.driver for line in found(0.05 * np.sin(most * phase))] == [WANDERS]


def test_what_is_far_louder_for_a_while_is_not_in_the_amplitude() -> None:
    """A door that slams beside the fan: 15 s in which it shakes ten times as much."""
    loud = np.where((T > 100.0) & (T < 115.0), 10.0, 1.0)
    (line,) = found(0.05 * loud * np.sin(wandering(1, 13.1, 0.02)))
    assert line.where.driver == WANDERS
    assert np.allclose(line.parameters["amplitude"].value, [0.05, 0.0, 0.025], atol=0.0075)


def test_a_line_is_followed_over_rests_that_are_hours_apart() -> None:
    """It goes its way in each rest, and is anywhere in its range when the next one begins."""
    rng = np.random.default_rng(5)
    own = np.arange(0.0, 20.0, 1.0 / RATE)
    t = np.concatenate([own + 3600.0 * k for k in range(15)])
    begin = rng.permutation(np.linspace(11.0, 14.0, 15))
    wave = np.concatenate([np.sin(2.0 * np.pi * (f * own + 0.005 * own**2)) for f in begin])
    xyz = rng.normal([0.0, 0.0, 9.81], 0.02, (t.size, 3)) + 0.1 * np.outer(wave, [1.0, 0.0, 0.5])
    (line,) = tones(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), "accel")
    assert line.where.driver == WANDERS


def test_two_speeds_are_two_lines() -> None:
    first = T < 150.0
    wave = np.sin(2.0 * np.pi * np.where(first, 12.0, 12.8) * T)
    assert sorted(round(middle_hz(line), 1) for line in found(0.1 * wave)) == [12.0, 12.8]
    assert all(line.where.driver != WANDERS for line in found(0.1 * wave))


def test_a_steady_line_and_one_that_comes_and_goes_do_not_wander() -> None:
    steady = np.sin(2.0 * np.pi * 13.1 * T)
    (line,) = found(0.1 * steady)
    assert line.effect == "vibration_tone"
    (line,) = found(0.1 * steady * (T % 60.0 < 36.0))
    assert line.where.driver == COMES_AND_GOES
    (line,) = found(0.1 * np.sin(wandering(1, 13.1, 0.001)))
    assert line.effect == "vibration_tone", "20 s do not tell its frequencies apart"


def test_a_line_that_is_there_for_a_third_of_the_time_is_no_course_through_all_of_it() -> None:
    wave = 0.1 * np.sin(wandering(1, 13.1, 0.03)) * (T < 100.0)
    assert all(line.where.driver != WANDERS for line in found(wave))


@pytest.mark.parametrize("part", [0.02, 0.05])
def test_a_tremor_of_5_hz_is_no_vibration(part: float) -> None:
    """Neither one that wanders nor a steady one, of 0.07 m/s^2 at the frequency where it is for longest."""
    assert not found(0.1 * np.sin(wandering(1, 5.1, part)))


@pytest.mark.parametrize("amplitude", [0.015, 0.1])
def test_a_fan_beside_a_tremor_is_told(amplitude: float) -> None:
    tremor = 0.1 * np.sin(wandering(1, 5.1, 0.05))
    line = found(tremor + amplitude * np.sin(wandering(2, 13.1, 0.02)))[0]
    assert line.where.driver == WANDERS and round(middle_hz(line)) == 13


@pytest.mark.parametrize(("seed", "middle", "told"), [(2, 6.2, 1), (1, 5.8, 0)])
def test_a_fan_about_6_hz_is_told_with_all_of_its_range_or_not_at_all(
    seed: int, middle: float, told: int
) -> None:
    """Followed above 6 Hz alone, both were said not to go below 5.8 Hz."""
    phase = wandering(seed, middle, 0.1)
    lines = found(0.1 * np.sin(phase))
    assert len(lines) == told
    for line in lines:
        low, high = np.quantile(np.diff(phase) * RATE / (2.0 * np.pi), [0.025, 0.975])
        assert line.where.band_hz == pytest.approx((low, high), abs=0.05)


def test_both_sensors_hear_one_fan() -> None:
    """What they hear of it has not the very same middle frequency."""
    fan = replace(found(0.1 * np.sin(wandering(1, 13.1, 0.02)))[0], sensor="gyro")
    (low, high), frequency = fan.where.band_hz, fan.parameters["frequency"]
    other = replace(frequency, value=middle_hz(fan) + 0.3 * (high - low))
    assert of_one_vibration(fan, replace(fan, parameters=fan.parameters | {"frequency": other}))
    off = replace(frequency, value=middle_hz(fan) + 0.1 + 0.5 * (high - low))
    assert not of_one_vibration(fan, replace(fan, parameters=fan.parameters | {"frequency": off}))
