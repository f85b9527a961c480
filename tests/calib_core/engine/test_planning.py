"""When the engine's next deadlines fall."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.engine.schedule import first_of_use, resumed, review_soon
from stillcal.calib_core.engine.settings import ScheduleSettings
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor

SETTINGS = ScheduleSettings(check_interval_s=3600.0, recalibrate_interval_s=1000.0)
DAY = 86400.0
GYROSCOPE_ALONE = CalibrationRecord(
    gyroscope=GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3)
)


def settled(**fields: object) -> EngineState:
    accelerometer = AccelerometerRecord(scale=np.eye(3), bias=np.zeros(3), parameters=6, gravity=9.8)
    state = EngineState(record=CalibrationRecord(accelerometer=accelerometer), tried=100.0, next_check=2500.0)
    for name, value in fields.items():
        setattr(state, name, value)
    return state


@pytest.mark.parametrize(
    "fields", [{"record": None}, {"record": GYROSCOPE_ALONE}, {"check_due": True}, {"tried": None}]
)
def test_every_review_is_held_while_one_may_find_something_to_do(fields: dict[str, object]) -> None:
    assert first_of_use(settled(**fields), 200.0, 60.0, SETTINGS) == 200.0


@pytest.mark.parametrize(
    ("fields", "first"),
    [
        ({"charging": True}, 1100.0),  # 1000 s after the last try, on the grid of reviews
        ({"charging": None}, 1100.0),
        ({"charging": False}, 2540.0),  # no fit without the charger: the check comes first, and plans anew
        ({"degraded": True}, 2540.0),  # a calibration that failed its check waits for the next
    ],
)
def test_reviews_are_left_out_until_a_fit_or_a_check_is_due(fields: dict[str, object], first: float) -> None:
    assert first_of_use(settled(**fields), 200.0, 60.0, SETTINGS) == first


def test_deadlines_count_from_a_day_before_what_comes_next() -> None:
    t = np.array([10.0, 50.0, 50.0 + 3 * DAY])
    waiting = {Sensor.ACCELEROMETER: Samples.checked(Sensor.ACCELEROMETER, t, np.zeros((3, 3)))}
    state = EngineState(waiting=waiting)
    assert resumed(state, 40.0) == 40.0
    assert resumed(state, 60.0) == 50.0 + 2 * DAY  # samples passed by do not count: they only wait
    state.events.append(Charging(t=100.0, on=True))
    assert resumed(state, 60.0) == 60.0


def test_what_somebody_changes_is_looked_at_within_one_interval() -> None:
    state = settled(next_review=9000.0)
    review_soon(state, 300.0, SETTINGS)
    assert state.next_review == 360.0
    review_soon(state, 330.0, SETTINGS)
    assert state.next_review == 360.0
