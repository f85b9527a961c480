"""Samples in bursts lie where they were measured: after lost bursts, pauses, stalls and late ones."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.bursts import bursts

SIZE, PERIOD = 7, 0.01
COUNT = 400


def stamps(late: Array, lost: tuple[int, ...] = (), paused: float = 0.0) -> tuple[Array, Array]:
    """Return true places and stamps of bursts that come late (COUNT,) s; paused: s before the last half."""
    place = np.arange(COUNT * SIZE)
    burst = place // SIZE
    came = np.maximum.accumulate((np.arange(COUNT) + 1) * SIZE * PERIOD + late)
    came[COUNT // 2 :] += paused
    there = ~np.isin(burst, lost)
    return place[there], (came[burst] + 1e-4 * (place % SIZE))[there]


def test_lost_bursts_leave_their_places_empty_though_others_are_late() -> None:
    """One in four comes late by half of a burst, and of two that are lost near each other each is told."""
    late = np.where(np.arange(COUNT) % 4 == 2, 0.45 * SIZE * PERIOD, 0.0)
    place, t = stamps(late, lost=(60, 62, 150, 151, 300))
    found = bursts(t)
    assert found.place == pytest.approx(place)
    assert found.period == pytest.approx(PERIOD, rel=1e-3)


def test_what_stalls_and_is_made_up_for_is_not_lost() -> None:
    """Half a second late, ten bursts came 20 ms apart; the first ones of all were late too."""
    late = np.zeros(COUNT)
    late[100:110] = 0.5 - 0.05 * np.arange(10)
    late[:8] = 2.0 * SIZE * PERIOD
    place, t = stamps(late)
    assert bursts(t).place == pytest.approx(place)


def test_in_a_pause_nothing_is_lost_and_no_time_is_that_of_samples() -> None:
    place, t = stamps(np.zeros(COUNT), lost=(60,), paused=20.0)
    found = bursts(t)
    assert found.place == pytest.approx(place)
    assert found.period == pytest.approx(PERIOD, rel=1e-6)


def test_delays_that_wander_by_more_than_a_burst_tell_of_none_that_is_lost() -> None:
    late = np.cumsum(np.random.default_rng(2).normal(0.0, 0.5 * SIZE * PERIOD, COUNT))
    place, t = stamps(late - late.min())
    assert bursts(t).place == pytest.approx(place)


def test_long_waits_after_many_bursts_are_no_losses() -> None:
    """Two samples a millisecond, and 4 s of nothing after four in ten: 65 million places were left empty."""
    wait = np.where(np.random.default_rng(1).random(20_000) < 0.4, 4.0, 1e-3)
    t = np.repeat(np.cumsum(wait), 2) + np.tile([0.0, 1e-6], wait.size)
    assert bursts(t).place[-1] == t.size - 1
