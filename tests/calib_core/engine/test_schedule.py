"""When to look, when to calibrate, how much sensing to allow: the pure decisions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.calibration.record import CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.engine.duty_cycle import DutyBudget, EnergySettings
from stillcal.calib_core.engine.schedule import (
    CalibrationStatus,
    Need,
    Occasion,
    accelerometer_wandered,
    calibration_due,
    early_check_due,
    first_of_its_hour,
    next_on_grid,
    watch_for,
)
from stillcal.calib_core.engine.settings import ScheduleSettings, Watch
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.temperature.forecast import Forecast

AUTO = ScheduleSettings()
BOTH, RESTS, CHECK, NOTHING = Need(True, True), Need(True, False), Need(False, True), Need(False, False)


@pytest.mark.parametrize(
    ("need", "current", "remaining_s", "expected"),
    [
        (RESTS, Watch.IDLE, 3600, Watch.CONTINUOUS),
        (RESTS, Watch.IDLE, 1799, Watch.PROBING),
        (RESTS, Watch.CONTINUOUS, 1799, Watch.CONTINUOUS),
        (RESTS, Watch.CONTINUOUS, 0, Watch.IDLE),
        (RESTS, Watch.IDLE, 1, Watch.PROBING),
        (CHECK, Watch.IDLE, 0, Watch.PROBING),
        (BOTH, Watch.PROBING, 10, Watch.PROBING),
        (CHECK, Watch.IDLE, 3600, Watch.PROBING),
        (NOTHING, Watch.CONTINUOUS, 3600, Watch.IDLE),
    ],
)
def test_watch_follows_need_and_budget(
    need: Need, current: Watch, remaining_s: float, expected: Watch
) -> None:
    assert watch_for(need, current, remaining_s, 3600, AUTO) is expected


@pytest.mark.parametrize(
    ("t", "saved", "due"),
    [(99.0, 3600.0, False), (100.0, 3600.0, True), (100.0, 1.0, True), (100.0, 0.0, False)],
)
def test_a_check_before_its_hour_takes_any_budget_that_is_left(t: float, saved: float, due: bool) -> None:
    state = EngineState(early_check=100.0, allowance=DutyBudget(t, saved, 0.0))
    assert early_check_due(state, t) is due


@pytest.mark.parametrize(
    ("before", "first"), [(None, True), (3599.0, True), (3600.0, False), (5000.0, False)]
)
def test_the_first_check_after_a_deadline_is_the_hours(before: float | None, first: bool) -> None:
    assert first_of_its_hour(EngineState(next_check=7200.0), before, AUTO) is first


@pytest.mark.parametrize(
    ("walk", "age", "far"), [(1e-4, 90.0, False), (1e-4, 110.0, True), (1e-6, 3e3, False)]
)
def test_an_accelerometer_that_wanders_too_far_before_its_hour_is_learnt_anew(
    walk: float, age: float, far: bool
) -> None:
    """1e-4 m/s^2 sqrt(s) make the 1e-3 m/s^2 that are wanted at most in 100 s."""
    none = np.zeros((3, 3))
    forecast = Forecast(
        at=1000.0,
        reference=25.0,
        curve=none,
        error=np.zeros((4, 3)),
        covariance=np.zeros((12, 12)),
        white=0.0,
        flicker=0.0,
        walk=walk,
    )
    gyroscope = GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3)
    record = CalibrationRecord(gyroscope=gyroscope, forecast={"accelerometer": forecast})
    assert accelerometer_wandered(EngineState(record=record), 1000.0 + age, AUTO) is far
    assert not accelerometer_wandered(EngineState(), 1000.0 + age, AUTO)


@pytest.mark.parametrize("forced", ["continuous", "probing"])
def test_a_forced_way_of_looking_is_kept(forced: str) -> None:
    settings = ScheduleSettings(watch=forced)  # type: ignore[arg-type]
    assert watch_for(NOTHING, Watch.IDLE, 0, 3600, settings) == forced


@given(st.floats(-1e9, 1e9), st.floats(1, 1e5), st.floats(0, 1e7))
def test_deadlines_stay_on_their_grid(began: float, interval: float, later: float) -> None:
    found = next_on_grid(began, interval, began + later)
    assert found > began + later
    assert found - (began + later) <= interval * (1 + 1e-6) + 1e-6
    assert (found - began) / interval == pytest.approx(round((found - began) / interval), abs=1e-3)


@pytest.mark.parametrize("power", [13, 17, 20, 24])
def test_a_deadline_is_followed_by_a_later_one(power: int) -> None:
    """Beyond a power of two seconds deadlines are rounded more coarsely than `began`: none may come again."""
    for began in np.random.default_rng(power).uniform(2**power - 20_000.0, 2**power, 50).tolist():
        t = began
        for _ in range(20):
            before, t = t, next_on_grid(began, 3600.0, t)
            assert before < t <= before + 3600.0 * (1 + 1e-9)


def test_no_calibration_without_new_rests() -> None:
    for occasion in set(Occasion) - {Occasion.ASKED}:
        assert not calibration_due(CalibrationStatus(False, True, 0, float("inf")), occasion, AUTO)
    assert calibration_due(CalibrationStatus(True, False, 0, 0.0), Occasion.ASKED, AUTO)


def test_a_good_calibration_is_not_renewed_at_every_plug() -> None:
    assert calibration_due(CalibrationStatus(False, False, 1, float("inf")), Occasion.CHARGING, AUTO)
    assert not calibration_due(CalibrationStatus(True, False, 5, 3600), Occasion.CHARGING, AUTO)
    assert calibration_due(CalibrationStatus(True, True, 5, 3600), Occasion.CHARGING, AUTO)
    assert calibration_due(CalibrationStatus(True, False, 5, 7 * 3600), Occasion.CHARGING, AUTO)


def test_the_budget_pays_for_its_capacity_and_refills() -> None:
    settings = EnergySettings(burst_s=100, on_time_fraction=0.1)
    start = DutyBudget(0, 100, 0)
    assert start.remaining_s(settings) == pytest.approx(100 / 0.9)
    spent = start.at(100 / 0.9, 100 / 0.9, settings)
    assert spent.saved == pytest.approx(0) and spent.remaining_s(settings) == pytest.approx(0, abs=1e-9)
    assert spent.at(100 / 0.9 + 500, 100 / 0.9, settings).saved == pytest.approx(50)
    assert spent.at(1e6, 100 / 0.9, settings).saved == 100


@given(st.lists(st.tuples(st.floats(0, 1e4), st.floats(0, 1)), max_size=30))
def test_on_time_never_exceeds_what_was_earned(steps: list[tuple[float, float]]) -> None:
    settings = EnergySettings(burst_s=600, on_time_fraction=0.05)
    budget = DutyBudget(0, 600, 0)
    t = used = 0.0
    for length, share in steps:
        spend = min(length * share, budget.remaining_s(settings))
        t, used = t + length, used + spend
        budget = budget.at(t, used, settings)
    assert used <= 600 + 0.05 * t + 1e-6


@pytest.mark.parametrize(
    "bad",
    [
        lambda: EnergySettings(burst_s=-1),
        lambda: EnergySettings(on_time_fraction=1.5),
        lambda: ScheduleSettings(check_interval_s=0),
        lambda: ScheduleSettings(attitudes_wanted=3),
        lambda: ScheduleSettings(diagnose_after_checks=0),
    ],
)
def test_senseless_settings_are_refused(bad) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match="must be"):
        bad()
