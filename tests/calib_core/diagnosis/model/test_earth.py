"""The Earth's rate is one vector, as far as the gyroscope carries the phone's heading from rest to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.clear_bins import still_bins
from stillcal.calib_core.diagnosis.effects.by_force import GSensitivity
from stillcal.calib_core.diagnosis.inference.bayes_factor import log_bayes_factor
from stillcal.calib_core.diagnosis.inference.likelihood import reduce_residuals
from stillcal.calib_core.diagnosis.model.earth import RATE, ground
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.maths.rotation import attitudes, matrix
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.support.diagnosis.nulls import G

HZ, REST_S, TURN_S, RESTS = 25.0, 42.0, 4.0, 16


def made(g_sensitivity: float = 0.0) -> tuple[Samples, Samples, Array]:
    """Return both sensors of a phone that is turned 15 times, and north in its axes (n, 3).

    g_sensitivity: of the z axis to the x axis' force, (rad/s)/(m/s^2).
    """
    rng = np.random.default_rng(5)
    t = np.arange(0.0, RESTS * REST_S + (RESTS - 1) * TURN_S, 1.0 / HZ)
    rate = np.zeros((t.size, 3))
    for k in range(RESTS - 1):
        phase = (t - (k + 1) * REST_S - k * TURN_S) / TURN_S
        speed = np.where((phase > 0.0) & (phase < 1.0), 1.0 - np.cos(2.0 * np.pi * phase), 0.0)
        axis = rng.normal(size=3)
        rate += speed[:, None] * axis / np.linalg.norm(axis) * rng.uniform(0.8, 2.0) / TURN_S
    body = matrix(attitudes(t, rate))
    up, north = body[:, 2, :], body[:, 0, :]
    force = G * up
    read = rate + RATE * (0.6 * up + 0.8 * north) + 0.003 + rng.normal(0.0, 4e-4, rate.shape)
    read[:, 2] += g_sensitivity * force[:, 0]
    force = force + rng.normal(0.0, 0.01, force.shape)
    return (
        Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force)),
        Samples(Sensor.GYROSCOPE, frozen(t), frozen(read)),
        north,
    )


def carried(gyroscope: Samples, bins: Bins) -> tuple[Array, Array]:
    found = ground(gyroscope, bins, bins.force / np.linalg.norm(bins.force, axis=1, keepdims=True))
    return found.north, found.trust


def angles(north: Array, true: Array, bins: Bins) -> Array:
    """Return by how much each bin's angle from the true north differs from the first bin's, rad."""
    up = bins.force / np.linalg.norm(bins.force, axis=1, keepdims=True)
    angle = np.arctan2(np.einsum("ni,ni->n", np.cross(true, north), up), np.einsum("ni,ni->n", true, north))
    return np.asarray(np.angle(np.exp(1j * (angle - angle[0]))))


def test_the_heading_is_carried_through_the_turns() -> None:
    accelerometer, gyroscope, true = made()
    bins = still_bins(accelerometer, gyroscope)
    north, trust = carried(gyroscope, bins)
    level = true[np.searchsorted(accelerometer.t, bins.t)]
    assert np.abs(angles(north, level, bins)).max() < 0.02
    assert trust.min() > 0.95


def test_a_gap_in_a_turn_loses_the_heading() -> None:
    accelerometer, gyroscope, _ = made()
    bins = still_bins(accelerometer, gyroscope)
    middle = 10.0 * REST_S + 9.5 * TURN_S
    keep = np.abs(gyroscope.t - middle) > 0.6
    torn = replace(gyroscope, t=frozen(gyroscope.t[keep]), xyz=frozen(gyroscope.xyz[keep]))
    _, trust = carried(torn, bins)
    assert trust[bins.t < middle].min() > 0.95
    assert trust[bins.t > middle].max() == 0.0


@pytest.mark.parametrize(("g_sensitivity", "sure"), [(0.0, False), (8e-6, True)])
def test_a_g_sensitivity_as_large_as_the_earths_rate_shows_where_headings_are_known(
    g_sensitivity: float, sure: bool
) -> None:
    accelerometer, gyroscope, _ = made(g_sensitivity)
    bins = still_bins(accelerometer, gyroscope)
    evidence = []
    for samples in (gyroscope, None):
        residuals = by_sensor(bins, G, gyroscope=samples)[1]
        (own,) = residuals.hypotheses(GSensitivity())
        evidence.append(log_bayes_factor(reduce_residuals(residuals, [own], parts=True), 1, 1))
    known, unknown = evidence
    assert (known > 7.0) == sure
    assert not sure or known > unknown + 5.0
