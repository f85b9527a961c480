"""Real recordings with a thermometer: some minutes in one go show no curve, and none is claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.calibration.bias_curve.learn import learn_gyroscope
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.record import CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.static.settings import DetectorSettings
from stillcal.calib_core.streams.events import End
from stillcal.replay.formats.trace import open_trace

SHORT_RESTS = DetectorSettings(max_rest_s=8.0)


@pytest.mark.parametrize(
    ("name", "sensor", "least_rests", "kelvins"),
    [
        ("sunsided/still_10min.csv.gz", None, 40, 0.2),
        ("axivity/ax6_testfile.cwa", None, 5, 0.5),
        ("carbonix/flight_three_imus.npz", "2", 8, 1.0),
    ],
)
def test_minutes_of_warming_up_are_no_evidence_for_a_curve(
    data_dir: Path, name: str, sensor: str | None, least_rests: int, kelvins: float
) -> None:
    """Cut into rests of 8 s there are many, over up to 3 K, but all of one hour, whose errors they share.

    The bias told is nevertheless that of the newest rest to within what is stated.
    """
    settings = EngineSettings(schedule=ScheduleSettings(watch="continuous"), detector=SHORT_RESTS)
    engine, end = Engine(settings), 0.0
    for chunk in open_trace(data_dir / name, sensor=sensor).chunks():
        assert chunk.gyroscope is not None
        engine.feed(chunk.gyroscope, chunk.accelerometer, *chunk.events)
        end = float(chunk.accelerometer.t[-1])
    engine.feed(End(end))
    memory = engine.state.memory
    assert len(memory) >= least_rests and np.ptp(memory.celsius) > kelvins
    record = CalibrationRecord(gyroscope=GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3))
    learnt = learn_gyroscope(memory, record, end, QualitySettings())
    if learnt is None:
        assert len(memory) < 8
        return
    assert learnt.change == "" and learnt.term is None and learnt.forecast.lag_s == 0.0
    newest = memory.rate[-1]
    stated = learnt.forecast.bias_uncertainty(end, float(memory.celsius[-1]))
    assert (np.abs(learnt.bias - newest) < 4.0 * np.hypot(stated, memory.rate_sd[-1])).all()
