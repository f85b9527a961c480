"""Windows of motion are weighed by what is left in them, until that stays."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.motion.delay_fit import Weighed


def test_weights_are_those_of_what_the_fit_leaves_and_not_of_what_it_explains() -> None:
    """At first all of an effect is left: what is sure of it, slow motion, then has the least weight."""
    rng, slow = np.random.default_rng(1), 1.0 / (1.0 + (np.arange(120.0) / 6.0) ** 4)

    def white(*shape: int) -> np.ndarray:
        return np.asarray(rng.normal(size=shape) + 1j * rng.normal(size=shape))

    motion = [slow[:, None, None] * white(120, 3, 1) for _ in range(12)]
    measured = [x + 0.003 * white(120, 3, 1) for x in motion]
    felt = [x[:, :, 0] + 0.005 * white(120, 3) for x in motion]
    assert Weighed.of(measured, felt).sums.fitted()[0] == pytest.approx(1.0, abs=0.02)
