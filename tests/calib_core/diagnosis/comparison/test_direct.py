"""Effects that samples show directly: the numbers of two findings, side by side."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.direct import quantities_of
from stillcal.calib_core.diagnosis.comparison.quantity import subtract
from stillcal.calib_core.diagnosis.direct.spectral_line import tone
from stillcal.calib_core.streams.samples import Samples, Sensor


def shaken(amplitude: float, seed: int) -> Samples:
    """Return ten minutes on a table that vibrates along z, m/s^2, at 13.7 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 600.0, 0.02)
    xyz = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.01, (t.size, 3))
    xyz[:, 2] += amplitude * np.sin(2.0 * np.pi * 13.7 * t)
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz))


def evidence(amplitudes: tuple[float, float], seeds: tuple[int, int]) -> float:
    """Return the evidence, nats, that two lines differ."""
    one, other = (tone(shaken(a, s), "accel") for a, s in zip(amplitudes, seeds, strict=True))
    assert one is not None and other is not None
    pair = quantities_of(one, other)
    assert pair is not None
    return subtract(*pair).log_bayes_factor


def test_a_line_that_is_the_same_is_no_difference_where_an_axis_shows_nothing_of_it() -> None:
    quiet = tone(shaken(0.03, 1), "accel")
    heard = tone(shaken(0.03, 0), "accel")
    assert quiet is not None and heard is not None
    assert np.min(quiet.parameters["amplitude"].value) == 0.0 < np.min(heard.parameters["amplitude"].value)
    assert evidence((0.03, 0.03), (0, 1)) < 0.0
    assert evidence((0.03, 0.03), (1, 0)) < 0.0


def test_a_line_twice_as_strong_is_a_difference_whether_or_not_an_axis_shows_nothing_of_it() -> None:
    assert evidence((0.03, 0.06), (0, 1)) > 10.0
    assert evidence((0.06, 0.03), (1, 0)) > 10.0
    assert evidence((0.03, 0.06), (0, 0)) > 10.0
