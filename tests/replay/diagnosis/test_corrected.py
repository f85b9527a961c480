"""A scale that is put into a simulation's samples is the recording's, to the second order too."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.compare import Discrepancy
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, subtract
from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.corrected import correct
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording

MIS = ((0, 1), (0, 2), (1, 2))


def quantity(sensor: str, matrix: np.ndarray) -> Quantity:
    if sensor == "gyro":
        value, parts = (matrix - np.eye(3)).ravel(), (Part("scale", "1", 9),)
    else:
        value = np.array([*(matrix.diagonal() - 1.0), *(matrix[p] for p in MIS)])
        parts = (Part("scale", "1", 3), Part("misalignment", "rad", 3))
    k = value.size
    where = Where(0.0, 1.0, (0.0, 1.0), "nothing")
    return Quantity(
        f"{sensor}_scale", sensor, parts, value, 1e-8 * np.eye(k), np.full(k, 0.1), np.full(k, 1e-4),
        np.full(k, -1), where=where,
    )  # fmt: skip


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_readings_become_those_of_the_recorded_sensor(sensor: str) -> None:
    rng = np.random.default_rng(4)
    true, bias = rng.normal(size=(50, 3)), np.array([0.2, -0.1, 0.3])
    both = [np.eye(3) + 0.05 * rng.normal(size=(3, 3)) for _ in range(2)]
    both = [(m + m.T) / 2.0 for m in both] if sensor == "accel" else both
    recorded, simulated = (true @ np.linalg.inv(m).T + bias for m in both)
    t = np.arange(50) / 50.0
    samples = {s: Samples(kind, t, simulated) for s, kind in zip(("accel", "gyro"), Sensor, strict=True)}
    recording = Recording(samples["accel"], samples["gyro"], [], Claims(), [])
    difference = subtract(*(quantity(sensor, m) for m in both))
    one = Discrepancy(
        f"{sensor}_scale",
        sensor,
        [],
        Where(0.0, 1.0, (0.0, 1.0), "nothing"),
        "too_small",
        1.0,
        9.0,
        difference,
    )
    done = correct(recording, [one], {sensor: bias})
    out = done.recording.accelerometer if sensor == "accel" else done.recording.gyroscope
    assert out is not None and done.left_out == []
    np.testing.assert_allclose(out.xyz, recorded, rtol=0.0, atol=1e-12)
