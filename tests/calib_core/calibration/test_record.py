"""The calibration record: what it refuses, what it applies, and its identity."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.record import (
    AccelerometerRecord,
    CalibrationRecord,
    GyroscopeRecord,
    NotCalibratedError,
    Provenance,
    StateRecord,
)
from stillcal.calib_core.codec import canonical, jsonable, packed, unpacked
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Sensor

SCALE = np.array([[1.01, 0.002, -0.003], [0.001, 0.99, 0.0], [0.0, 0.004, 1.003]])
BIAS = np.array([0.1, -0.2, 0.3])


def accelerometer(**changes):
    plain = {"scale": SCALE, "bias": BIAS, "parameters": 12, "gravity": 9.81}
    return AccelerometerRecord(**(plain | changes))


def test_it_applies_the_published_formula_to_each_sensor():
    gyroscope = GyroscopeRecord(scale=np.eye(3), bias=2 * BIAS, parameters=3)
    record = CalibrationRecord(accelerometer=accelerometer(), gyroscope=gyroscope)
    raw = np.array([[0.0, 1.0, 9.0], [3.0, -4.0, 5.0]])
    expected = np.array([SCALE @ (row - BIAS) for row in raw])
    np.testing.assert_allclose(record.apply(raw, Sensor.ACCELEROMETER), expected, rtol=1e-14)
    np.testing.assert_allclose(record.apply(raw, Sensor.GYROSCOPE), raw - 2 * BIAS, rtol=1e-14)


def test_a_sensor_without_a_calibration_is_refused():
    with pytest.raises(NotCalibratedError, match="no gyroscope"):
        CalibrationRecord(accelerometer=accelerometer()).apply(np.zeros(3), Sensor.GYROSCOPE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scale": np.eye(2)}, "expected"),
        ({"bias": [1.0, np.nan, 0.0]}, "finite"),
        ({"scale": np.zeros((3, 3))}, "det"),
        ({"scale": 3 * np.eye(3)}, "det"),
        ({"gravity": -9.81}, "gravity"),
        ({"gravity": float("nan")}, "gravity"),
        ({"parameters": 0}, "parameters"),
        ({"n_rests": 3, "n_states": 4}, "n_states"),
        ({"rms_residual": -1.0}, "rms_residual"),
        ({"covariance": np.zeros((2, 3))}, "square"),
        ({"covariance": np.eye(3), "names": ("b_x",)}, "one row per name"),
        ({"covariance": -np.eye(3)}, "negative variance"),
    ],
)
def test_what_makes_no_sense_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        accelerometer(**changes)


def test_a_left_handed_sensor_is_sane():
    assert accelerometer(scale=np.diag([1.0, 1.0, -1.0])).scale[2, 2] == -1.0


def test_a_calibration_of_nothing_is_refused():
    with pytest.raises(ValueError, match="accelerometer part, a gyroscope part"):
        CalibrationRecord()


@pytest.mark.parametrize("gravity", [Gravity(value=3.7), Gravity(uncertainty=float("nan"))])
def test_a_gravity_that_no_place_on_earth_has_is_refused(gravity):
    with pytest.raises(ValueError, match="gravity"):
        CalibrationRecord(accelerometer=accelerometer(), gravity=gravity)


def test_its_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        accelerometer().scale[0, 0] = 2.0


def test_its_id_is_of_what_was_found_alone():
    record = CalibrationRecord(accelerometer=accelerometer(), fitted_at=5.0)
    elsewhere = dataclasses.replace(record, provenance=Provenance(source="/dev/ttyUSB0"))
    other = dataclasses.replace(record, accelerometer=accelerometer(bias=BIAS + 1e-15))
    assert record.id == elsewhere.id
    assert record.id != other.id
    assert record.id == dataclasses.replace(record, fitted_at=5).id


def test_it_travels_through_messagepack_whole():
    term = Term(
        effect="accel_bias_temperature",
        sensor=Sensor.ACCELEROMETER,
        parameters={"slope": TermParameter(value=np.array([0.011, 0.0, -0.008]), unit="m/s^2/K")},
        reference={"temperature": 25.0},
    )
    record = CalibrationRecord(accelerometer=accelerometer(), gravity=Gravity(), terms=(term,))
    again = unpacked(packed(record), CalibrationRecord)
    assert jsonable(again) == jsonable(record)
    assert again.id == record.id


def test_a_state_is_the_rest_it_summarises():
    rest = RestState(
        t_start=1.0,
        t_end=4.0,
        n=300,
        specific_force=np.array([0.0, 0.1, 9.8]),
        force_sd=np.full(3, 0.02),
        force_uncertainty=np.full(3, 0.002),
        level=0.03,
        temperature=30.0,
    )
    state = StateRecord.of(rest, residual=0.004, attitude=2)
    assert (state.t_start, state.t_end, state.n, state.temperature) == (1.0, 4.0, 300, 30.0)
    assert (state.residual, state.attitude) == (0.004, 2)
    assert state.specific_force is rest.specific_force


def test_what_is_not_finite_becomes_unknown():
    assert jsonable({"a": [1.0, float("inf")], "b": (float("nan"),)}) == {"a": [1.0, None], "b": [None]}


def test_canonical_json_refuses_what_json_cannot_say():
    with pytest.raises(ValueError, match="JSON"):
        canonical({"a": float("nan")})
