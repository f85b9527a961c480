"""The Earth's rotation in body axes, carried through a whole recording by the other gyroscope."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.pair.earth import of_ground
from stillcal.calib_core.diagnosis.segments.static_bins import cut_all, in_motion
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 50.0


@pytest.mark.parametrize(("gain", "earth"), [(1.0, (0.3, 0.5, 0.8)), (1.05, (0.0, 0.0, 1.0))])
def test_a_vector_of_the_ground_is_followed_by_a_gyroscope_with_errors(
    gain: float, earth: tuple[float, float, float]
) -> None:
    """Turns of 4 s between rests of 16 s; gravity corrects the tilt that a wrong scale makes."""
    t = np.arange(0.0, 600.0, 1.0 / RATE)
    progress = (1.0 - np.cos(np.pi * np.clip(t % 20.0 - 16.0, 0.0, 4.0) / 4.0)) / 2.0 + t // 20.0
    about = Rotation.from_euler("XYZ", np.stack([1.3 * progress, 0.9 * progress, 0.5 * progress], axis=1))
    rate = (about[:-1].inv() * about[1:]).as_rotvec() * RATE
    rng = np.random.default_rng(0)
    rate = (
        gain * np.vstack([rate, rate[-1]])
        + np.array([0.004, -0.006, 0.002])
        + rng.normal(0.0, 1e-3, (t.size, 3))
    )
    force = about.inv().apply([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.01, (t.size, 3))
    accel, gyro = (
        Samples(sensor, frozen(t), frozen(xyz))
        for sensor, xyz in ((Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, rate))
    )
    bins = cut_all(accel, gyro, [], (0.0, float(t[-1])))
    still = in_motion(accel, gyro, bins) == 0.0
    mean = [
        about[(t >= a) & (t < b)].inv().apply(earth).mean(axis=0)
        for a, b in zip(bins.t - bins.duration / 2, bins.t + bins.duration / 2, strict=True)
    ]
    assert still.sum() > 12
    np.testing.assert_allclose(of_ground(gyro, bins, still) @ earth, mean, atol=0.1)
