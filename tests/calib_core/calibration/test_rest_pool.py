"""The pool of rests: bounded, and no attitude displaces another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.calibration import rest_pool
from stillcal.calib_core.calibration.rest_pool import AttitudeIndex, HeldRest, Pool, PoolSettings
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.gyroscope import rotation_segment
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.static.rest import RestState
from tests.support.turned_phones import recording


def rest(direction: np.ndarray, t: float, uncertainty: float = 1e-3) -> HeldRest:
    force = 9.8 * direction / np.linalg.norm(direction)
    sigma = np.full(3, uncertainty)
    return HeldRest(RestState(t, t + 10, 1000, force, sigma * 30, sigma, uncertainty * 30), Gravity())


def filled(directions: np.ndarray, settings: PoolSettings, uncertainty: float = 1e-3) -> Pool:
    pool, index = Pool(), AttitudeIndex(settings)
    for i, direction in enumerate(directions):
        pool = index.with_rest(pool, rest(direction, 100.0 * i, uncertainty))
    return pool


def test_one_attitude_does_not_displace_the_others() -> None:
    settings = PoolSettings(rests_per_attitude=4)
    rare = np.eye(3)
    pool = filled(np.vstack([rare, np.tile([0.0, 0.0, 1.0], (200, 1))]), settings)
    assert len(pool.attitudes(settings)) == 3
    assert len(pool.held) == 2 + 4


def test_a_full_attitude_loses_its_least_certain_rest_and_keeps_the_newest() -> None:
    settings = PoolSettings(rests_per_attitude=3)
    pool, index = Pool(), AttitudeIndex(settings)
    for i, uncertainty in enumerate([1e-3, 5e-3, 2e-3, 1e-3, 9e-3]):
        pool = index.with_rest(pool, rest(np.array([0, 0, 1.0]), 100.0 * i, uncertainty))
    assert [h.rest.t_start for h in pool.held] == [0.0, 300.0, 400.0]


def test_old_rests_and_the_oldest_attitudes_go() -> None:
    rng = np.random.default_rng(1)
    settings = PoolSettings(attitudes=20, max_age_s=5000)
    pool = filled(rng.normal(size=(300, 3)), settings)
    assert len(pool.attitudes(settings)) <= 20
    assert pool.held[-1].rest.t_end - pool.held[0].rest.t_end <= 5000
    assert pool.held[-1].rest.t_start == 29900.0


def test_rotation_segments_outlive_rests_and_end_too() -> None:
    """A year of turns, one a week: those of the last 91 days stay, whether new ones come or not."""
    settings, week = PoolSettings(), 7 * 86400.0
    pool, index = Pool(), AttitudeIndex(settings)
    for number in range(52):
        before, after = (rest(np.eye(3)[axis], number * week + 20.0 * axis) for axis in (0, 2))
        t = number * week + np.linspace(9.0, 41.0, 5)
        pool = pool.with_segment(RotationSegment(before.rest, after.rest, t, np.zeros((5, 3))), settings)
        pool = index.with_rest(index.with_rest(pool, before), after)
    assert [round(s.t_start // week) for s in pool.turns] == list(range(51 - 12, 52))
    assert len(pool.held) < 7  # of the last 14 days
    late = rest(np.eye(3)[2], 51 * week + 100 * 86400.0)
    assert index.with_rest(pool, late).turns == ()


def test_an_index_kept_up_to_date_groups_as_a_new_one() -> None:
    """Crowded, ageing, near one another: each of the ways in which a rest may go and free the others."""
    rng, seen = np.random.default_rng(2), 0
    settings = PoolSettings(attitude_angle=0.3, rests_per_attitude=4, attitudes=30, max_age_s=9000)
    pool, index = Pool(), AttitudeIndex(settings)
    for i in range(600):
        new = rest(rng.normal(size=3) * [1.0, 1.0, 0.3], 100.0 * i, float(rng.uniform(1e-3, 1e-2)))
        fresh = AttitudeIndex(settings).with_rest(pool, new)
        pool = index.with_rest(pool, new)
        assert pool.held == fresh.held
        seen = max(seen, len(pool.attitudes(settings)))
        assert index.attitudes(pool) == len(pool.attitudes(settings))
    assert seen >= 30


def test_since_and_where_select() -> None:
    settings = PoolSettings()
    pool = filled(np.eye(3), settings)
    assert [h.rest.t_start for h in pool.since(100.0).held] == [100.0, 200.0]
    assert pool.where(lambda r: r.t_start < 50).held == pool.held[:1]


def test_senseless_bounds_are_refused() -> None:
    with pytest.raises(ValueError, match="attitude_angle"):
        PoolSettings(attitude_angle=2.0)
    with pytest.raises(ValueError, match="turns = 0"):
        replace(PoolSettings(), turns=0)


def test_turns_of_a_fast_sensor_stay_bounded_and_show_the_same_scale(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trip = recording(seed=3, n=20, rate_hz=400.0)
    most = sum(turn.t.size for turn in trip.turns) // 3
    monkeypatch.setattr(rest_pool, "MOST_SAMPLES", most)
    pool = Pool()
    for turn in trip.turns:
        pool = pool.with_segment(turn, PoolSettings())
    assert sum(turn.t.size for turn in pool.turns) <= most and len(pool.turns) == len(trip.turns)
    whole, thinned = trip.fit(), replace(trip, turns=list(pool.turns)).fit()
    assert (np.abs(thinned.model.scale - whole.model.scale) < whole.scale_uncertainty).all()
    assert thinned.rms_after < 1.2 * whole.rms_after


def test_a_segment_that_cannot_be_thinned_is_kept_whole_and_known_as_such(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trip = recording(seed=3, n=6, rate_hz=25.0)
    monkeypatch.setattr(rest_pool, "MOST_SAMPLES", trip.turns[0].t.size + trip.turns[1].t.size - 1)
    monkeypatch.setattr(rotation_segment, "MOST_LOST", 0.0)
    one, two = Pool().with_segment(trip.turns[0], PoolSettings()), trip.turns[1]
    (kept,) = one.with_segment(two, PoolSettings()).turns
    assert kept.thinnest and np.array_equal(kept.rates, two.rates)
