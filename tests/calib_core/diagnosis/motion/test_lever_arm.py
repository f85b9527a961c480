"""An arm that windows of one walk agree on, and walks do not, is how each walker happens to swing."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.motion.block_regression import Regression
from stillcal.calib_core.diagnosis.motion.lever_arm import lever_arm

WALKS, WINDOWS = 10, 12
WHERE = Where(0.0, 1000.0, (0.0, 0.0), "rate of turn")


def found(seed: int, common: float, of_walk: float) -> Finding | None:
    """Return the arm of ten walks. common: m, of all of them; of_walk: m, sd of what each seems to have."""
    rng = np.random.default_rng(seed)
    designs, lefts = [], []
    for _ in range(WALKS):
        arm = common * np.array([1.0, -1.0, 0.5]) + of_walk * rng.normal(size=3)
        for _ in range(WINDOWS):
            design = 3.0 * rng.normal(size=(64, 3, 3))
            designs.append(design)
            lefts.append(design @ arm + 0.2 * rng.normal(size=(64, 3)))
    return lever_arm(Regression.of(designs, lefts), 0.0, WHERE)


@pytest.mark.parametrize(("common", "said"), [(0.0, 0), (0.1, 60)])
def test_windows_of_one_walk_are_no_trials_of_their_own(common: float, said: int) -> None:
    """Of 60 walkers whose swing looks like arms of 4 cm (sd), another one in each walk, 3 had an arm."""
    assert sum(found(seed, common, 0.04) is not None for seed in range(60)) == said
