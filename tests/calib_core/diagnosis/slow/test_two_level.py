"""Courses between two levels: found where there is one, and not in noise."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.slow.two_level import grown

BORDERS = 60


def products(y: Array) -> tuple[Array, Array, float]:
    """Inner products of steps at the borders on each axis, those with data (n, 3), and its power."""
    n = len(y)
    steps = (np.arange(n) >= np.linspace(2, n - 2, BORDERS).round()[:, None]).astype(float)
    steps -= steps.mean(axis=1, keepdims=True)
    gram = np.einsum("ij,ab->iajb", steps @ steps.T, np.eye(3))
    away = y - y.mean(axis=0)
    scale = float((away**2).mean())
    return gram / scale, steps @ away / scale, float(y.size)


def course(switches: list[int], n: int) -> Array:
    """Zero and one in turn, changing at each of the borders."""
    at = np.linspace(2, n - 2, BORDERS).round()[switches]
    return np.asarray(np.searchsorted(at, np.arange(n), side="right") % 2, dtype=np.float64)


def test_the_switches_of_a_course_are_found() -> None:
    rng = np.random.default_rng(3)
    switches = [8, 14, 22, 31, 40, 47]
    y = course(switches, 240)[:, None] * np.array([1.5, -1.0, 0.5]) + rng.normal(size=(240, 3))
    found = grown(*products(y), 8, 14)
    assert found is not None
    levels = np.abs(np.cumsum(found.changes))
    where = np.flatnonzero(np.diff(np.round(levels), prepend=0.0))
    assert found.switches == len(switches) and np.abs(where - switches).max() <= 1
    assert levels.min() >= 0.0 and levels.max() <= 1.0 + 1e-12


def test_switches_within_bins_leave_the_levels_as_far_apart_as_they_are() -> None:
    """Steps between two borders are shared by these, also where the noise is a walk that follows outliers."""
    rng, n, places = np.random.default_rng(4), 120, np.array([12.3, 30.6, 47.5, 66.2, 81.0, 99.8])
    signs = np.array([1.0, -1.0] * 3)
    ramps = np.clip(np.arange(n)[:, None] - places + 1.0, 0.0, 1.0)
    y = np.outer(ramps @ signs, [1.0, -0.4, 0.0]) + 0.02 * rng.normal(size=(n, 3))
    steps = (np.arange(n) >= np.arange(2, n - 2)[:, None]).astype(float)
    whitened, away = np.diff(steps, axis=1), np.diff(y, axis=0)
    scale = 0.03**2
    gram = np.einsum("ij,ab->iajb", whitened @ whitened.T / scale, np.eye(3))
    found = grown(gram, whitened @ away / scale, float(away.size), 10, 29)
    assert found is not None and found.switches == 6
    curve = found.changes @ whitened
    sizes = curve @ away / (curve @ curve)
    assert sizes == pytest.approx([1.0, -0.4, 0.0], abs=0.04)


def test_noise_grows_few_courses_and_none_that_gains_its_price() -> None:
    rng = np.random.default_rng(5)
    gains = []
    for _ in range(40):
        gram, target, power = products(rng.normal(size=(240, 3)))
        found = grown(gram, target, power, *sorted(rng.choice(BORDERS, 2, replace=False)))
        if found is None:
            continue
        signs = found.changes
        information = np.einsum("i,iajb,j->ab", signs, gram, signs) + np.eye(3)
        pull = signs @ target
        gains.append(0.5 * pull @ np.linalg.solve(information, pull) - found.log_trials)
    assert max(gains, default=-np.inf) < 3.0 * np.log(10.0)


def test_a_single_stretch_is_left_to_its_own_hypothesis() -> None:
    y = course([20, 40], 240)[:, None] * np.ones(3) * 3.0
    assert grown(*products(y + np.random.default_rng(1).normal(size=y.shape)), 20, 40) is None
