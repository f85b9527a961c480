"""Where the phone is not at rest when it should be: on a boat, asleep, restarted, its scale off."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.events import Charging, End
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 25.0
FACES = np.vstack((np.eye(3), -np.eye(3), [[0.6, 0.6, 0.53], [-0.5, 0.7, 0.5], [0.7, -0.5, -0.5]]))
BIAS, SCALE = np.array([0.3, -0.2, 0.1]), np.diag([1.01, 0.99, 1.005])
RATE_BIAS = np.array([0.01, -0.02, 0.005])
RNG = np.random.default_rng(8)


def blocks(t: Array, up: Array, rate: Array) -> tuple[Samples, Samples]:
    """Return a phone's samples at t (n,): up and rate, (n, 3), with its errors and its noise."""
    force = STANDARD * up @ SCALE + BIAS + RNG.normal(0.0, 0.02, (len(t), 3))
    turning = rate + RATE_BIAS + RNG.normal(0.0, 0.002, (len(t), 3))
    return (
        Samples(Sensor.GYROSCOPE, frozen(t), frozen(turning)),
        Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force)),
    )


def lying(start: float, face: Array, seconds: float) -> tuple[Samples, Samples]:
    t = start + np.arange(round(seconds * RATE)) / RATE
    up = np.broadcast_to(face / np.linalg.norm(face), (len(t), 3))
    return blocks(t, up, np.zeros((len(t), 3)))


def calibrated(settings: EngineSettings | None = None) -> tuple[Engine, float]:
    """Return an engine that has calibrated a phone laid on each of FACES, and the time."""
    engine, t = Engine(settings), 0.0
    for face in FACES:
        engine.feed(*lying(t, face, 40.0))
        t += 45.0
    engine.feed(Charging(t, True), *lying(t, FACES[0], 40.0))
    engine.feed(Charging(t + 40.0, False))
    assert engine.state.calibrated
    return engine, t + 40.0


def at_sea(start: float, seconds: float, roll: float, period: float) -> Iterator[tuple[Samples, Samples]]:
    """Yield minutes of a boat that rolls by `roll` rad about x with `period` s, and heaves a little."""
    for begin in np.arange(start, start + seconds, 60.0):
        t = begin + np.arange(round(60.0 * RATE)) / RATE
        omega = 2 * np.pi / period
        angle = roll * np.sin(omega * t)
        up = np.column_stack([np.zeros(len(t)), np.sin(angle), np.cos(angle)])
        up *= 1 + 0.02 * np.sin(omega * t / 1.3)[:, None]
        rate = np.column_stack([-roll * omega * np.cos(omega * t), np.zeros((len(t), 2))])
        yield blocks(t, up, rate)


@pytest.mark.parametrize(("roll", "period"), [(0.2, 6.0), (0.02, 12.0)])
def test_at_sea_the_last_good_calibration_stays_and_its_age_is_known(roll: float, period: float) -> None:
    engine, t = calibrated(EngineSettings(ScheduleSettings(watch="continuous")))
    sea = at_sea(t + 5.0, 2.1 * 3600.0, roll, period)
    for _ in range(10):  # the last rest ashore is closed, and what follows from it is done
        engine.feed(*next(sea))
    kept, rests = engine.state.record, engine.state.counters.rests
    assert kept is not None and kept.gyroscope is not None
    for samples in sea:
        engine.feed(*samples)
    state = engine.state
    assert state.record is not None and state.record.accelerometer is kept.accelerometer
    assert state.counters.rests == rests and not state.degraded
    assert state.check_due  # the check of each hour waits for a rest
    assert state.checked is not None and state.latest[Sensor.ACCELEROMETER] - state.checked > 3600.0
    assert state.record.gyroscope is not None  # measured anew once, on the rests ashore, and not at sea
    assert state.record.gyroscope.bias == pytest.approx(RATE_BIAS, abs=1e-4)


@pytest.mark.parametrize("spin", [0.0, 1e-3])
def test_an_hour_that_may_have_turned_slowly_is_held_against_earlier_attitudes(spin: float) -> None:
    """Flat on a table nothing in the hour itself bounds rotation about the vertical."""
    engine, t = calibrated(EngineSettings(ScheduleSettings(watch="continuous")))
    for begin in np.arange(t + 5.0, t + 4200.0, 60.0):
        a = begin + np.arange(round(60.0 * RATE)) / RATE
        engine.feed(*blocks(a, np.tile(FACES[2], (len(a), 1)), np.tile([0.0, 0.0, spin], (len(a), 1))))
    record = engine.state.record
    assert record is not None and record.gyroscope is not None
    moved, bound = record.gyroscope.bias - RATE_BIAS, record.gyroscope.rotation_admitted
    assert moved[2] == pytest.approx(spin, abs=1e-4)
    assert bound is not None and abs(moved[2]) < 1.96 * bound[2] and bound[2] < spin + 2e-4


def test_over_a_time_asleep_no_rest_and_no_turn_is_joined() -> None:
    """Laid on one face, suspended for six hours, found on another: two rests, and no rotation measured."""
    engine = Engine(EngineSettings(ScheduleSettings(watch="continuous")))
    engine.feed(*lying(1000.37, FACES[0], 60.0))
    engine.feed(*lying(1000.37 + 6 * 3600.0, FACES[1], 60.0))
    engine.feed(End(1000.37 + 6 * 3600.0 + 60.0))
    rests = engine.state.pool.rests
    assert len(rests) >= 2 and engine.state.counters.turns == 0
    assert all(rest.duration <= 60.0 for rest in rests)


@pytest.mark.parametrize("lean", [1.0, 0.45])
def test_a_scale_error_is_no_bias_that_grows_with_the_force(lean: float) -> None:
    """With 1.5 % of scale and no bias, the bias found is zero within its interval, or the fit is refused.

    lean: rad, how far the phone leans from one face at most. Near one face bias and scale read alike.
    """
    engine, t = Engine(), 0.0
    for azimuth in np.arange(14) * 0.9:
        tilt = lean * (1.0 if lean < 0.5 else np.pi) * (azimuth % 2.7) / 2.7
        up = [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)]
        n = round(40.0 * RATE)
        force = STANDARD * 1.015 * np.broadcast_to(up, (n, 3)) + RNG.normal(0.0, 0.02, (n, 3))
        engine.feed(Samples(Sensor.ACCELEROMETER, frozen(t + np.arange(n) / RATE), frozen(force)))
        t += 45.0
    engine.feed(End(t))
    record = engine.state.record
    if record is None or record.accelerometer is None:
        assert lean < 0.5 and engine.state.refusal is not None
        return
    interval = record.accelerometer.bias_interval
    assert interval is not None and (interval[0] < 0.0).all() and (interval[1] > 0.0).all()
    if lean > 0.5:
        assert np.diag(record.accelerometer.scale) == pytest.approx(1 / 1.015, abs=2e-3)


def test_of_a_long_rest_a_saved_state_has_only_the_samples_that_a_turn_may_need() -> None:
    engine, t = calibrated(EngineSettings(ScheduleSettings(watch="continuous")))
    for minute in range(12):
        engine.feed(*lying(t + 60.0 * minute, FACES[0], 60.0))
    tail = engine.state.gyro_tail
    assert tail is not None and tail.t[-1] - tail.t[0] > 120.0 and len(tail) < 130.0 * RATE
