"""A sensor that follows the thermometer late: the filter of its readings, and where that is unknown."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.temperature.thermometer import CELL_S, FRESH_S, LAGS_S, STEADY_S, Thermometer, felt

T = np.arange(0.0, 5400.0, 10.0)
STEP = np.where(T < 3000.0, 20.0, 25.0)


def heard(t: np.ndarray, celsius: np.ndarray) -> Thermometer:
    return Thermometer().with_readings(t, celsius)


def test_a_lagged_temperature_rises_as_a_first_order_filter_does() -> None:
    thermometer = heard(T, STEP)
    for after in (60.0, 300.0, 900.0):
        late = thermometer.lagged(3000.0 + after, 25.0)
        wanted = 25.0 - 5.0 * np.exp(-after / np.array(LAGS_S))
        assert late == pytest.approx(wanted, abs=5.0 * CELL_S / LAGS_S[0])  # when in its cell it stepped


def test_at_a_ramp_a_sensor_is_behind_by_its_lag() -> None:
    ramp = 20.0 + T / 600.0
    course = heard(T, ramp).course(T, ramp)
    assert course[-1] == pytest.approx(ramp[-1] - np.array(LAGS_S) / 600.0, abs=0.01)
    assert np.isnan(course[0]).all()


def test_however_readings_are_cut_into_calls_the_same_are_kept() -> None:
    whole, parts = heard(T, STEP), Thermometer()
    for begin in range(0, len(T), 7):
        parts = parts.with_readings(T[begin : begin + 7], STEP[begin : begin + 7])
    assert np.array_equal(parts.t, whole.t) and np.array_equal(parts.celsius, whole.celsius)
    assert len(whole.t) == len(T) * 10 / CELL_S


@pytest.mark.parametrize("size", [1, 7, 250])
def test_however_readings_are_cut_into_calls_a_course_is_the_same(size: int) -> None:
    """Calls end within cells, readings are missing at the start and in between."""
    celsius = 20.0 + 3.0 * np.sin(T / 700.0)
    celsius[:30] = celsius[200:203] = np.nan
    whole, parts, thermometer = Thermometer().course(T, celsius), [], Thermometer()
    for begin in range(0, len(T), size):
        t, read = T[begin : begin + size], celsius[begin : begin + size]
        parts.append(thermometer.course(t, read))
        thermometer = thermometer.with_readings(t, read)
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    known = np.isfinite(celsius) & np.isfinite(whole[:, 0])
    for k in np.flatnonzero(known)[::50]:
        assert whole[k] == pytest.approx(
            heard(T[:k], celsius[:k]).lagged(T[k], celsius[k]), abs=1e-3, nan_ok=True
        )


def test_a_day_without_a_reading_before_the_first_is_unknown() -> None:
    t = np.array([0.0, 86400.0, 86401.0])
    assert np.isnan(Thermometer().course(t, np.array([np.nan, 20.0, 20.0]))).all()


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
    thermometer = heard(T, STEP).with_readings(np.array([20000.0]), np.array([25.0]))
    assert thermometer.t.tolist() == [20000.0]
    assert len(heard(T, np.full(len(T), np.nan)).t) == 0


def test_readings_that_jump_are_not_believed() -> None:
    thermometer = heard(T, np.where(T < 3000.0, 20.0, 27.0))
    assert thermometer.t[-1] < 3000.0 and (thermometer.celsius == 20.0).all()
    assert thermometer.doubts(3010.0) and not thermometer.doubts(2900.0)
    assert thermometer.latest(5400.0) is None


def test_after_a_pause_a_phone_may_be_warmer() -> None:
    thermometer = heard(np.array([0.0, 30.0, 150.0, 180.0]), np.array([20.0, 20.0, 32.0, 32.0]))
    assert thermometer.doubt is None and thermometer.t.tolist() == [0.0, 30.0, 150.0, 180.0]


def test_a_slip_of_the_thermometer_is_forgotten_when_it_is_over() -> None:
    slip = heard(T, np.where((T >= 3000.0) & (T < 3300.0), 45.0, 20.0))
    assert slip.doubt is None and (slip.celsius == 20.0).all()
    assert not ((slip.t >= 3000.0) & (slip.t < 3300.0)).any() and (slip.t >= 3300.0).any()


def test_a_phone_that_cools_after_a_jump_is_no_slip() -> None:
    """The readings come back to where they were, but not at once: they are as much off as before."""
    celsius = 30.0 + np.where(T < 3000.0, 0.0, 9.0 - np.minimum((T - 3000.0) / 60.0, 8.0))
    assert heard(T, celsius).doubts(5390.0)


def test_back_after_too_long_a_time_is_no_slip() -> None:
    away = (T >= 3000.0) & (T < 3000.0 + FRESH_S + 2 * CELL_S)
    assert heard(T, np.where(away, 45.0, 20.0)).doubts(5390.0)


def test_a_thermometer_is_believed_again_a_day_after_its_last_jump() -> None:
    t = np.arange(0.0, 2 * STEADY_S, 60.0)
    jumps = 8.0 * (t >= 3600.0) + 8.0 * (t >= 7200.0)
    thermometer, since = Thermometer(), None
    for begin in range(0, len(t), 30):
        thermometer = thermometer.with_readings(t[begin : begin + 30], 20.0 + jumps[begin : begin + 30])
        if since is None and t[begin] > 7200.0 and not thermometer.doubts(float(t[begin + 29])):
            since = t[begin + 29]
    assert since == pytest.approx(7200.0 + STEADY_S, abs=1800.0)
    assert (thermometer.celsius == 36.0).all()


def test_a_slip_that_ends_while_the_sensors_are_off_is_over() -> None:
    t = np.array([0.0, 30.0, 60.0, 200.0, 230.0])
    slip = heard(t, np.array([20.0, 20.0, 40.0, 20.0, 20.5]))
    assert slip.doubt is None and slip.t.tolist() == [0.0, 30.0, 200.0, 230.0]
    assert heard(t, np.array([20.0, 20.0, 40.0, 40.0, 40.0])).doubts(230.0)


@pytest.mark.parametrize("before", [[], [(0.0, 21.0), (30.0, 21.0)]])
def test_a_wrong_reading_at_the_start_or_after_a_pause_costs_ten_minutes(
    before: list[tuple[float, float]],
) -> None:
    """A chip that wakes tells 85 degC first: none of those after it jumps back to that."""
    readings = [*before, (1000.0, 85.0), *((1000.0 + CELL_S * k, 20.0) for k in range(1, 40))]
    t, celsius = np.array(readings).T
    early = t < 1000.0 + FRESH_S
    assert heard(t[early], celsius[early]).doubts(float(t[early][-1]))
    woken = heard(t, celsius)
    assert woken.doubt is None and 85.0 not in woken.celsius and woken.t[-1] == t[-1]


@pytest.mark.parametrize("scatter", [0.7, 1.5])
def test_readings_that_scatter_do_not_jump(scatter: float) -> None:
    """Two days of a chip whose single readings are off by so much, K; then it jumps all the same."""
    t = np.arange(0.0, 2 * STEADY_S, CELL_S)
    celsius = 25.0 + scatter * np.random.default_rng(3).standard_normal(t.size)
    celsius[-20:] += 30.0
    thermometer = Thermometer()
    for begin in range(0, t.size, 20):
        assert thermometer.doubt is None
        thermometer = thermometer.with_readings(t[begin : begin + 20], celsius[begin : begin + 20])
    assert thermometer.doubts(float(t[-1]))


@pytest.mark.parametrize("size", [1, 7, 250])
def test_however_readings_are_cut_into_calls_the_same_ones_are_believed(size: int) -> None:
    """A slip, a jump that stays, and one more reading that is missing."""
    celsius = 20.0 + T / 1000.0 + 9.0 * (T >= 4000.0) - 9.0 * ((T >= 1000.0) & (T < 1400.0))
    celsius[150] = np.nan
    whole, parts, thermometer = Thermometer().believed(T, celsius), [], Thermometer()
    for begin in range(0, len(T), size):
        t, read = T[begin : begin + size], celsius[begin : begin + size]
        parts.append(thermometer.believed(t, read))
        thermometer = thermometer.with_readings(t, read)
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert np.array_equal(thermometer.t, heard(T, celsius).t)
    slipped = (T >= 1020.0) & (T < 1380.0)
    assert whole[slipped] == pytest.approx(20.99)  # the last one believed
    assert whole[150:160] == pytest.approx(celsius[150:160], nan_ok=True)
    assert np.isnan(whole[T > 4000.0 + FRESH_S]).all() and whole[410] == pytest.approx(23.99)
