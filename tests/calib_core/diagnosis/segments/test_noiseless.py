"""A sensor without any noise is judged with that of a quiet one; any other is left as it is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.noise_range import QUIETEST
from stillcal.calib_core.diagnosis.segments.noiseless import FAINT, audible, with_noise
from stillcal.calib_core.diagnosis.segments.static_bins import overview_of
from stillcal.calib_core.diagnosis.segments.windows import windows
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 50.0
SD = QUIETEST[Sensor.ACCELEROMETER] * np.sqrt(RATE / 2.0)
"""m/s^2 of a sample."""


def samples(xyz: Array) -> Samples:
    return Samples.checked(Sensor.ACCELEROMETER, np.arange(len(xyz)) / RATE, xyz)


def turned(noise: float = 0.0, slope: float = 0.0) -> Array:
    """Return an axis that is turned now and then, for 60 s, and two that are not, (3000, 3)."""
    t = np.arange(3000) / RATE
    move = 4.0 * np.sin(2.0 * np.pi * t) * (t % 20.0 < 3.0)
    still = np.array([0.3, 0.0, 9.8]) + np.outer(slope * t, [0.0, 1.0, 0.0])
    return np.asarray(
        still + np.outer(move, [1.0, 0.0, 0.0]) + noise * np.random.default_rng(1).normal(size=(3000, 3))
    )


def with_its_noise(xyz: Array) -> Array | None:
    one = samples(xyz)
    made = with_noise(one, windows(one, 0.0, 60.0))
    return None if made is None else np.asarray(made[0].xyz)


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_a_sensor_without_noise_gets_that_of_a_quiet_one_where_it_moves(slope: float) -> None:
    """Also where its bias drifts: by 0.02 m/s^2 a second, which is as much as its noise within one."""
    xyz = turned(slope=slope)
    made = with_its_noise(xyz)
    assert made is not None
    sd = (made - xyz).std(axis=0)
    assert sd[0] == pytest.approx(SD, rel=0.05) and sd[2] == 0.0, "an axis that never changes stays dead"
    assert (sd[1] > 0.0) == (slope > 0.0)
    assert (with_its_noise(xyz) == made).all()


def test_an_axis_of_a_gyroscope_that_stays_the_same_while_it_turns_is_dead() -> None:
    turning = np.maximum(np.sin(np.arange(3000) / RATE / 3.0), 0.0)
    one = Samples(Sensor.GYROSCOPE, np.arange(3000) / RATE, np.outer(turning, [1.0, 0.5, 0.0]))
    made = with_noise(one, windows(one, 0.0, 60.0))
    assert made is not None
    assert (made[0].xyz - one.xyz).std(axis=0)[2] == 0.0


def test_at_rest_an_axis_may_stay_the_same_and_is_not_dead() -> None:
    """Two axes whose bias drifts got noise, and the third one was then called dead."""
    made = with_its_noise(np.array([0.3, 0.0, 9.8]) + np.outer(np.arange(3000) / RATE, [1e-3, 2e-3, 0.0]))
    assert made is not None
    assert made[:, 2].std() == pytest.approx(SD, rel=0.05)


def low_passed(seed: int) -> Array:
    """Return noise of 0.01 m/s^2 behind a sharp low-pass, (3000, 3)."""
    values = lfilter(*butter(4, 0.1), np.random.default_rng(seed).normal(size=(3000, 3)), axis=0)
    return np.asarray(0.01 * values / values.std())


@pytest.mark.parametrize(
    ("hertz", "noise", "silent"), [(6.2, 0.0, True), (6.2, 1.0, False), (0.0, 1.0, False)]
)
def test_a_vibration_is_no_noise_and_noise_of_a_narrow_band_is(
    hertz: float, noise: float, silent: bool
) -> None:
    vibration = 0.05 * np.sin(2.0 * np.pi * hertz * np.arange(3000) / RATE)
    xyz = turned() + vibration[:, None] * [1.0, 0.5, 0.2] + noise * low_passed(3)
    assert (with_its_noise(xyz) is not None) == silent


def test_noise_behind_a_low_filter_is_noise_and_a_smooth_sway_is_none() -> None:
    """A chip at 1000 Hz with its filter at 5 Hz: neighbouring samples differ by less than a step."""
    t = np.arange(20000) / 1000.0
    rng = np.random.default_rng(4)
    noise = lfilter(*butter(3, 5.0, fs=1000.0), rng.normal(size=(20000, 3)), axis=0)
    sway = np.outer(
        0.02 * np.sin(2.0 * np.pi * 0.2 * t) + 0.01 * np.sin(2.0 * np.pi * 0.33 * t), [1.0, 0.5, 0.2]
    )
    still = np.array([0.3, 0.2, 9.8]) + sway
    for xyz, silent in ((still + 0.003 * noise / noise.std(), False), (still, True)):
        one = Samples(Sensor.ACCELEROMETER, t, np.round(xyz / 6e-4) * 6e-4 if not silent else xyz)
        assert (with_noise(one, windows(one, 0.0, 20.0)) is not None) == silent


def test_the_seconds_get_as_much() -> None:
    one = samples(turned())
    seen = windows(one, 0.0, 60.0)
    made = with_noise(one, seen)
    assert made is not None
    assert (made[1].mean - seen.mean)[:, 0].std() == pytest.approx(SD / np.sqrt(RATE), rel=0.3)
    np.testing.assert_allclose(made[1].variance[:, 0] - seen.variance[:, 0], SD**2, rtol=1e-6)


@pytest.mark.parametrize(
    "xyz",
    [
        turned(noise=3.0 * FAINT * SD),
        np.round(turned(noise=0.001) / 0.04) * 0.04,
        0.04 * np.rint(0.2 * np.random.default_rng(2).normal(size=(3000, 3))),
        np.repeat(turned(noise=SD)[::4], 4, axis=0),
        np.full((3000, 3), 9.8),
    ],
    ids=["noise", "steps", "few codes", "held", "dead"],
)
def test_one_with_noise_or_steps_or_no_change_is_left_as_it_is(xyz: Array) -> None:
    assert with_its_noise(xyz) is None


def test_printed_decimals_are_no_steps_that_hide_noise() -> None:
    assert with_its_noise(np.round(turned(), 4)) is not None


def test_a_simulation_at_rest_that_never_changes_has_no_noise_and_gets_none() -> None:
    """It was said that its noise is "not white over most of the band"."""
    still = samples(np.full((3000, 3), 9.8))
    made, _, _, silent = audible(still, None, overview_of(still, None))
    assert made is still and silent == {"accel"}
