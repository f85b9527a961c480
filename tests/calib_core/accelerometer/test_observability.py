"""Coverage: what attitudes support, and the one to add, in words."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.accelerometer import observability
from stillcal.calib_core.accelerometer.observability import (
    coverage,
    describe,
    missing_attitudes,
    most_helpful_attitude,
)
from stillcal.calib_core.static.rest import directions

FACES = np.vstack((np.eye(3), -np.eye(3)))


def spread(n, seed):
    return directions(np.random.default_rng(seed).normal(size=(n, 3)))


@pytest.mark.parametrize(
    ("up", "words"),
    [
        ([1, 0, 0], "lay it on its left edge (x axis up)"),
        ([-1, 0, 0], "lay it on its right edge (x axis down)"),
        ([0, 1, 0], "lay it upright on its bottom edge (y axis up)"),
        ([0, -1, 0], "lay it upside down on its top edge (y axis down)"),
        ([0, 0.1, 9], "lay it on its back, screen up (z axis up)"),
        ([0, 0, -1], "lay it on its face, screen down (z axis down)"),
    ],
)
def test_faces_in_words(up, words):
    assert describe(np.array(up, dtype=float)) == words


def test_between_faces_in_words():
    words = describe(np.array([1.0, 1.0, 0.05]))
    assert "halfway between" in words
    assert "left edge" in words
    assert "bottom edge" in words


def test_evenly_spread_attitudes_are_as_observable_as_can_be():
    """The 14 directions of the rule itself: observability is 1 in every parameter, by its definition."""
    even = np.vstack((observability.places()[:6], observability.places()[18:]))
    many = np.vstack((np.repeat(even[:6], 8, axis=0), np.repeat(even[6:], 9, axis=0)))  # weights 8 : 9
    for parameters in (6, 9):
        assert coverage(many, parameters).observability == pytest.approx(1.0)


def test_faces_do_not_show_cross_axis_terms():
    found = coverage(FACES, 9)
    assert found.amplification == np.inf
    assert dict(zip(found.names, found.observability > 0.0, strict=True)) == {
        **dict.fromkeys(("b_x", "b_y", "b_z", "S_xx", "S_yy", "S_zz"), True),
        **dict.fromkeys(("S_xy", "S_xz", "S_yz"), False),
    }


def test_faces_support_six_parameters_no_worse_than_one_rest():
    assert coverage(FACES, 6).amplification == pytest.approx(1.0, abs=1e-6)


def test_amplification_is_the_worst_predicted_standard_error():
    """Against a straightforward inverse on its own grid, to the grid's coarseness."""
    up = spread(15, 1)

    def rows(u):
        return np.column_stack((u, u**2, u[:, [0]] * u[:, 1:], u[:, 1] * u[:, 2]))

    grid = spread(4000, 2)
    predicted = rows(grid) @ np.linalg.inv(rows(up).T @ rows(up)) @ rows(grid).T
    assert observability.amplification(up, 9) == pytest.approx(np.sqrt(np.diag(predicted).max()), rel=0.03)


@given(seed=st.integers(0, 1000), n=st.integers(0, 12))
def test_helpful_attitude_is_a_unit_vector_not_yet_held(seed, n):
    up = spread(n, seed)
    wanted = most_helpful_attitude(up, 9)
    assert np.linalg.norm(wanted.up) == pytest.approx(1.0)
    assert n == 0 or (up @ wanted.up).max() < 0.999


@given(seed=st.integers(0, 1000), n=st.integers(0, 10), parameters=st.sampled_from([6, 9]))
def test_missing_attitudes_suffice(seed, n, parameters):
    up = spread(n, seed)
    added = missing_attitudes(up, parameters, 5.0, least=parameters)
    held = np.vstack([up.reshape(-1, 3), *(a.up for a in added)])
    assert len(held) >= parameters
    assert observability.amplification(held, parameters) <= 5.0


def test_nothing_missing_where_nothing_is():
    assert missing_attitudes(spread(40, 0), 9, 5.0) == ()


@pytest.mark.parametrize("parameters", [0, 7, 13])
def test_unknown_model_is_refused(parameters):
    with pytest.raises(ValueError, match="expected 6, 9 or 12"):
        coverage(FACES, parameters)
