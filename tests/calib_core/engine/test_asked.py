"""What the engine does when it is asked, when another phone comes, and when calibrating does not help."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool, PoolSettings
from stillcal.calib_core.engine.actions import Action, Diagnose, Forget, Log, Publish, Reject
from stillcal.calib_core.engine.duty_cycle import EnergySettings
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.intake import Intake
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Charging, End, Event, Location, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.phone import load_phone, load_scenario, simulate

QUICK = EngineSettings(
    schedule=ScheduleSettings(check_interval_s=120.0, review_interval_s=10.0, recalibrate_interval_s=240.0)
)


@pytest.fixture(scope="module")
def lab() -> Samples:
    """Ten minutes of a phone laid in 24 attitudes, accelerometer and gyroscope."""
    return simulate(load_scenario("lab"), load_phone("typical"), 1).whole()


def fed(lab: object, settings: EngineSettings | None = None) -> Engine:
    engine = Engine(settings)
    engine.feed(lab.gyroscope, lab.accelerometer)
    return engine


def test_who_asks_gets_a_calibration_now(lab: Samples) -> None:
    engine = fed(lab)
    assert not engine.state.calibrated
    (stored,) = (a for a in engine.calibrate() if isinstance(a, Publish))
    assert stored.record.acceptance.evidence["occasion"] == "asked for"
    assert engine.state.record is stored.record
    again = [a for a in engine.calibrate() if isinstance(a, Publish | Reject)]
    assert [type(a) for a in again] == [Reject]


def test_who_asks_in_vain_is_told_why() -> None:
    engine = Engine()
    (line,) = engine.calibrate()
    assert isinstance(line, Log) and line.what == "refused"
    assert engine.update_bias() == []


def test_the_gyroscope_bias_is_updated_on_request(lab: Samples) -> None:
    engine = fed(lab)
    engine.calibrate()
    (stored,) = (a for a in engine.update_bias() if isinstance(a, Publish))
    assert stored.record.acceptance.how == "zeroing"


def test_another_phone_begins_anew_and_the_old_calibration_is_set_aside(lab: Samples) -> None:
    engine = fed(lab)
    engine.feed(Charging(1000.0, True))
    engine.calibrate()
    record, gathered = engine.state.record, engine.state.counters.rests
    (forgotten,) = engine.forget("another phone")
    assert isinstance(forgotten, Forget) and forgotten.record is record
    state = engine.state
    assert state.record is None and not state.pool.held and not state.pool.turns and state.attitudes == 0
    assert state.counters.rests == gathered
    later = [replace(s, t=frozen(s.t + 5000.0)) for s in (lab.gyroscope, lab.accelerometer)]
    engine.feed(*later, End(7000.0))
    assert engine.state.record is not None and engine.state.began == later[1].t[0]
    assert engine.forget("yet another") and engine.forget("without a calibration") == []


def failing(engine: Engine, lab: object, rounds: int) -> list[object]:
    """Let the accelerometer's scale jump by turns: neither a calibration nor a step of a bias fits then."""
    actions: list[object] = []
    length = float(lab.accelerometer.t[-1]) + 1.0
    for k in range(rounds):
        gain = np.array([0.04, -0.03, 0.05]) * (-1) ** k
        accel = replace(lab.accelerometer, t=frozen(lab.accelerometer.t + k * length))
        gyro = replace(lab.gyroscope, t=frozen(lab.gyroscope.t + k * length))
        accel = replace(
            accel, xyz=frozen(accel.xyz * (1 + np.where(accel.t[:, None] % 240.0 < 120.0, gain, -gain)))
        )
        charging = [Charging(0.5, True)] if k == 0 else []
        actions += engine.feed(*charging, gyro, accel)
    return actions


@pytest.mark.slow
def test_when_calibrating_does_not_help_a_diagnosis_is_asked_for_once(lab: Samples) -> None:
    engine = Engine(QUICK)
    engine.feed(lab.gyroscope, lab.accelerometer)
    engine.calibrate()
    shifted = replace(lab, accelerometer=replace(lab.accelerometer, t=frozen(lab.accelerometer.t + 700.0)))
    shifted = replace(shifted, gyroscope=replace(lab.gyroscope, t=frozen(lab.gyroscope.t + 700.0)))
    actions = failing(engine, shifted, 4)
    checks = [a.why for a in actions if isinstance(a, Log) and a.what == "check"]
    asked = [a for a in actions if isinstance(a, Diagnose)]
    assert checks.count("recalibrate") > QUICK.schedule.diagnose_after_checks
    assert len(asked) == 1
    assert engine.state.trouble is not None and engine.state.trouble.failed >= 3


def block(begin: float, end: float) -> Samples:
    t = np.arange(begin, end, 0.01)
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(np.tile([0.0, 0.0, 9.8], (t.size, 1))))


@pytest.mark.parametrize("far", [End(1e12), Tick(1e12)])
@pytest.mark.parametrize("watch", ["auto", "probing", "continuous"])
def test_however_far_time_leaps_no_more_than_a_day_of_it_is_looked_at(watch: str, far: Event) -> None:
    schedule = ScheduleSettings(watch=watch)  # type: ignore[arg-type]
    engine = Engine(EngineSettings(schedule=schedule, energy=EnergySettings(burst_s=60.0)))
    engine.feed(block(0.0, 60.0), far)
    probes, settings = engine.ledger.probes, engine.settings.detector
    assert probes <= 1 + 2 * 86400.0 / (settings.probe_min_s + settings.w_min_s)


def rest(begin: float, end: float) -> RestState:
    ones = frozen(np.ones(3))
    return RestState(begin, end, 100, frozen([0.0, 0.0, 9.8]), ones, ones, 0.01)


def test_a_rest_that_closes_after_two_moves_has_the_gravity_of_where_it_was() -> None:
    settings, state = EngineSettings(), EngineState(gravity=Gravity(9.80, 0.0, "given"))
    actions: list[Action] = []
    intake = Intake(settings, state, StationaryDetector(settings.detector), actions)
    for t, latitude in ((100.0, 0.0), (200.0, 80.0)):
        intake.move_to(Location(t, latitude, 0.0, 0.0))
    intake.gather([rest(50.0, 90.0), rest(110.0, 190.0), rest(210.0, 290.0)])
    assert [round(h.gravity.value, 2) for h in state.pool.held] == [9.80, 9.78, 9.83]


def test_moves_are_remembered_no_longer_than_a_rest_may_last() -> None:
    settings, state = EngineSettings(), EngineState(gravity=Gravity(9.80, 0.0, "given"))
    actions: list[Action] = []
    intake = Intake(settings, state, StationaryDetector(settings.detector), actions)
    for k in range(1000):
        intake.move_to(Location(10.0 * k, 50.0 + k % 2, 0.0, 0.0))
    assert len(state.moves) <= (settings.detector.max_rest_s + 60.0) / 10.0 + 2


def test_the_first_place_is_that_of_the_last_day_only() -> None:
    settings = PoolSettings()
    pool = Pool(tuple(HeldRest(rest(t, t + 10.0), Gravity()) for t in (0.0, 1e5, 1.5e5)))
    found = pool.located(Gravity(9.81, 0.0, "location"), 1.8e5, settings)
    assert [(h.rest.t_start, h.gravity.value) for h in found.held] == [(1e5, 9.81), (1.5e5, 9.81)]
