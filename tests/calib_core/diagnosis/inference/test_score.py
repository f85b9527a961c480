"""The score of a hypothesis: what chance makes of it, and no end to how sure it may be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from stillcal.calib_core.diagnosis.inference.score import score


@pytest.mark.parametrize(("parameters", "dof"), [(1, 30.0), (3, 705.0), (9, 7200.0)])
def test_it_is_the_tail_of_f_less_the_trials(parameters: int, dof: float) -> None:
    for gain in (0.0, 3.0, 40.0):
        ratio = np.expm1(2.0 * gain / dof) / parameters * (dof - parameters)
        tail = float(f_distribution.sf(ratio, parameters, dof - parameters))
        assert score(gain, parameters, dof, 10) == pytest.approx(-np.log10(tail) - 1.0, abs=1e-9)


@pytest.mark.parametrize(("parameters", "dof"), [(1, 30.0), (3, 705.0), (9, 7200.0)])
def test_the_surest_is_never_lost(parameters: int, dof: float) -> None:
    """A probability less than a double holds was once taken for none at all."""
    scores = np.array([score(gain, parameters, dof, 1) for gain in np.arange(10.0, 5000.0, 10.0)])
    assert np.isfinite(scores).all() and scores[-1] > 330.0
    steps = np.diff(scores)
    assert steps.min() > 0.0 and np.abs(np.diff(steps))[5:].max() < 0.05 * steps.max()
