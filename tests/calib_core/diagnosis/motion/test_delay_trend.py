"""Whether a delay grows, where windows that follow each other err alike."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.motion.block_regression import Regression
from stillcal.calib_core.diagnosis.motion.delay_trend import DelayTrend

SEEDS = 150


def trend(seed: int, walk: int, growth: float = 0.0) -> DelayTrend:
    """Fit a delay, s, to 120 windows; those of one walk, `walk` windows long, are off by the same."""
    rng = np.random.default_rng(seed)
    age = np.linspace(-0.5, 0.5, 120)
    off = np.repeat(rng.normal(0.0, 0.03, 120 // walk), walk) + rng.normal(0.0, 0.01, 120)
    moved = rng.normal(0.0, 1.0, (120, 40, 3))
    designs = [np.stack([m, m * a], axis=2) for m, a in zip(moved, age, strict=True)]
    seen = [m * (growth * a + x) for m, a, x in zip(moved, age, off, strict=True)]
    return DelayTrend(Regression.of(designs, seen), 0.0, 0.0, 0.0)


@pytest.mark.parametrize("walk", [1, 6])
def test_walks_of_many_windows_are_not_taken_for_a_delay_that_grows(walk: int) -> None:
    grown = sum(trend(seed, walk).grows for seed in range(SEEDS))
    assert grown <= 0.03 * SEEDS  # 1 % is meant


def test_a_delay_that_grows_is_seen_across_walks() -> None:
    assert trend(0, 6, growth=0.15).grows
