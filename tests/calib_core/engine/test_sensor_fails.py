"""A sensor that stops while the other goes on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.calibration.suspicion import Innovation
from stillcal.calib_core.engine.actions import Log
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.intake import ACCEL_PATIENCE_S
from stillcal.calib_core.engine.sensor_faults import rate_fault, sensor_faults
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import Label, Ledger
from stillcal.calib_core.streams.events import Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.calib_core.engine.test_boat import FACES, RATE_BIAS, calibrated, lying

HOUR = 60
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


@pytest.mark.parametrize("ticks", [False, True])
def test_an_accelerometer_that_never_came_is_told_and_may_come_later(ticks: bool) -> None:
    engine, told = Engine(WATCHED), []
    for minute in range(90):
        blocks = lying(60.0 * minute, FACES[minute // 2 % 6], 59.0)
        time = [Tick(60.0 * minute + 59.0)] if ticks else []
        lines = engine.feed(*blocks[: 1 if minute < 15 else 2], *time)
        told += [a for a in lines if isinstance(a, Log) and a.what == "sensor"]
    fails, works = told
    assert fails.why == "the accelerometer fails: it sends no samples, although the other sensor does"
    assert fails.t < 15 * 60.0 < works.t and "works again" in works.why
    assert engine.state.record is not None and engine.state.record.gyroscope is not None


def frozen_at(samples: Samples, value: float, axes: Sequence[int] = (0, 1, 2)) -> Samples:
    """Return samples some of whose axes hold one value."""
    held = samples.xyz.copy()
    held[:, list(axes)] = value
    return replace(samples, xyz=frozen(held))


def times(factor: float, gyro: Samples) -> Samples:
    """Return samples multiplied by a factor."""
    return replace(gyro, xyz=frozen(factor * gyro.xyz))


def far_off(gyro: Samples) -> Samples:
    """Return samples in deg/s, without the noise of that, which by itself would show no rest."""
    return replace(gyro, xyz=frozen(gyro.xyz + 56.3 * RATE_BIAS))


FAILURES: dict[str, tuple[Callable[[Samples, Samples], list[Samples]], str]] = {
    "no accelerometer": (lambda gyro, accel: [gyro], "accelerometer fails: it sends no samples, although"),
    "no gyroscope": (lambda gyro, accel: [accel], "gyroscope fails: it sends no samples, too few"),
    "frozen": (lambda gyro, accel: [gyro, frozen_at(accel, 3.0)], "accelerometer fails: it shows one value"),
    "stuck": (
        lambda gyro, accel: [gyro, frozen_at(accel, 3.0, [2])],
        "accelerometer fails: it shows one value",
    ),
    "frozen gyroscope": (lambda gyro, accel: [frozen_at(gyro, 0.0), accel], "or one value again and again"),
    "smaller range": (
        lambda gyro, accel: [times(1 / 8, gyro), accel],
        "times as large as before: its unit or range has changed",
    ),
    "in deg/s": (lambda gyro, accel: [times(57.3, gyro), accel], "motion while the accelerometer lies still"),
    "in g": (lambda gyro, accel: [gyro, replace(accel, xyz=accel.xyz / 9.81)], "check its unit"),
}


@pytest.mark.slow
@pytest.mark.parametrize("failure", FAILURES)
def test_a_sensor_that_fails_is_told_once_and_again_when_it_works(failure: str) -> None:
    engine, t = calibrated(WATCHED)
    change, words = FAILURES[failure]
    told = []
    bias = engine.state.record.gyroscope.bias
    for minute in range(4 * HOUR + 15):
        gyro, accel = lying(t + 60.0 * minute, FACES[minute // 20 % 6], 59.0)
        failing = HOUR <= minute < 3 * HOUR + 15
        blocks = change(gyro, accel) if failing else [gyro, accel]
        told += [a for a in engine.feed(*blocks) if isinstance(a, Log) and a.what == "sensor"]
    fails, works = told
    assert words in fails.why and fails.level == "warning" and "works again" in works.why
    assert t + 3600.0 < fails.t < t + 3.2 * 3600.0 < works.t
    assert not engine.state.faults
    assert np.abs(engine.state.record.gyroscope.bias - bias).max() < 1e-3


def stuck_axis(gyro: Samples) -> Samples:
    """Return samples of a coarse sensor whose z axis holds the value that it had in motion."""
    return frozen_at(coarse(gyro), 0.295, [2])


def coarse(gyro: Samples) -> Samples:
    """Return samples in steps as large as their noise."""
    return replace(gyro, xyz=frozen(np.round(gyro.xyz / 0.002) * 0.002))


RATES: dict[str, tuple[Callable[[Samples], Samples], str]] = {
    "another range": (
        lambda gyro: times(2.0, gyro),
        "are 2 times as large as before: its unit or range has changed",
    ),
    "far too large": (far_off, "too large for a bias"),
    "a stuck axis": (stuck_axis, "an axis of it sticks: it shows one value"),
}


@pytest.mark.parametrize("change", RATES)
def test_rates_that_are_no_bias_are_told_at_the_next_rests_and_not_learnt_from(change: str) -> None:
    engine, t = calibrated(WATCHED)
    changed, words = RATES[change]
    told: list[Log] = []
    for minute in range(30):
        gyro, accel = lying(t + 60.0 * minute, FACES[minute // 2 % 6], 59.0)
        lines = engine.feed(changed(gyro) if 5 <= minute < 20 else gyro, accel)
        told += [a for a in lines if isinstance(a, Log) and a.what == "sensor"]
    fails, works = told
    assert words in fails.why and t + 300.0 < fails.t < t + 480.0
    assert "works again" in works.why and t + 1200.0 < works.t < t + 1400.0 and not engine.state.faults
    assert engine.state.record.gyroscope.bias == pytest.approx(RATE_BIAS, abs=3e-4)


def test_an_hour_of_probes_that_end_with_their_first_window_is_enough_to_tell() -> None:
    hour = Ledger(accel_on_s=11.0, gyro_on_s=11.0, probes=22, windows={Label.GYRO_MOVING: 19, Label.STILL: 3})
    (fault,) = sensor_faults(Ledger(), hour, True, False, {}).values()
    assert "motion while the accelerometer lies still" in fault
    few = replace(hour, probes=5, accel_on_s=2.5)
    assert not sensor_faults(Ledger(), few, True, False, {})


@pytest.mark.parametrize(("codes", "sticks"), [(2, False), (40, True)])
def test_an_axis_that_comes_to_lie_on_one_code_nearby_does_not_stick(codes: int, sticks: bool) -> None:
    """The bias of a coarse sensor with little noise drifts from between two codes onto one."""
    sd, step = np.full(3, 4e-4), 0.001
    lively = RestState(0.0, 60.0, 3000, np.array([0.0, 0.0, 9.8]), sd, sd, 1e-3, RATE_BIAS, sd, sd)
    missed = np.array([0.0, 0.0, codes * step])
    rest = msgspec.structs.replace(
        lively, rate=RATE_BIAS + missed, rate_sd=sd * [1, 1, 0], rate_uncertainty=np.full(3, step / 12**0.5)
    )
    fault = rate_fault(rest, Innovation(missed, np.full(3, 3e-4), np.eye(3)), [lively] * 5, 3.0)
    assert ("sticks" in fault) == sticks
