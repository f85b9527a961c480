"""Temperature of real recordings: too short to learn a curve from, and none is claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.studies.real_temperature import FLIGHT, Polynomials, rows


def test_polynomials_taken_off_are_the_autopilots_own(data_dir: Path) -> None:
    """By hand, for one reading 10 K above the reference and one beyond the span that was calibrated."""
    polynomials = Polynomials(data_dir, 1)
    slope = np.array([700.9871826171875, 2915.08203125, -848.5621948242188])
    square = np.array([0.5652757287025452, 3.3540759086608887, -61.160640716552734])
    cube = np.array([0.35760030150413513, -0.8179653286933899, 6.313325881958008])
    found = polynomials.bias(Sensor.ACCELEROMETER, np.array([45.0, 55.467201232910156, 80.0]))
    assert np.allclose(found[0], 1e-6 * (10 * slope + 100 * square + 1000 * cube))
    assert np.array_equal(found[1], found[2])
    raw = Samples.checked(
        Sensor.ACCELEROMETER, np.array([0.0]), np.zeros((1, 3)), np.array([44.95793914794922])
    )
    assert np.allclose(polynomials.undone(raw).xyz, 0.0)


def test_no_curve_is_claimed_from_minutes_and_the_thermometer_does_no_harm(data_dir: Path) -> None:
    found = list(rows(data_dir))
    assert len(found) == 17 and not any(row.taken_up for row in found)
    learnt = [row for row in found if np.isfinite([row.before, row.after]).all()]
    assert len(learnt) == 15
    for row in learnt:
        assert row.after <= row.before and row.after <= 1.1 * row.withheld, row
    (moved,) = [
        row.moved
        for row in found
        if row.name == f"{FLIGHT}, sensor 2, polynomials undone" and row.sensor is Sensor.GYROSCOPE
    ]
    assert moved is not None and moved > 0.05  # deg/s, of a recording with 2.8 K
