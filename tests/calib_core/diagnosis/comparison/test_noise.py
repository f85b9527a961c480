"""Why white noise is not compared: the reason is the one that holds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from stillcal.calib_core.diagnosis.comparison.noise import density, why_no_density
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 50.0


def noise(kind: str) -> np.ndarray:
    """Return ten minutes of noise of 0.02 m/s^2, (n, 3)."""
    rng = np.random.default_rng(3)
    shape = (int(600.0 * RATE), 3)
    if kind == "heavy":
        return 0.02 * rng.standard_t(3.0, shape) / np.sqrt(3.0)
    white = 0.02 * rng.normal(size=shape)
    return np.asarray(lfilter([1.0], [1.0, -0.95], white, axis=0)) if kind == "coloured" else white


@pytest.mark.parametrize(
    ("kind", "reason"), [("heavy", "differs between rests"), ("coloured", "is not white"), ("white", None)]
)
def test_the_reason_for_no_density_is_the_true_one(kind: str, reason: str | None) -> None:
    xyz = np.array([0.0, 0.0, 9.80665]) + noise(kind)
    stream = examine(Samples(Sensor.ACCELEROMETER, np.arange(len(xyz)) / RATE, xyz), None).streams[0]
    if reason is None:
        assert density(stream) is not None
    else:
        assert density(stream) is None and reason in why_no_density(stream)
