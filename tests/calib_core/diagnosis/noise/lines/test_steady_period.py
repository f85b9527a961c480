"""What comes again every few seconds all along has no name, and bodies that sway are silent."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.noise.lines.steady_period import DRIVER, steady_period
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 25.0


def gyroscope(seconds: float, seed: int, added: np.ndarray | float = 0.0) -> Samples:
    """Return a gyroscope at rest; added: (n,) rad/s on z."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 1.0 / RATE)
    rate = 5e-4 * rng.standard_normal((t.size, 3))
    rate[:, 2] += added
    return Samples.checked(Sensor.GYROSCOPE, t, rate)


def bursts(seconds: float) -> np.ndarray:
    """Return 8e-4 rad/s for 0.9 s in every 3.7 s, as of a radio that sends."""
    return 8e-4 * (np.arange(0.0, seconds, 1.0 / RATE) % 3.7 < 0.9)


def breath(seconds: float, seed: int, unsteady: float) -> np.ndarray:
    """Return a sway with a period of 3.7 s, in which each one differs from the one before."""
    rng = np.random.default_rng(seed)
    periods = 3.7 * (1.0 + unsteady * rng.standard_normal(int(seconds)))
    begins = np.concatenate([[0.0], np.cumsum(np.maximum(periods, 1.0))])
    t = np.arange(0.0, seconds, 1.0 / RATE)
    return 8e-4 * np.sin(2.0 * np.pi * np.interp(t, begins, np.arange(begins.size)))


def test_bursts_of_a_steady_period_are_found_and_have_no_name() -> None:
    found = steady_period(gyroscope(900.0, 1, bursts(900.0)), "gyro")
    assert found is not None and (found.effect, found.where.driver, found.axes) == ("unknown", DRIVER, ["z"])
    assert 3.7 * float(np.max(found.parameters["frequency"].value)) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("seconds", [150.0, 900.0, 2400.0])
@pytest.mark.parametrize("unsteady", [0.05, 0.1])
def test_a_body_that_breathes_is_silent(seconds: float, unsteady: float) -> None:
    """In 150 s a breath keeps its phase to what the recording tells apart; periods so slow are not judged."""
    for seed in range(4):
        assert steady_period(gyroscope(seconds, seed, breath(seconds, seed, unsteady)), "gyro") is None
    assert steady_period(gyroscope(seconds, 9), "gyro") is None
