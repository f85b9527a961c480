"""A support that gives way moves the phone; both sensors see it, and neither is to blame."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.clear_bins import still_bins
from stillcal.calib_core.diagnosis.diagnose import diagnose
from stillcal.calib_core.diagnosis.model import rates
from stillcal.calib_core.diagnosis.model.residuals import fit_baseline, tilted
from stillcal.calib_core.streams.samples import Samples, Sensor

G = 9.80665
RATE_HZ = 50.0


def rates_on_foam(
    rng: np.random.Generator, rests: int, length: tuple[float, float], angle_rad: tuple[float, float]
) -> Array:
    """Return a body rate (n, 3) rad/s: rests in which the phone sinks in, with turns between them."""
    parts = []
    for _ in range(rests):
        t = np.arange(int(rng.uniform(*length) * RATE_HZ)) / RATE_HZ
        angle, tau = rng.uniform(*angle_rad), rng.uniform(30.0, 100.0)
        parts.append(_axis(rng) * (angle / tau * np.exp(-t / tau))[:, None])
        s = np.arange(int(3.0 * RATE_HZ)) / (3.0 * RATE_HZ)
        parts.append(_axis(rng) * (rng.uniform(0.7, 2.6) / 3.0 * (1.0 - np.cos(2.0 * np.pi * s)))[:, None])
    return np.concatenate(parts)


def _axis(rng: np.random.Generator) -> Array:
    axis = rng.normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))


def on_foam(
    seed: int,
    rests: int = 12,
    length: tuple[float, float] = (60.0, 150.0),
    angle_rad: tuple[float, float] = (20e-3, 50e-3),
) -> tuple[Samples, Samples]:
    rng = np.random.default_rng(seed)
    turned = rates_on_foam(rng, rests, length, angle_rad)
    n = len(turned)
    steps = Rotation.from_rotvec(turned / RATE_HZ).as_matrix()
    up, ups = np.array([0.1, 0.2, 0.97]) / np.linalg.norm([0.1, 0.2, 0.97]), np.empty((n, 3))
    for i in range(n):
        ups[i] = up
        up = steps[i].T @ up
    middle = (turned + np.vstack([turned[:1], turned[:-1]])) / 2.0
    shaken = (np.linalg.norm(turned, axis=1) > 0.1)[:, None] * rng.normal(size=(n, 3)) * 0.3
    force = G * ups + shaken + [0.05, -0.1, 0.02] + rng.normal(size=(n, 3)) * 0.012
    rate = middle + [0.01, -0.004, 0.002] + rng.normal(size=(n, 3)) * 0.001
    t = np.arange(n) / RATE_HZ
    return Samples(Sensor.ACCELEROMETER, t, force), Samples(Sensor.GYROSCOPE, t, rate)


def test_the_rate_of_tilt_is_read_from_gravity() -> None:
    force, rate = on_foam(1)
    bins = still_bins(force, rate)
    assert bins.rate is not None
    up = tilted(bins.force, fit_baseline(bins.force, bins.force_variance, bins.rest, G).parameters)[0]
    seen = rates.tilt_rate(bins, up)
    across = bins.rate - np.median(bins.rate, axis=0)
    across = across - np.sum(across * up, axis=1, keepdims=True) * up
    fast = np.linalg.norm(across, axis=1) > 5e-4
    assert fast.sum() >= 5
    assert np.linalg.norm(seen - across, axis=1)[fast] == pytest.approx(0.0, abs=2.5e-4)


@pytest.mark.slow
def test_a_phone_that_sinks_into_foam_has_no_faulty_sensor() -> None:
    for seed in (2, 3):
        assert [f.effect for f in diagnose(*on_foam(seed)).findings] == []


def test_rests_of_two_bins_and_fewer_sink_in_as_well() -> None:
    """Their tilt is a line through two bins, or no better known than that of the others."""
    found = diagnose(*on_foam(4, rests=30, length=(14.0, 40.0), angle_rad=(5e-3, 25e-3))).findings
    assert [f.effect for f in found] == []
