"""Eq. 5 to 8 of Grammenos et al. 2018: what norms determine, and how fast Eq. 6 converges."""

import numpy as np
import pytest

from stillcal.replay.studies.grammenos2018.minimisation import (
    by_equation_6,
    change_by_turning,
    determined,
    equations,
    find,
    norm_error,
    sensor,
)


def test_norms_determine_nine_parameters_of_twelve() -> None:
    rests = sensor(np.random.default_rng(0)).rests
    assert [determined(equations(rests, p), equations(rests, p).start()) for p in (6, 9, 12)] == [6, 9, 9]
    assert determined(equations(rests[:5], 9), equations(rests[:5], 9).start()) == 5
    assert change_by_turning(equations(rests, 12), np.random.default_rng(1)) < 1e-14


def test_a_damped_step_leaves_one_less_delta_and_a_full_one_its_square() -> None:
    one = sensor(np.random.default_rng(2))
    norms = equations(one.rests, 9)
    for delta in (0.5, 0.75, 0.9):
        run = by_equation_6(norms, delta)
        assert run.ratios[-1] == pytest.approx(1.0 - delta, abs=2e-3)
        assert run.order == pytest.approx(1.0, abs=0.05)
    assert by_equation_6(norms, 1.0).order == pytest.approx(2.0, abs=0.3)
    assert by_equation_6(norms, 0.5).iterations > by_equation_6(norms, 0.9).iterations > 5
    assert norm_error(one, norms, by_equation_6(norms, 1.0).v) < 2e-3 < norm_error(one, norms, norms.start())


def test_all_ways_are_compared_on_the_same_sensors() -> None:
    found = find(3, 0, lambda share: None)
    assert found.rank.tolist() == [[9, 9]] * 3
    assert found.norm[:, 1] == pytest.approx(found.norm[:, 2], rel=1e-3)
    assert (found.norm[:, 0] > found.norm[:, 1]).all()
