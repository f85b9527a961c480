"""A view's sums, beside the same sums by plain linear algebra, shape by shape."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.inference.likelihood import fit_hypothesis
from stillcal.calib_core.diagnosis.inference.noise_models import families
from stillcal.calib_core.diagnosis.inference.reduction import reduce_view
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from tests.support.diagnosis import nulls


@pytest.fixture(scope="module")
def views() -> list[View]:
    rng = np.random.default_rng(8)
    bins = nulls.bins_of(rng, nulls.schedule(rng), "flicker")
    return [view for residuals in by_sensor(bins, nulls.G) for view in residuals.views]


def by_residual_projection(
    view: View, columns: np.ndarray, found: np.ndarray
) -> list[tuple[np.ndarray, ...]]:
    """Return y'y, x'y and x'x under each shape of a view with one block, by the pseudo-inverse."""
    out = []
    for family in families(view):
        for diagonal in family.diagonals:
            white = family.rotation / np.sqrt(diagonal)[:, None]
            taken = white @ np.concatenate([view.baseline[0], found], axis=1)
            away = np.eye(len(white)) - taken @ np.linalg.pinv(taken, rcond=1e-9)
            y, x = away @ white @ view.y[0], away @ white @ columns
            out.append((np.asarray(y @ y), x.T @ y, x.T @ x))
    return out


@pytest.mark.parametrize("twice", [False, True])
def test_the_sums_are_those_of_plain_algebra_though_what_was_found_came_twice(
    views: list[View], twice: bool
) -> None:
    rng = np.random.default_rng(9)
    view = next(v for v in views if len(v.y) == 1)
    columns = rng.normal(size=(view.y.shape[1], 4))
    columns[:, 2] = 0.0  # as an axis is that a view of another axis does not see
    found = rng.normal(size=(view.y.shape[1], 2))
    again = np.concatenate([found, 3.0 * found[:, :1], view.baseline[0][:, :1]], axis=1) if twice else found
    reduced = reduce_view(view, columns[None], [np.arange(4), np.array([1]), np.array([2])], again[None])
    assert view.memo["baselines"].keys() == {f.name for f in families(view)}  # the second case takes them
    plain = by_residual_projection(view, columns, found)
    for mine, theirs in zip(
        (reduced.yy, reduced.pulls[0], reduced.blocks[0]), zip(*plain, strict=True), strict=True
    ):
        np.testing.assert_allclose(mine, np.array(theirs), rtol=1e-7, atol=1e-7 * np.abs(theirs).max())
    np.testing.assert_allclose(reduced.blocks[1][:, 0, 0], reduced.blocks[0][:, 1, 1])
    assert reduced.blocks[2].shape == (len(plain), 1, 1) and not reduced.blocks[2].any()


def test_two_blocks_have_their_baselines_apart_and_what_was_found_together(views: list[View]) -> None:
    view = next((v for v in views if len(v.y) > 1), None)
    if view is None:
        pytest.skip("no view here has two blocks")
    rng = np.random.default_rng(10)
    blocks, n = view.y.shape
    columns, found = rng.normal(size=(blocks, n, 3)), rng.normal(size=(blocks, n, 1))
    reduced = reduce_view(view, columns, [np.arange(3)], found)
    family, g = families(view)[0], 0
    white = family.rotation / np.sqrt(family.diagonals[g])[:, None]
    p = view.baseline.shape[2]
    taken = np.zeros((blocks * n, blocks * p + 1))
    for block, (first, last) in enumerate(pairwise(range(0, blocks * n + 1, n))):
        taken[first:last, block * p : (block + 1) * p] = white @ view.baseline[block]
        taken[first:last, -1:] = white @ found[block]
    away = np.eye(blocks * n) - taken @ np.linalg.pinv(taken, rcond=1e-9)
    y, x = away @ (view.y @ white.T).ravel(), away @ (white @ columns).reshape(blocks * n, 3)
    np.testing.assert_allclose(reduced.yy[g], y @ y, rtol=1e-7)
    np.testing.assert_allclose(reduced.pulls[0][g], x.T @ y, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(reduced.blocks[0][g], x.T @ x, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("n", "known", "factor"), [(22, 0.1, 0.3), (22, 0.1, 3.0), (22, 4.0, 1.0), (16, 0.1, 1.0)]
)
def test_errors_of_many_numbers_fitted_to_few_residuals_hold(n: int, known: float, factor: float) -> None:
    """Nine numbers of 22 residuals, as of eleven turns. Without what they leave too little: 1.4 errors."""
    rng = np.random.default_rng(3)
    k, off = 9, []
    for _ in range(400):
        columns = rng.normal(size=(1, n, k)) / np.sqrt(n)
        view = View(
            "turn", factor * rng.normal(size=(1, n)), np.zeros((1, n, 0)), np.ones(n), np.eye(n),
            np.zeros((1, n, 3)), np.arange(n), np.arange(n) * 10.0, np.ones(n), np.arange(n), known=known,
        )  # fmt: skip
        fit = fit_hypothesis([reduce_view(view, 100.0 * columns, [np.arange(k)])], 0)
        off.append(fit.beta @ np.linalg.solve(fit.covariance, fit.beta) / k)
    # Student's distribution with so few degrees of freedom: its mean square is that of its variance.
    assert 0.8 < np.mean(off) < 1.2
