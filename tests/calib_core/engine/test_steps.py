"""A bias that steps between two checks is noticed at the next rests, and by how much is told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace as changed

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.calibration.drift_check import QualitySettings, stepped_since
from stillcal.calib_core.calibration.rest_pool import HeldRest
from stillcal.calib_core.engine.actions import Log, Publish
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Charging
from stillcal.replay.phone import load_phone, load_scenario, simulate

STEP_AT = 430.0
STEP = np.array([0.02, 0.0, 0.0])


@pytest.fixture(scope="module")
def chunks() -> list[Any]:
    return list(simulate(load_scenario("lab"), load_phone("typical"), 1).chunks())


def lived(chunks: list[Any], gyro_step: np.ndarray, accel_step: np.ndarray) -> tuple[Engine, list[Any]]:
    """Ten minutes in many attitudes, calibrated after six, with a step of either bias at STEP_AT."""
    engine, actions, plugged = (
        Engine(EngineSettings(schedule=ScheduleSettings(watch="continuous"))),
        [],
        False,
    )
    for chunk in chunks:
        late = chunk.accelerometer.t >= STEP_AT
        accel = replace(chunk.accelerometer, xyz=frozen(chunk.accelerometer.xyz + np.outer(late, accel_step)))
        late = chunk.gyroscope.t >= STEP_AT
        gyro = replace(chunk.gyroscope, xyz=frozen(chunk.gyroscope.xyz + np.outer(late, gyro_step)))
        events = []
        if not plugged and accel.t[-1] > 360.0:
            t, plugged = float(accel.t[0]), True
            events = [Charging(t, True), Charging(t + 1.0, False)]
        actions += engine.feed(gyro, accel, *events)
    return engine, actions


def test_a_step_of_the_gyroscope_is_followed_at_the_next_rests_not_at_the_hour(chunks: list[Any]) -> None:
    engine, actions = lived(chunks, STEP, np.zeros(3))
    assert engine.state.calibrated and not engine.state.degraded
    after = [a for a in actions if isinstance(a, Publish) and a.t > STEP_AT]
    assert after and after[0].t < STEP_AT + 120.0 and after[0].record.acceptance.how == "zeroing"
    truth = simulate(load_scenario("lab"), load_phone("typical"), 1).truth.gyroscope.bias + STEP
    record = engine.state.record
    assert record is not None and record.gyroscope is not None
    assert np.abs(record.gyroscope.bias - truth).max() < 0.1 * STEP[0]
    _, calm = lived(chunks, np.zeros(3), np.zeros(3))
    assert not [a for a in calm if isinstance(a, Publish) and a.t > STEP_AT]


def test_a_failed_check_tells_by_how_much(chunks: list[Any]) -> None:
    engine, actions = lived(chunks, np.zeros(3), np.array([0.3, 0.0, 0.0]))
    (degraded,) = [a for a in actions if isinstance(a, Log) and a.what == "degraded"]
    assert STEP_AT < degraded.t < STEP_AT + 120.0
    assert engine.state.trouble is not None
    assert 0.1 < engine.state.trouble.size < 0.35


BIAS = np.array([0.01, -0.02, 0.0])
QUIET = np.full(3, 1e-4)


def rests(*offsets: float) -> list[HeldRest]:
    """Rests whose rates are off a bias by as much on x, rad/s."""
    first = RestState(0.0, 10.0, 500, np.array([0, 0, 9.8]), QUIET, QUIET, 1e-3)
    return [
        HeldRest(
            changed(
                first,
                t_start=20.0 * k,
                t_end=20.0 * k + 10.0,
                rate=BIAS + [offset, 0.0, 0.0],  # noqa: RUF005 - a sum
                rate_sd=QUIET,
                rate_uncertainty=QUIET,
            ),
            Gravity(),
        )
        for k, offset in enumerate(offsets)
    ]


@pytest.mark.parametrize(
    ("offsets", "since"),
    [
        ((0.0, 0.01, 0.01), 20.0),
        ((0.01, 0.01), 0.0),
        ((0.01,), None),  # a single rest may have turned
        ((0.01, 0.0), None),
        ((0.01, 0.005), None),  # they do not agree with each other
        ((0.0009, 0.0009), None),  # within the limit of drift
    ],
)
def test_a_step_takes_two_rests_that_agree(offsets: tuple[float, ...], since: float | None) -> None:
    assert stepped_since(BIAS, rests(*offsets), QualitySettings()) == since
