"""The gyroscope's bias before the first full calibration: provisional, then confirmed or replaced."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.engine.actions import Action, Log, Publish
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.streams.events import Charging, End
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.store.document import StoreDocument

BIAS = np.array([0.02, -0.01, 0.005])
MOVED = np.array([0.01, 0.0, 0.0])
HOURLY = 900.0


def on_a_desk(seconds: float, moved_at: float = np.inf) -> tuple[Samples, Samples]:
    """A phone flat on its back at 50 Hz; the gyroscope's bias moves by 0.01 rad/s on x at a time, s."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, seconds, 0.02)
    force = np.array([0.0, 0.0, 9.8]) + rng.normal(0, 0.01, (t.size, 3))
    rate = BIAS + rng.normal(0, 0.002, (t.size, 3)) + np.outer(t >= moved_at, MOVED)
    return (
        Samples(Sensor.GYROSCOPE, frozen(t), frozen(rate)),
        Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force)),
    )


def actions_of(*streams: Samples, end: float) -> list[Action]:
    engine = Engine(EngineSettings(schedule=ScheduleSettings(check_interval_s=HOURLY, watch="continuous")))
    actions = engine.feed(*streams, Charging(0.0, False), End(end))
    assert not engine.state.calibrated
    return actions


def published(*streams: Samples, end: float) -> list[Publish]:
    return [a for a in actions_of(*streams, end=end) if isinstance(a, Publish)]


def error(action: Publish, bias: Array) -> float:
    assert action.record.gyroscope is not None
    return float(np.abs(action.record.gyroscope.bias - bias).max())


def test_the_first_rest_gives_a_provisional_bias_and_a_later_one_confirms_it() -> None:
    first, second, *hourly = published(*on_a_desk(3000.0), end=3000.0)
    assert first.t < 400.0 and first.record.provisional and "provisional" in first.reason
    assert first.t < second.t < 800.0 and not second.record.provisional and "confirmed" in second.reason
    assert max(error(a, BIAS) for a in (first, second, *hourly)) < 1e-4
    assert len(hourly) >= 2 and not any(a.record.provisional for a in hourly)
    assert all(later.t - earlier.t >= HOURLY / 2 for earlier, later in itertools.pairwise(hourly))


def test_a_bias_that_has_moved_since_the_start_is_measured_anew_and_stays_provisional() -> None:
    first, second, third, *_ = published(*on_a_desk(1300.0, moved_at=301.0), end=1300.0)
    assert error(first, BIAS) < 1e-4
    assert second.record.provisional and "moved" in second.reason
    assert not third.record.provisional
    assert error(third, BIAS + MOVED) < 1e-4


def test_the_log_tells_of_the_first_bias_and_when_it_is_confirmed_and_not_of_every_hour() -> None:
    actions = actions_of(*on_a_desk(3000.0), end=3000.0)
    first, confirmed = (a for a in actions if isinstance(a, Log) and a.what == "gyroscope")
    assert "provisional" in first.why and "confirmed" in confirmed.why
    assert first.fields["largest"] == pytest.approx(0.02, abs=1e-4)


def test_a_short_recording_leaves_its_bias_and_one_without_gyroscope_nothing() -> None:
    gyroscope, accelerometer = on_a_desk(30.0)
    (only,) = published(gyroscope, accelerometer, end=30.0)
    assert only.record.provisional
    assert published(accelerometer, end=30.0) == []
    few = replace(gyroscope, xyz=frozen(gyroscope.xyz * [1.0, 1.0, 1.0]))[:500]
    assert published(few, accelerometer[:500], end=10.0)[0].record.provisional


def test_the_first_bias_grows_uncertain_with_age_and_temperature() -> None:
    """An hour on, or 20 K colder, the one rest that it was measured on says less than it did then."""
    streams = (replace(s, temperature=frozen(np.full(len(s), 21.0))) for s in on_a_desk(30.0))
    (only,) = published(*streams, end=30.0)
    then, later, colder = (
        only.record.bias_uncertainty_at(Sensor.GYROSCOPE, only.t + age, celsius)
        for age, celsius in ((0.0, 21.0), (3600.0, 21.0), (0.0, 1.0))
    )
    assert then is not None and later is not None and colder is not None
    assert (later > 1.1 * then).all() and (colder > np.radians(0.2)).all()


def test_the_history_of_a_store_forgets_it() -> None:
    """Nobody rolls back from a full calibration to a gyroscope's bias alone."""
    (only,) = published(*on_a_desk(30.0), end=30.0)
    assert only.record.gyroscope is not None
    full = replace(only.record, acceptance=replace(only.record.acceptance, how="calibration"), fitted_at=9.0)
    document = StoreDocument().after_publishing(only.record, 8).after_publishing(full, 8)
    assert document.current is full and document.history == ()
