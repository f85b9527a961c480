"""Tails without a fourth moment are found as surely as tails with one; normal noise and knocks have none."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.misfit.records import Finding, Where
from stillcal.calib_core.misfit.spectrum import Quiet
from stillcal.calib_core.misfit.tails import tails

WHERE = Where(0.0, 4000.0, (0.0, 12.5), "noise at rest")


def said(values: np.ndarray) -> Finding | None:
    pieces = tuple(values.reshape(100, 500, 3))
    return tails(Quiet(pieces, tuple(np.arange(100) * 20.0), 25.0), "accel", WHERE, 0.0)


@pytest.mark.parametrize("freedom", [2.5, 3.5, 4.5])
@pytest.mark.parametrize("seed", range(3))
def test_students_noise_has_heavy_tails_on_all_axes(freedom: float, seed: int) -> None:
    found = said(np.random.default_rng(seed).standard_t(freedom, (50000, 3)))
    assert found is not None and found.effect == "noise_heavy_tailed"
    assert found.axes == ["x", "y", "z"]


@pytest.mark.parametrize("seed", range(3))
def test_normal_noise_and_what_is_near_it_are_silent(seed: int) -> None:
    """Thirty degrees of freedom: an excess kurtosis of 6 / 26, below the tolerance."""
    rng = np.random.default_rng(seed)
    assert said(rng.normal(size=(50000, 3))) is None
    assert said(rng.standard_t(30.0, (50000, 3))) is None


def test_few_far_samples_are_spikes_and_no_heavy_tails() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(50000, 3))
    values[rng.random(50000) < 1e-3, 2] += 40.0
    found = said(values)
    assert found is not None and found.effect == "unknown" and found.axes == ["z"]
