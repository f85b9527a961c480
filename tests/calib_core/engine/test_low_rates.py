"""Sensors from 1 to 10 Hz: the paper's range begins at 1 Hz (Grammenos et al. 2018, 4.6)."""

from __future__ import annotations

import functools

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.engine.actions import Action, Log
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.static.windows import COLUMNS, D2, GAP, K_END, MEAN, T0, T1, K, N, joined, sparse
from stillcal.calib_core.streams.events import End
from stillcal.replay.phone import load_phone, simulate
from stillcal.replay.phone.activities.resting import Poses
from stillcal.replay.phone.scenario import Scenario


@functools.cache
def lived(rate_hz: float) -> tuple[EngineState, list[Action]]:
    """Two dozen attitudes at one sampling rate of both sensors."""
    phone = load_phone("typical")
    slow = {
        name: msgspec.structs.replace(getattr(phone, name), rate_hz=rate_hz) for name in ("accel", "gyro")
    }
    whole = simulate(
        Scenario(segments=(Poses(count=24, rest_s=(40.0, 60.0)),)), msgspec.structs.replace(phone, **slow), 1
    ).whole()
    assert whole.gyroscope is not None
    engine = Engine(EngineSettings(schedule=ScheduleSettings(watch="continuous")))
    actions = engine.feed(whole.gyroscope, whole.accelerometer, *whole.events, End(whole.t_end))
    return engine.state, actions


@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 5.0, 10.0])
def test_rests_and_both_biases_are_found_at_every_rate(rate_hz: float) -> None:
    state, _ = lived(rate_hz)
    assert state.counters.rests >= 22
    assert state.record is not None and state.record.accelerometer is not None
    assert state.record.accelerometer.rms_residual is not None
    assert state.record.accelerometer.rms_residual < 0.001
    assert state.record.gyroscope is not None


@pytest.mark.parametrize("rate_hz", [5.0, 10.0])
def test_turns_are_integrated_at_ten_samples_a_second_and_below(rate_hz: float) -> None:
    state, _ = lived(rate_hz)
    assert state.record is not None and state.record.gyroscope is not None
    assert state.counters.turns >= 18
    assert state.record.gyroscope.parameters >= 6


def test_a_rate_too_low_for_turns_is_said_once() -> None:
    state, actions = lived(2.0)
    assert state.counters.undersampled >= 2
    said = [a for a in actions if isinstance(a, Log) and a.what == "undersampled"]
    assert len(said) == 1 and "sampling rate" in said[0].why and said[0].fields["rate_hz"] == 2.0
    fast, actions = lived(10.0)
    assert fast.counters.undersampled == 0
    assert not any(isinstance(a, Log) and a.what == "undersampled" for a in actions)


def cells(*samples: tuple[int, float, float]) -> np.ndarray:
    """Rows of cells of 0.5 s that hold one sample each: cell, its time in the cell (s), its value."""
    rows = np.zeros((len(samples), COLUMNS))
    for row, (cell, at, value) in zip(rows, samples, strict=True):
        row[[K, K_END, N, T0, T1]] = cell, cell + 1, 1, 0.5 * cell + at, 0.5 * cell + at
        row[GAP], row[MEAN] = max(at, 0.5 - at), value
    return rows


def test_the_pause_across_empty_cells_reaches_to_the_next_sample_or_the_border() -> None:
    rows = cells((0, 0.1, 1.0), (2, 0.1, 2.0), (6, 0.1, 4.0))
    (window,) = joined(rows, np.full(3, 8), 0.5)
    assert window[GAP] == pytest.approx(2.0)  # from 1.1 s to 3.1 s
    assert window[D2] == pytest.approx([1.0 + 4.0] * 3)  # steps between cells of one sample
    (early,) = joined(rows[:2], np.full(2, 8), 0.5)
    assert early[GAP] == pytest.approx(2.9)  # from 1.1 s to the border at 4 s


def test_the_longest_window_may_lack_one_sample_more() -> None:
    rows = cells((0, 0.1, 1.0), (2, 0.1, 2.0), (6, 0.1, 4.0))
    assert not sparse(joined(rows, np.full(3, 8), 0.5), 8).any()
    assert sparse(joined(rows[:2], np.full(2, 8), 0.5), 8).all()
    assert sparse(joined(cells((0, 0.1, 1.0)), np.ones(1, dtype=int), 0.5), 8).all()
