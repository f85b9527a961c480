"""One rest that misses what is stated widens the uncertainty at once; the rests after it decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.suspicion import Innovation, Suspicion, suspected
from stillcal.calib_core.codec import packed, unpacked
from stillcal.calib_core.engine.actions import Log
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Tick
from stillcal.calib_core.streams.samples import Sensor
from tests.calib_core.calibration.test_following import DEG, HOUR, MG, calibrated_engine, lived

ACCEL, GYRO = Sensor.ACCELEROMETER, Sensor.GYROSCOPE
KNOCK = np.array([6.0, -5.0, 7.0]) * MG
SPIN = np.array([0.1, 0.0, -0.05]) * DEG


def later(knocked: bool) -> list[RestState]:
    """Return the rests of two hours after a calibration, before which the phone was knocked or was not."""
    rests = lived(32.0, seed=1, knock=(30 * HOUR, KNOCK if knocked else np.zeros(3)))[90:]
    if not knocked:
        return rests
    return [structs.replace(rest, rate=frozen(rest.rate + SPIN)) for rest in rests]


def stated(engine: Engine, sensor: Sensor, t: float, celsius: float) -> Array:
    """Return the uncertainty (3,) that the daemon states."""
    sd = engine.present.record.bias_uncertainty_at(sensor, t, celsius)
    step = engine.present.suspected.get(sensor)
    return sd if step is None else np.hypot(sd, step.uncertainty)


def uncertain(engine: Engine, sensor: Sensor, rest: RestState) -> Array:
    return stated(engine, sensor, rest.t_end, rest.temperature)


@pytest.mark.parametrize(("sensor", "step"), [(ACCEL, KNOCK), (GYRO, SPIN)])
def test_one_rest_after_a_knock_covers_the_true_error(sensor: Sensor, step: Array) -> None:
    engine, rest = calibrated_engine(), later(knocked=True)[0]
    assert np.abs(step).max() > 10 * uncertain(engine, sensor, rest).max()
    engine.add_rests([rest])
    assert (np.abs(step) < 1.96 * uncertain(engine, sensor, rest)).all()
    assert not engine.present.degraded  # one rest alone decides nothing
    told = [a for a in engine.feed(Tick(rest.t_end)) if isinstance(a, Log) and a.what == "suspected"]
    assert len(told) == 2 and str(ACCEL) in told[0].why


def test_the_rests_after_a_bad_one_take_it_back() -> None:
    engine, rests = calibrated_engine(), later(knocked=False)
    quiet = [uncertain(engine, sensor, rests[2]) for sensor in (ACCEL, GYRO)]
    bad = structs.replace(
        rests[0],
        specific_force=frozen(rests[0].specific_force + KNOCK),
        rate=frozen(rests[0].rate + SPIN),
    )
    engine.add_rests([bad])
    assert uncertain(engine, ACCEL, bad).max() > 10 * quiet[0].max()
    engine.add_rests(rests[1:])
    for sensor, before in zip((ACCEL, GYRO), quiet, strict=True):
        assert (uncertain(engine, sensor, rests[2]) < 1.5 * before).all()


def test_rests_that_agree_with_each_other_settle_a_knock() -> None:
    engine, rests = calibrated_engine(), later(knocked=True)
    engine.add_rests(rests)
    for sensor, step in ((ACCEL, KNOCK), (GYRO, SPIN)):
        suspicion = engine.present.suspected[sensor]
        assert suspicion.probability > 0.999
        assert (np.abs(step) < 1.96 * uncertain(engine, sensor, rests[-1])).all()
    assert engine.present.suspected[GYRO].mean == pytest.approx(SPIN, abs=0.005 * DEG)


def test_what_is_suspected_is_saved_and_a_rollback_forgets_it() -> None:
    engine = calibrated_engine()
    record = engine.present.record
    engine.add_rests(later(knocked=True)[:1])
    again = unpacked(packed(engine.state), EngineState).suspected
    assert again.keys() == {ACCEL, GYRO}
    assert np.array_equal(again[ACCEL].covariance, engine.present.suspected[ACCEL].covariance)
    engine.use_calibration(record)
    assert engine.present.suspected == {}


def test_sound_rests_are_suspected_no_more_often_than_chance_has_it() -> None:
    """Of 3 x 200 components 0.27 % lie beyond three standard uncertainties."""
    engine, n = calibrated_engine(), 0
    for rest in lived(30.0 + 24.0, seed=2)[90:]:
        state = engine.present
        state.suspected = {}
        engine.add_rests([rest])
        n += bool(state.suspected)
    assert n <= 3


def test_one_direction_seen_leaves_the_step_unknown_across() -> None:
    """Of knocks in random directions, nine intervals in ten hold after one rest that shows a part."""
    rng, held = np.random.default_rng(0), []
    for _ in range(2000):
        step, up = rng.standard_normal(3), rng.standard_normal(3)
        up /= np.linalg.norm(up)
        shown = Innovation(np.array([up @ step]), np.array([0.02]), up[None])
        suspicion = suspected(None, shown, 3.0)
        held += [] if suspicion is None else (np.abs(step) < 1.96 * suspicion.uncertainty).tolist()
    print(f"{np.mean(held):.1%} of the 95 % intervals hold")
    assert np.mean(held) > 0.85


def test_a_bad_rest_does_not_hide_a_later_step() -> None:
    sd, towards = np.full(3, 0.1), np.eye(3)
    suspicion: Suspicion | None = None
    for missed in (5.0, 0.0, 0.1):
        suspicion = suspected(suspicion, Innovation(np.array([missed, 0, 0]), sd, towards), 3.0)
    assert suspicion is not None and suspicion.uncertainty.max() < 0.01
    suspicion = suspected(suspicion, Innovation(np.array([0.0, 2.0, 0.0]), sd, towards), 3.0)
    assert suspicion is not None and suspicion.uncertainty[1] > 1.0
    assert suspected(None, Innovation(np.array([0.29, 0, 0]), sd, towards), 3.0) is None
    assert replace(suspicion, log_odds=-1e9).probability >= 0.0
