"""Tables of very many rests become as few bins as a recording has, as well known as their rests."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.merged_rests import merged
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import MOST_BINS
from stillcal.calib_core.diagnosis.segments.static_bins import Bins

SLOPE = 0.01


def _table(up: Array, rng: np.random.Generator, sd: float = 0.01, slope: float = SLOPE) -> Bins:
    n = len(up)
    t = 60.0 * np.arange(n)
    warm = 25.0 + 5.0 * np.sin(t / t[-1] * 6.0)
    force = 9.80665 * up + rng.normal(size=(n, 3)) * sd
    force[:, 0] += slope * (warm - 25.0)
    return Bins(
        t=t,
        duration=np.full(n, 20.0),
        rest=np.arange(n),
        force=force,
        force_variance=np.full((n, 3), sd**2),
        vibration=np.ones(n),
        activity=np.stack([t, np.zeros(n)], axis=1),
        span=(0.0, float(t[-1] + 20.0)),
        temperature=warm,
    )


def _directions(n: int, rng: np.random.Generator) -> Array:
    up = rng.normal(size=(n, 3))
    return np.asarray(up / np.linalg.norm(up, axis=1, keepdims=True))


def test_a_table_that_is_short_enough_stays_as_it_is() -> None:
    rng = np.random.default_rng(0)
    table = _table(_directions(MOST_BINS, rng), rng)
    assert merged(table) is table
    assert len(merged(_table(_directions(MOST_BINS + 1, rng), rng))) <= MOST_BINS


def test_rests_of_few_attitudes_are_merged_without_loss() -> None:
    rng = np.random.default_rng(1)
    six = np.vstack([np.eye(3), -np.eye(3)])
    table = _table(six[rng.integers(0, 6, 6000)], rng)
    found = merged(table)
    assert MOST_BINS / 2 < len(found) <= MOST_BINS
    assert (np.diff(found.t) > 0.0).all()
    # All rests are in: the bins are as well known as the rests together.
    known = (1.0 / found.force_variance[:, 0]).sum()
    assert known == pytest.approx((1.0 / table.force_variance[:, 0]).sum(), rel=1e-9)
    # What they show is what the rests show, within its error.
    lying = np.abs(found.force[:, 2]) > 9.0
    assert found.temperature is not None
    slope = np.polyfit(found.temperature[lying], found.force[lying, 0], 1)[0]
    error = 0.01 / np.sqrt(2000.0) / found.temperature[lying].std()
    assert abs(slope - SLOPE) < 4.0 * error
    # And the spread about the line is the one stated.
    away = found.force[lying, 0] - np.polyval([slope, 0.0], found.temperature[lying] - 25.0)
    assert np.mean(away**2 / found.force_variance[lying, 0]) == pytest.approx(1.0, abs=0.5)


def test_the_norm_of_merged_rests_is_not_short() -> None:
    rng = np.random.default_rng(2)
    up = np.array([0.0, 0.0, 1.0]) + rng.normal(size=(3000, 3)) * 0.005
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    found = merged(_table(up, rng, sd=1e-4, slope=0.0))
    # The mean of directions 0.005 rad apart is 1.2e-4 m/s^2 short and more.
    assert abs(float(np.mean(np.linalg.norm(found.force, axis=1))) - 9.80665) < 5e-5


def test_where_every_attitude_is_another_rests_are_left_out_all_along_the_table() -> None:
    rng = np.random.default_rng(3)
    table = _table(_directions(4000, rng), rng)
    found = merged(table)
    assert 0.9 * MOST_BINS <= len(found) <= MOST_BINS
    assert np.diff(found.t).max() < 0.05 * (table.span[1] - table.span[0])


def test_bins_of_one_mean_time_still_follow_one_another() -> None:
    rng = np.random.default_rng(4)
    there_and_back = np.tile([0, 1, 1, 0], 300)
    found = merged(_table(np.eye(3)[there_and_back], rng))
    assert (np.diff(found.t) > 0.0).all()
