"""Two baselines that answer in the same layout: affine + white noise with BIC, and sparse regression.

Both see slow biases only; noise, stamps, values and motion they leave alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.baseline_views import Candidate, Seen, candidates, seen
from stillcal.replay.formats.trace import Recording

MOST = 3
"""Forward steps a sensor."""

RIDGE = 0.01
"""Ridge on standardised columns."""

FOLDS = 5
THRESHOLDS = (0.05, 0.1, 0.2, 0.4, 0.8, np.inf)
"""Standardised coefficients below which a term is dropped: the largest within one standard error of the
best in cross-validation (Hastie, Tibshirani and Friedman 2009, 7.10). Infinity is to say nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A candidate's coefficients (k, channels) with their standard errors, and the rms before and after."""

    candidate: Candidate
    values: Array
    errors: Array
    before: float
    after: float


def _channels(view: Seen, sensor: str) -> tuple[Array, Array]:
    """Return a sensor's values (m, channels) and what calibration takes off (m, p)."""
    if sensor == "accel":
        return view.norm[:, None], view.baseline
    assert view.rate is not None, "a gyroscope is only asked about where there is one"
    return view.rate, np.ones((view.t.size, 1))


def _solved(design: Array, values: Array) -> tuple[Array, float]:
    """Return least-squares coefficients and the residual sum of squares."""
    coefficients = np.asarray(np.linalg.lstsq(design, values, rcond=1e-9)[0], dtype=np.float64)
    return coefficients, float(((values - design @ coefficients) ** 2).sum())


def _bic(rss: float, n: int, parameters: int) -> float:
    """Return Schwarz's criterion with white noise of unknown variance (Schwarz 1978)."""
    return n * float(np.log(max(rss, 1e-300) / n)) + parameters * float(np.log(n))


def by_bic(recording: Recording, name: str) -> dict[str, Any]:
    """Answer by forward selection under white noise, as long as BIC falls."""
    return _answer(recording, name, _forward)


def _forward(view: Seen, sensor: str) -> list[Fitted]:
    values, base = _channels(view, sensor)
    n, design = values.size, base
    chosen: list[Candidate] = []
    score = _bic(_solved(design, values)[1], n, _rank(design) * values.shape[1])
    pool = candidates(view, sensor)
    while pool and len(chosen) < MOST:
        scores = [_judged(np.hstack([design, c.columns]), values, bool(c.told)) for c in pool]
        best = int(np.argmin(scores))
        if scores[best] >= score:
            break
        score, design = scores[best], np.hstack([design, pool[best].columns])
        chosen.append(pool[best])
        pool = [c for c in pool if c.effect != pool[best].effect]
    return _fits(chosen, base, values)


def _judged(design: Array, values: Array, shaped: bool) -> float:
    rss = _solved(design, values)[1]
    return _bic(rss, values.size, _rank(design) * values.shape[1] + shaped)


def _rank(design: Array) -> int:
    return int(np.linalg.matrix_rank(design, rtol=1e-9))


def _fits(chosen: list[Candidate], base: Array, values: Array) -> list[Fitted]:
    """Fit all that was chosen together; errors as for white noise."""
    design = np.hstack([base, *(c.columns for c in chosen)])
    coefficients, rss = _solved(design, values)
    before, n = _solved(base, values)[1], values.size
    spread = np.sqrt(
        rss / max(n - design.shape[1], 1) * np.diag(np.linalg.pinv(design.T @ design, rtol=1e-12))
    )
    fits, at = [], base.shape[1]
    for candidate in chosen:
        rows = slice(at, at + candidate.columns.shape[1])
        errors = np.repeat(spread[rows, None], values.shape[1], axis=1)
        fits.append(Fitted(candidate, coefficients[rows], errors, np.sqrt(before / n), np.sqrt(rss / n)))
        at = rows.stop
    return fits


def by_sparse_regression(recording: Recording, name: str) -> dict[str, Any]:
    """Answer by sequentially thresholded least squares over all columns at once (Brunton et al. 2016)."""
    return _answer(recording, name, _sparse)


def _sparse(view: Seen, sensor: str) -> list[Fitted]:
    values, base = _channels(view, sensor)
    pool = candidates(view, sensor)
    columns = np.hstack([c.columns for c in pool])
    owner = np.repeat(np.arange(len(pool)), [c.columns.shape[1] for c in pool])
    free = _without(base, columns)
    target = _without(base, values)
    free, target = free / (free.std(axis=0) + 1e-12), target / (target.std(axis=0) + 1e-12)
    losses = np.array([_crossed(free, target, threshold) for threshold in THRESHOLDS])
    best = int(np.argmin(losses.mean(axis=1)))
    bound = losses[best].mean() + losses[best].std(ddof=1) / np.sqrt(FOLDS)
    sparsest = int(np.flatnonzero(losses.mean(axis=1) <= bound)[-1])
    kept = _thresholded(free, target, THRESHOLDS[sparsest])
    names = {pool[i].effect: pool[i] for i in owner[kept.any(axis=1)]}
    return _fits(list(names.values()), base, values)


def _without(base: Array, values: Array) -> Array:
    return np.asarray(values - base @ np.linalg.lstsq(base, values, rcond=1e-9)[0])


def _ridged(design: Array, target: Array) -> Array:
    """Return ridge coefficients, as thresholding among look-alikes needs (Rudy et al. 2017, STRidge)."""
    normal = design.T @ design + RIDGE * len(design) * np.eye(design.shape[1])
    return np.asarray(np.linalg.solve(normal, design.T @ target))


def _thresholded(design: Array, target: Array, threshold: float) -> Array:
    """Return which coefficients (k, channels) outlive ten rounds of least squares and thresholding."""
    kept = np.ones((design.shape[1], target.shape[1]), dtype=np.bool_)
    for _ in range(10):
        for channel in range(target.shape[1]):
            rows = np.flatnonzero(kept[:, channel])
            kept[rows, channel] = np.abs(_ridged(design[:, rows], target[:, channel])) >= threshold
    return np.asarray(kept)


def _crossed(design: Array, target: Array, threshold: float) -> Array:
    """Return the mean square left on each left-out block, in units of what there was on average."""
    left = []
    for block in np.array_split(np.arange(len(target)), FOLDS):
        inside = np.delete(np.arange(len(target)), block)
        kept = _thresholded(design[inside], target[inside], threshold)
        rest = target[block].copy()
        for channel in range(target.shape[1]):
            rows = np.flatnonzero(kept[:, channel])
            solved = _ridged(design[np.ix_(inside, rows)], target[inside, channel])
            rest[:, channel] -= design[np.ix_(block, rows)] @ solved
        left.append(float((rest**2).mean() / (target**2).mean()))
    return np.array(left)


def _answer(recording: Recording, name: str, select: Callable[[Seen, str], list[Fitted]]) -> dict[str, Any]:
    view = seen(recording)
    sensors = [] if view is None else ["accel"] + (["gyro"] if view.rate is not None else [])
    findings = [_finding(f, view) for s in sensors if view is not None for f in select(view, s)]
    return {
        "schema": 1,
        "recording": name,
        "verdict": "explained" if findings else "adequate",
        "findings": findings,
    }


def _finding(fitted: Fitted, view: Seen) -> dict[str, Any]:
    c = fitted.candidate
    values, errors = fitted.values, fitted.errors
    if c.parameter == "matrix":
        values, errors = values.T, errors.T
    else:
        values, errors = values.ravel(), errors.ravel()
    spread = 1.96 * errors
    size = np.abs(values / np.maximum(errors, 1e-300)).reshape(3, -1).max(axis=1)
    interval = np.stack([values - spread, values + spread], axis=-1)
    parameters: dict[str, Any] = {
        c.parameter: {"value": values.tolist(), "ci95": interval.tolist(), "unit": c.unit},
        **{key: {"value": value, "ci95": None, "unit": "s"} for key, value in c.told.items()},
    }
    return {
        "effect": c.effect,
        "sensor": c.sensor,
        "axes": [axis for axis, s in zip("xyz", size, strict=True) if s > 2.6],
        "where": {
            "t_start": c.told.get("at_s", float(view.t[0])),
            "t_end": float(view.t[-1]),
            "band_hz": [0.0, 0.05],
            "driver": c.driver,
        },
        "parameters": parameters,
        "evidence": {"rmse_before": float(fitted.before), "rmse_after": float(fitted.after)},
        "alternatives": [],
        "statement": f"{c.effect} by {c.driver}",
    }


SOLVERS: dict[str, Callable[[Recording, str], dict[str, Any]]] = {
    "affine_white_bic": by_bic,
    "sparse_regression": by_sparse_regression,
}
"""The baselines by name."""
