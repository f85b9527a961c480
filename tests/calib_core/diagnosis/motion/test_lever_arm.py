"""An arm that windows of one walk agree on, and walks do not, is how each walker happens to swing."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.motion.block_regression import Regression, of_arm, slope_power
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


@pytest.mark.parametrize("frequency", [2.0, 5.0, 10.0])
def test_what_an_arm_does_at_a_tenth_of_the_sample_rate_is_known_to_a_hundredth(frequency: float) -> None:
    """A hand's quick turns are no longer slow at 100 Hz."""
    t = np.arange(0.0, 8.0, 0.01)
    angle = 2.0 * np.pi * frequency * t
    rate, slope = np.zeros((t.size, 3)), 2.0 * np.pi * frequency * np.cos(angle)
    rate[:, 2] = np.sin(angle)
    inner = slice(50, 750)
    told = of_arm(t, rate)[inner, 1, 0]
    assert abs(float(told @ slope[inner]) / float(slope[inner] @ slope[inner]) - 1.0) < 0.01
    power = float(np.mean(told**2)) / float(np.mean(rate[inner, 2] ** 2))
    assert abs(float(slope_power(np.array(0.02 * np.pi * frequency))) / (power * 0.01**2) - 1.0) < 0.01
