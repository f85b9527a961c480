"""Whether one calibration holds for all rests that it was fitted to, or the sensor has changed among them.

A fit takes its parameters for constant. A bias that drifts, that steps, or that belongs to another phone from
some time on leaves residuals that follow time. Extra columns for a bias that changes are added to the fit's
own, and the fall of the residuals is judged by an F test (Draper and Smith 1998, Applied Regression Analysis,
section 6.1): a trend of the bias, a step of the bias between any two rests, and other parameters altogether
from some rest on (Chow 1960, Econometrica 28(3)), as another phone has. Where none of these shows, an
excursion of the bias is looked for: a step and the same step back. The scatter that remains is the yardstick,
so that other errors of the model make a finding less likely, never more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer.fit import AccelerometerFit
from stillcal.calib_core.accelerometer.parameters import basis
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.rest_pool import HeldRest
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.maths.f_distribution import tail
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.static.rest import RestState, force_uncertainties, forces

LEVEL = 1e-3
"""Probability of finding a change, of any kind, anywhere, where there is none; as much for an excursion."""

LEAST_SIDE = 5
"""Rests on either side of a step: fewer are explained by three extra parameters whatever they say."""

MOST_SPLITS = 32
"""Places at which a step is tried; of more rests, only every so many-th begins one."""

MOST_LEFT_OUT = 200
"""Up to so many rests, a finding must also stand without any single one of them."""

RANK = 1e-9
"""Share of the largest below which a direction counts as none."""

LATE_FACTOR, LATE_LEAST = 5.0, 0.02
"""Standard deviations by which a rest does not fit; m/s^2 (2 mg, as of a check) for the worst one."""


class Shape(StrEnum):
    """How a bias changes with time."""

    DRIFT = "drift"
    STEP = "step"
    EXCURSION = "excursion"


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """A bias that is not constant.

    at: s, when the first rest after a step began, or of a drift the first rest. size: (3,) m/s^2, raw, by how
    much the bias changes: at the step, or from the first rest to the last. shift: (p,), by how much this has
    shifted the fit's parameters, which took the bias for constant. span_s: s, over which it drifts, or until
    the first rest after an excursion; 0 for a step. warmth: correlation of a drift with temperature, NaN
    where that is unknown or constant. p_value: of the F test, for all places tried.
    """

    shape: Shape
    at: float
    size: Array
    shift: Array
    span_s: float
    warmth: float
    p_value: float

    @property
    def largest(self) -> float:
        """The largest axis of `size`, m/s^2."""
        return float(np.abs(self.size).max())

    @property
    def covariance(self) -> Array:
        """What the change adds to the covariance of the parameters, (p, p), bias first.

        The shift of all of them, and by how much the bias at either end may differ from a constant one.
        """
        added = np.outer(self.shift, self.shift)
        added[:3, :3] += np.diag(self.size**2)
        return added

    def words(self) -> str:
        """Return a sentence that describes the change."""
        largest_mg = self.largest / (STANDARD / 1000)
        if self.shape is Shape.STEP:
            return f"the bias changed by {largest_mg:.2g} mg at {self.at:.0f} s"
        if self.shape is Shape.EXCURSION:
            back = self.at + self.span_s
            return f"the bias changed by {largest_mg:.2g} mg at {self.at:.0f} s and back by {back:.0f} s"
        rate = largest_mg / (self.span_s / 60.0)
        follows = " as the temperature does" if abs(self.warmth) > FOLLOWS else ""
        return f"the bias drifts by {rate:.2g} mg/min{follows}"


FOLLOWS = 0.9
"""Correlation with temperature from which a drift is said to follow it."""


def find_change(fit: AccelerometerFit, held: Sequence[HeldRest]) -> Change | None:
    """Return how the bias changes among the rests that were fitted, None where no change shows."""
    order = np.argsort([h.rest.t_start for h in held], kind="stable")
    rests = [held[i].rest for i in order]
    t = np.array([(r.t_start + r.t_end) / 2 for r in rests])
    design, by_bias = norm_jacobian(fit, forces(rests))
    n, p = design.shape
    if n < p + 3 + 1 or n < 2 * LEAST_SIDE or t[-1] <= t[0]:
        return None
    scale = 1 / np.hypot(force_uncertainties(rests).max(axis=1), fit.rms_residual)
    residuals = fit.residuals[order] * scale
    design, by_bias = design * scale[:, None], by_bias * scale[:, None]
    drift = (t - t[0]) / (t[-1] - t[0])
    curves = [(Shape.DRIFT, 0, by_bias * drift[:, None])]
    curves += [(Shape.STEP, k, by_bias * _after(n, k)) for k in _splits(n, LEAST_SIDE)]
    curves += [(Shape.STEP, k, design * _after(n, k)) for k in _splits(n, p + 2)]
    tests = [_f_test(residuals, design, extra) for _, _, extra in curves]
    best = min(range(len(tests)), key=lambda i: tests[i][0])
    p_value = min(tests[best][0] * len(tests), 1.0)
    if p_value > LEVEL:  # nothing that lasts
        return _excursion(rests, residuals, design, by_bias)
    shape, split, extra = curves[best]
    _, solution = tests[best]
    if shape is Shape.STEP:
        columns = by_bias if extra.shape[1] == by_bias.shape[1] else design
        split = _placed(residuals, design, columns, split)
        extra = columns * _after(n, split)
        _, solution = _f_test(residuals, design, extra)
    if not _stands_without_any(residuals, design, extra, LEVEL / len(tests)):
        return None
    span = float(t[-1] - t[0]) if shape is Shape.DRIFT else 0.0
    celsius = np.array([np.nan if r.temperature is None else r.temperature for r in rests])
    warmth = _correlation(t, celsius) if shape is Shape.DRIFT else float("nan")
    size, shift = frozen(-solution[p : p + 3]), frozen(solution[:p])
    return Change(shape, rests[split].t_start, size, shift, span, warmth, p_value)


def _excursion(rests: Sequence[RestState], residuals: Array, design: Array, by_bias: Array) -> Change | None:
    """Return how the bias steps and steps back among rests in order of time, None where that does not show.

    residuals (n,), design (n, p) and by_bias (n, 3) are in standard deviations.
    """
    n, p = design.shape
    begins, ends = _excursions(n)
    if not len(begins):
        return None
    explained = _explained(residuals, design, by_bias, begins, ends)
    best = int(np.argmax(explained))
    begin, end = int(begins[best]), int(ends[best])
    extra = by_bias * (_after(n, begin) - _after(n, end))
    p_value, solution = _f_test(residuals, design, extra)
    p_value = min(p_value * len(begins), 1.0)
    if p_value > LEVEL or not _stands_without_any(residuals, design, extra, LEVEL / len(begins)):
        return None
    at, back = rests[begin].t_start, rests[end].t_start
    size, shift = frozen(-solution[p : p + 3]), frozen(solution[:p])
    return Change(Shape.EXCURSION, at, size, shift, back - at, float("nan"), p_value)


def _excursions(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rests with which an excursion may begin, and end, among n: LEAST_SIDE at least each way."""
    places = np.array(list(_splits(n, 1)), dtype=np.intp)
    begins, ends = (places[i] for i in np.triu_indices(len(places), 1))
    tried = (ends - begins >= LEAST_SIDE) & (n - (ends - begins) >= LEAST_SIDE)
    return begins[tried], ends[tried]


def _explained(
    residuals: Array, design: Array, by_bias: Array, begins: NDArray[np.intp], ends: NDArray[np.intp]
) -> Array:
    """Return by how much the squares (m,) fall if the bias is another one from begins to ends (m,).

    As a fit with these columns for each would find it; the sums over rests are running ones.
    """
    base, spread, _ = np.linalg.svd(_scaled(design)[0], full_matrices=False)
    base = base[:, spread > RANK * spread[0]]
    left = residuals - base @ (base.T @ residuals)

    def within(rows: Array) -> Array:
        running = np.concatenate((np.zeros((1, *rows.shape[1:])), np.cumsum(rows, axis=0)))
        between: Array = running[ends] - running[begins]
        return between

    shared = within(base[:, :, None] * by_bias[:, None, :])
    own = within(by_bias[:, :, None] * by_bias[:, None, :]) - shared.transpose(0, 2, 1) @ shared
    along = within(left[:, None] * by_bias)
    values, axes = np.linalg.eigh(own)
    known = values > RANK * np.maximum(values[:, -1:], 1e-300)
    turned = np.einsum("mij,mi->mj", axes, along)
    return np.asarray((np.where(known, turned**2 / np.where(known, values, 1.0), 0.0)).sum(axis=1))


@dataclass(frozen=True, slots=True)
class LateChange:
    """The newest rests do not fit. since: s, when the first of them began. largest: m/s^2, their residual."""

    since: float
    largest: float


def find_late_change(fit: AccelerometerFit, held: Sequence[HeldRest]) -> LateChange | None:
    """Return what the newest rests show where two of them do not fit.

    A sensor that changes so late that fewer than LEAST_SIDE rests follow shows no step; the fit takes those
    rests for bad ones, and holds for the time before. The scatter of the others is the yardstick, by its
    median, which bad rests do not move.
    """
    order = np.argsort([h.rest.t_start for h in held], kind="stable")
    rests = [held[i].rest for i in order]
    residuals = np.abs(fit.residuals[order])
    own = force_uncertainties(rests).max(axis=1)
    off = residuals > LATE_FACTOR * np.hypot(own, MAD_TO_SD * np.median(residuals))
    newest = np.flatnonzero(off[1 - LEAST_SIDE :]) + max(len(rests) - LEAST_SIDE + 1, 0)
    if len(newest) < 2 or residuals[newest].max() <= LATE_LEAST:
        return None
    return LateChange(rests[newest[0]].t_start, float(residuals[newest].max()))


def norm_jacobian(fit: AccelerometerFit, raw: Array) -> tuple[Array, Array]:
    """Return derivatives of the calibrated norm of raw forces (n, 3) by parameters (n, p) and bias (n, 3)."""
    shifted = raw - fit.model.bias
    calibrated = shifted @ fit.model.scale.T
    up = calibrated / np.linalg.norm(calibrated, axis=1)[:, None]
    by_bias = -up @ fit.model.scale
    by_scale = (up[:, :, None] * shifted[:, None, :]).reshape(-1, 9)
    return np.hstack((by_bias, by_scale)) @ basis(fit.parameters, fit.form), by_bias


def _after(n: int, split: int) -> Array:
    return (np.arange(n) >= split).astype(np.float64)[:, None]


def _splits(n: int, side: int) -> Iterator[int]:
    """Yield the rests of n before which a step is tried, with `side` rests at least on either side."""
    yield from range(side, n - side + 1, _apart(n, side))


def _apart(n: int, side: int) -> int:
    """Return of how many rests one begins a step that is tried."""
    return max(1, -(-(n - 2 * side + 1) // MOST_SPLITS))


def _placed(residuals: Array, design: Array, columns: Array, tried: int) -> int:
    """Return the rest before which a step explains most, of those between the neighbours of the one tried."""
    n = len(residuals)
    side = LEAST_SIDE if columns.shape[1] == 3 else design.shape[1] + 2
    away = _apart(n, side) - 1
    places = range(max(tried - away, side), min(tried + away, n - side) + 1)
    return min(places, key=lambda k: _left(residuals, np.hstack((design, columns * _after(n, k))))[0])


def _f_test(residuals: Array, design: Array, extra: Array) -> tuple[float, Array]:
    """Return the probability that extra columns (n, k) explain as much by chance, and all coefficients."""
    n = len(residuals)
    both = np.hstack((design, extra))
    before, rank_before, _ = _left(residuals, design)
    after, rank_after, solution = _left(residuals, both)
    free, more = n - rank_after, rank_after - rank_before
    if free < 1 or more < 1:
        return 1.0, solution
    ratio = max(before - after, 0.0) / more / max(after / free, 1e-300)
    return tail(ratio, more, free), solution


def _left(residuals: Array, design: Array) -> tuple[float, int, Array]:
    """Return the sum of squares that a least-squares fit leaves, the design's rank, and the solution."""
    columns, norms = _scaled(design)
    solution, _, rank, _ = np.linalg.lstsq(columns, residuals, rcond=RANK)
    rest = residuals - columns @ solution
    return float(rest @ rest), int(rank), solution / norms


def _scaled(design: Array) -> tuple[Array, Array]:
    """Return the design (n, p) with columns of length one, and the lengths (p,) that they had."""
    norms = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    return design / norms, norms


def _stands_without_any(residuals: Array, design: Array, extra: Array, level: float) -> bool:
    """Say whether a finding stands without any single rest: one bad rest among few makes any curve fit."""
    n = len(residuals)
    if n > MOST_LEFT_OUT:
        return True
    kept = ~np.eye(n, dtype=bool)
    return all(_f_test(residuals[k], design[k], extra[k])[0] <= level for k in kept)


def _correlation(t: Array, celsius: Array) -> float:
    known = np.isfinite(celsius)
    if known.sum() < 3 or np.ptp(celsius[known]) == 0.0:
        return float("nan")
    return float(np.corrcoef(t[known], celsius[known])[0, 1])
