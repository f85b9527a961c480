"""Effects that only turns show: the gyroscope's scale by temperature, and its nonlinearity."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from stillcal.api import calibrate
from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.terms import correct
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone import load_phone, simulate
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.scenario import Scenario
from tests.support.adopted import with_terms

SCALE = np.array([1.01, 0.99, 1.01])
QUADRATIC, CUBIC = np.array([0.01, -0.012, 0.01]), np.array([0.004, 0.004, -0.004])
SLOPE = np.array([3e-3, -3e-3, 3e-3])
W = 4.0 * np.sin(np.outer(np.arange(400) / 25.0, [1.3, 1.7, 2.1]))
"""True rates that no calibration saw, rad/s."""

NONLINEAR = {"name": "gyro_nonlinearity", "quadratic": QUADRATIC.tolist(), "cubic": CUBIC.tolist()}


def finding(effect: str, **values: np.ndarray) -> dict[str, object]:
    told = {name: {"value": value.tolist(), "unit": ""} for name, value in values.items()}
    return {"effect": effect, "parameters": told, "where": {"t_start": 0.0}}


def calibrated(*effects: dict[str, object]) -> CalibrationRecord:
    """Return the calibration of a phone with those effects, from ten minutes of attitudes by hand."""
    quiet = msgspec.to_builtins(load_phone("ideal"))
    for sensor, noise in (("accel", 2e-3), ("gyro", 2e-4)):
        quiet[sensor] |= {"rate_hz": 25.0, "noise": {"white": noise}}
    quiet["gyro"]["scale"] = np.diag(SCALE).tolist()
    phone = msgspec.convert(quiet | {"effect": list(effects)}, type=Phone)
    poses = {"segment": [{"activity": "poses", "count": 44, "rest_s": [11.0, 12.0]}]}
    made = simulate(msgspec.convert(poses, type=Scenario), phone, 1).whole()
    claims = msgspec.convert(phone.claimed(), Claims)
    return calibrate(Recording(made.accelerometer, made.gyroscope, list(made.events), claims, [])).record


def left(record: CalibrationRecord, error: np.ndarray, celsius: np.ndarray) -> float:
    """Return the error (rms, rad/s) that a calibration leaves in rates read with an error."""
    assert record.gyroscope is not None
    raw = SCALE * W + record.gyroscope.bias + error
    samples = Samples(Sensor.GYROSCOPE, frozen(np.arange(len(W)) / 25.0), frozen(raw), frozen(celsius))
    return rms(correct(record, samples).xyz - W)


@pytest.fixture(scope="module")
def nonlinear() -> CalibrationRecord:
    return calibrated(NONLINEAR)


def test_a_nonlinear_gyroscope_is_corrected_and_its_scale_set_free(nonlinear: CalibrationRecord) -> None:
    """The scale that was fitted to turns held a part of the cube, and gives it back."""
    assert nonlinear.gyroscope is not None and nonlinear.gyroscope.parameters > 3
    known = with_terms(nonlinear, [finding("gyro_nonlinearity", quadratic=QUADRATIC, cubic=CUBIC)])
    assert known.acceptance.reason == "gyro_nonlinearity taken up from a diagnosis"
    error, celsius = QUADRATIC * W**2 + CUBIC * W**3, np.full(len(W), 25.0)
    before, after = (left(r, error, celsius) for r in (nonlinear, known))
    assert after < before / 3
    unfreed = replace(known, gyroscope=replace(known.gyroscope, scale=nonlinear.gyroscope.scale))
    assert after < left(unfreed, error, celsius) / 2
    assert np.diag(known.gyroscope.covariance)[0] > np.diag(nonlinear.gyroscope.covariance)[0]


def test_without_the_speed_of_its_turns_a_nonlinearity_is_refused(nonlinear: CalibrationRecord) -> None:
    old = replace(nonlinear, gyroscope=replace(nonlinear.gyroscope, turn_powers=None))
    with pytest.raises(NotSupported, match="how fast the turns were"):
        with_terms(old, [finding("gyro_nonlinearity", quadratic=QUADRATIC)])


def test_a_gyroscopes_scale_that_follows_temperature_is_corrected(nonlinear: CalibrationRecord) -> None:
    known = with_terms(nonlinear, [finding("gyro_scale_temperature", slope=SLOPE)])
    at = known.terms[0].reference["temperature"]
    celsius = at + 15.0 + np.arange(len(W)) / 80.0
    bare = replace(nonlinear, gyroscope=replace(nonlinear.gyroscope, scale=np.diag(1.0 / SCALE)))
    warm = replace(known, gyroscope=bare.gyroscope)
    error = SCALE * W * (celsius - at)[:, None] * SLOPE
    assert left(warm, error, celsius) < left(bare, error, celsius) / 100
