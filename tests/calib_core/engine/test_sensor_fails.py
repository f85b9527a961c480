"""A sensor that stops while the other goes on."""

from __future__ import annotations

from stillcal.calib_core.engine.intake import ACCEL_PATIENCE_S
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.streams.samples import Sensor
from tests.calib_core.engine.test_boat import FACES, calibrated, lying

WATCHED = EngineSettings(ScheduleSettings(watch="continuous"))


def test_where_the_accelerometer_stops_time_goes_on_and_nothing_piles_up() -> None:
    engine, t = calibrated(WATCHED)
    kept, checked = engine.state.record, engine.state.checked
    for begin in range(300):
        gyro, _ = lying(t + 60.0 * begin, FACES[0], 60.0)
        engine.feed(gyro)
    state = engine.state
    assert state.check_due  # the check of each hour waits for a rest
    assert state.record is kept and state.checked == checked
    assert state.waiting[Sensor.GYROSCOPE].t[0] > t + 300 * 60.0 - ACCEL_PATIENCE_S - 60.0
    assert state.detector is not None and len(state.detector.gyro.rows) <= 4096
    rests = state.counters.rests
    for begin in range(301, 306):
        engine.feed(*lying(t + 60.0 * begin, FACES[1], 59.0))
    assert engine.state.counters.rests > rests and not engine.state.check_due
