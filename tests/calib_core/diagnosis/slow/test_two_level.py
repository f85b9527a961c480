"""Courses between two levels: found where there is one, and not in noise."""

from __future__ import annotations

import numpy as np

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
    where = np.flatnonzero(found.changes)
    assert found.switches == len(switches) and np.abs(where - switches).max() <= 1
    assert (found.changes[where] == [1, -1, 1, -1, 1, -1]).all() or (
        found.changes[where] == [-1, 1] * 3
    ).all()


def test_noise_grows_few_courses_and_none_that_gains_its_price() -> None:
    rng = np.random.default_rng(5)
    gains = []
    for _ in range(40):
        gram, target, power = products(rng.normal(size=(240, 3)))
        found = grown(gram, target, power, *sorted(rng.choice(BORDERS, 2, replace=False)))
        if found is None:
            continue
        signs = found.changes.astype(float)
        information = np.einsum("i,iajb,j->ab", signs, gram, signs) + np.eye(3)
        pull = signs @ target
        gains.append(0.5 * pull @ np.linalg.solve(information, pull) - found.log_trials)
    assert max(gains, default=-np.inf) < 3.0 * np.log(10.0)


def test_a_single_stretch_is_left_to_its_own_hypothesis() -> None:
    y = course([20, 40], 240)[:, None] * np.ones(3) * 3.0
    assert grown(*products(y + np.random.default_rng(1).normal(size=y.shape)), 20, 40) is None
