"""A bias that follows the thermometer late: the lag is found on evidence, and used where a bias is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.bias_curve.learn import learn_gyroscope
from stillcal.calib_core.calibration.bias_curve.learnt import held_term
from stillcal.calib_core.calibration.corrections.term import lag_of
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.following import with_learnt_gyroscope
from stillcal.calib_core.calibration.record import CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.calibration.terms import bias_terms, correct
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.temperature.memory import Memory
from stillcal.calib_core.temperature.thermometer import Thermometer

GRID_S, HOUR, DEG = 10.0, 3600.0, np.pi / 180
SLOPE = 0.02 * DEG * np.array([1.0, -0.6, 0.3])
T = np.arange(0.0, 30 * HOUR, GRID_S)
GYRO = Sensor.GYROSCOPE


def late(celsius: Array, lag_s: float) -> Array:
    """Return a first-order filter's answer, by Euler's small steps: another formula than the one tested."""
    value, out = celsius[0], np.empty_like(celsius)
    for row, now in enumerate(celsius.tolist()):
        value += (now - value) * GRID_S / lag_s
        out[row] = value
    return out


def warmth(seed: int) -> Array:
    """Return temperatures of a phone in use, degC: warm for some minutes now and then, as read by 0.1 K."""
    rng, heating = np.random.default_rng(seed), np.zeros(len(T))
    for begin in np.cumsum(rng.uniform(1200.0, 4000.0, 60)):
        heating[(begin < T) & (begin + rng.uniform(300.0, 1500.0) > T)] = rng.uniform(4.0, 10.0)
    return 22.0 + late(heating, 200.0)


def learnt_day(
    lag_s: float, seed: int, readings: bool = True
) -> tuple[CalibrationRecord, Thermometer, Array]:
    """Live 30 h with a rest every quarter of an hour; return the record, the last readings and the bias."""
    rng, celsius = np.random.default_rng(seed + 100), warmth(seed)
    read = np.round(celsius, 1)
    bias = 0.5 * DEG + np.outer((late(celsius, lag_s) if lag_s else celsius) - 22.0, SLOPE)
    record = CalibrationRecord(gyroscope=GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3))
    memory, thermometer, sd = Memory(), Thermometer(), frozen(np.full(3, 5e-4 * DEG))
    zero = frozen(np.array([0.0, 0.0, 9.8]))
    for number, row in enumerate(range(60, len(T), 90)):
        t = float(T[row])
        if readings:
            thermometer = thermometer.with_readings(T[row - 60 : row], read[row - 60 : row])
        rate = frozen(bias[row] + 5e-4 * DEG * rng.standard_normal(3))
        at = float(read[row])
        late_by = thermometer.lagged(t, at)
        rest = RestState(
            t - 5.0, t + 5.0, 500, zero, sd, sd, 0.01, rate, sd, sd, None, None, None, at, late_by
        )
        memory = memory.with_rest(rest, 9.8)
        if number % 8 == 7 and (learnt := learn_gyroscope(memory, record, t, QualitySettings())) is not None:
            record = with_learnt_gyroscope(record, learnt, t)
    return record, thermometer.with_readings(T[-360:], read[-360:]), bias


@pytest.mark.parametrize(("lag_s", "found"), [(300.0, (240.0, 480.0)), (100.0, (60.0, 120.0)), (0.0, (0.0,))])
def test_the_lag_is_found_and_none_where_there_is_none(lag_s: float, found: tuple[float, ...]) -> None:
    record, _, _ = learnt_day(lag_s, 1)
    term = held_term(record.terms, GYRO)
    assert term is not None and lag_of(term) in found
    assert record.forecast[GYRO].lag_s == lag_of(term)
    assert term.parameters["slope"].value == pytest.approx(SLOPE, rel=0.2, abs=1e-3 * DEG)


def test_samples_are_corrected_with_the_lag_however_they_are_cut() -> None:
    record, _, bias = learnt_day(300.0, 2)
    celsius = np.round(warmth(2), 1)
    day = Samples(GYRO, frozen(T), frozen(bias), frozen(celsius))
    part, ready = record.gyroscope, 720
    assert part is not None
    still = replace(record, gyroscope=replace(part, bias=frozen(bias[-1] - told(record, day)[-1])))
    whole = correct(still, day).xyz[ready:]
    unlagged = (day.xyz - still.gyroscope.bias - bias_terms(still, GYRO, celsius))[ready:]
    assert np.abs(whole).max() < 0.5 * np.abs(unlagged).max()
    heard, pieces = Thermometer(), []
    for begin in range(0, len(T), 1000):
        piece = day[begin : begin + 1000]
        pieces.append(correct(still, piece, None, heard).xyz)
        heard = heard.with_readings(piece.t, celsius[begin : begin + 1000])
    assert np.vstack(pieces)[ready:] == pytest.approx(whole, abs=0.1 * np.abs(unlagged).max())


def told(record: CalibrationRecord, day: Samples) -> Array:
    assert day.temperature is not None
    return bias_terms(record, GYRO, day.temperature, None, Thermometer().course(day.t, day.temperature))


def test_samples_are_not_corrected_by_a_thermometer_that_jumped() -> None:
    record, _, bias = learnt_day(0.0, 1)
    celsius = np.round(warmth(1), 1)
    day = Samples(GYRO, frozen(T), frozen(bias), frozen(celsius + np.where(T > 60000.0, 12.0, 0.0)))
    at_reference = correct(record, replace(day, temperature=None)).xyz
    followed = np.abs(correct(record, day).xyz - at_reference).max(axis=1)
    assert followed[T < 60000.0].max() > 0.0 and (followed[T > 61000.0] == 0.0).all()


def test_without_readings_between_rests_no_lag_is_claimed_and_the_uncertainty_says_so() -> None:
    silent, _, _ = learnt_day(300.0, 3, readings=False)
    assert silent.forecast[GYRO].lag_s == 0.0
    known, thermometer, _ = learnt_day(300.0, 3)
    t, celsius = float(T[-1]) + 5.0, 27.0
    lagged = thermometer.lagged(t, celsius)
    with_past = known.bias_uncertainty_at(GYRO, t, celsius, lagged)
    without = known.bias_uncertainty_at(GYRO, t, celsius)
    assert with_past is not None and without is not None
    assert (without > 2.0 * with_past).all()
