"""A sensor that follows the thermometer late: the filter of its readings, and where that is unknown."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.temperature.thermometer import CELL_S, LAGS_S, Thermometer, felt

T = np.arange(0.0, 5400.0, 10.0)
STEP = np.where(T < 3000.0, 20.0, 30.0)


def heard(t: np.ndarray, celsius: np.ndarray) -> Thermometer:
    return Thermometer().with_readings(t, celsius, float(t[0]))


def test_a_lagged_temperature_rises_as_a_first_order_filter_does() -> None:
    thermometer = heard(T, STEP)
    for after in (60.0, 300.0, 900.0):
        late = thermometer.lagged(3000.0 + after, 30.0)
        wanted = 30.0 - 10.0 * np.exp(-after / np.array(LAGS_S))
        assert late == pytest.approx(wanted, abs=10.0 * CELL_S / LAGS_S[0])  # when in its cell it stepped


def test_at_a_ramp_a_sensor_is_behind_by_its_lag() -> None:
    ramp = 20.0 + T / 600.0
    course = heard(T, ramp).course(T, ramp)
    assert course[-1] == pytest.approx(ramp[-1] - np.array(LAGS_S) / 600.0, abs=0.01)
    assert np.isnan(course[0]).all()


def test_however_readings_are_cut_into_calls_the_same_are_kept() -> None:
    whole, parts = heard(T, STEP), Thermometer()
    for begin in range(0, len(T), 7):
        parts = parts.with_readings(T[begin : begin + 7], STEP[begin : begin + 7], 0.0)
    assert np.array_equal(parts.t, whole.t) and np.array_equal(parts.celsius, whole.celsius)
    assert len(whole.t) == len(T) * 10 / CELL_S


def test_after_a_pause_the_past_is_unknown_and_the_reading_stands_in() -> None:
    thermometer = heard(T[:60], STEP[:60])
    late = thermometer.lagged(5400.0, 24.0)
    assert np.isnan(late).all()
    assert felt(np.array([24.0]), late, 240.0) == [24.0]
    assert felt(np.array([24.0]), None, 240.0) == [24.0]
    known = heard(T, STEP).lagged(3100.0, 30.0)
    assert felt(np.array([30.0]), known, 240.0)[0] == known[LAGS_S.index(240.0)] < 25.0
    assert felt(np.array([30.0]), known, 0.0) == [30.0]


def test_old_and_unknown_readings_go() -> None:
    thermometer = heard(T, STEP).with_readings(np.array([20000.0]), np.array([25.0]), 20000.0)
    assert thermometer.t.tolist() == [20000.0]
    assert len(heard(T, np.full(len(T), np.nan)).t) == 0
