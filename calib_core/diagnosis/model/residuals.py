"""The baseline phone and the residuals that must vanish under it: norm and tangent of gravity.

A view holds residuals of the still bins with the baseline's columns that are to be projected out. What an
effect would do in each view is the catalogue's business; how noise looks is `shapes`'.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.records import AXES
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import Index
from stillcal.calib_core.diagnosis.segments.static_bins import Bins

BIAS_SIZE, SCALE_SIZE, MISALIGNMENT_SIZE = 0.5, 0.05, 0.03
WITHIN_BINS = 60.0
"""How well the white noise within bins tells that between them: to about a fifth in variance."""

CREEP_BINS, COURSE_BINS = 10, 6
CREEP_TAUS = (1 / 20, 1 / 6, 1 / 2)
"""Parts of a rest in which its support gives way exponentially: any exponential is nearly a sum of these."""

STEPS = 20
HALVINGS = 8
SETTLED = 1e-6
PRIOR = np.diag(1.0 / np.repeat([BIAS_SIZE, SCALE_SIZE, MISALIGNMENT_SIZE], 3))
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Residuals of one kind, n bins in each of b blocks that share a covariance.

    y: (b, n) residual; baseline: (b, n, p) columns projected out of each block; variance: (n,) white;
    coupling: (n, n) how the bias of two bins is shared; project: (b, n, 3) what an error vector of the sensor
    in a bin does to the residual; bins: (n,) indices into the recording's bins; rest: (n,); shared: noise
    that bins share, (n, m) each, what an error does, a column at one standard deviation; absorbed: (n, q)
    what parameters of the baseline do at one standard deviation of what is known of them, None for none;
    known: degrees of freedom with which `variance` is known; moving: (n,) 1 for bins in which the device
    moves, 0 at rest, None where nothing is judged in motion; excess: variance that moving bins have besides;
    memo: what was computed from this view and is asked for again.
    """

    name: str
    y: Array
    baseline: Array
    variance: Array
    coupling: Array
    project: Array
    bins: Index
    t: Array
    duration: Array
    rest: Index
    shared: tuple[Array, ...] = ()
    absorbed: Array | None = None
    known: float = WITHIN_BINS
    moving: Array | None = None
    excess: float = 0.0
    memo: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    @property
    def parameters(self) -> int:
        """Number of baseline parameters projected out, over all blocks."""
        return int(self.baseline.shape[0] * self.baseline.shape[2])

    def free(self) -> float:
        """Return how many of the residuals are left by what the baseline phone may do.

        A parameter of which something is known takes one as far as it is told here and not beforehand.
        """
        left = self.y.size - self.parameters
        if self.absorbed is None:
            return float(left)
        told = np.linalg.svd(self.absorbed / np.sqrt(self.variance)[:, None], compute_uv=False) ** 2
        return float(left - (told / (1.0 + told)).sum())

    def nuisance(self, block: int = 0) -> Array:
        """Return all that the baseline phone may do in a block, (n, p + q)."""
        own = self.baseline[block]
        return own if self.absorbed is None else np.hstack([own, self.absorbed])

    def left(self, *explained: Array) -> Array:
        """Return the first block's residual (n,), what `nuisance` and `explained` (n, k) may do taken off."""
        return self.without(self.y[0], *explained)

    def without(self, values: Array, *explained: Array) -> Array:
        """Return values (n,) or (n, m), taken off what `nuisance` of block 0 and `explained` may do."""
        columns = np.hstack([self.nuisance(), *explained])
        return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0])


def of_groups(group: Index, size: Array) -> Array:
    """Return the columns (n, m) of errors, one for every group (n,). size: (n,) its sd in each bin."""
    return np.where(group[:, None] == np.unique(group), size[:, None], 0.0)


def axis_view(name: str, axis: int, bins: Bins, y: Array, variance: Array, **other: Any) -> View:
    """Return a view of one axis of a sensor, whose baseline is a constant that all bins share.

    y, variance: (n, 3) residuals and white variance of all axes in the bins. other: further fields.
    """
    n = len(bins)
    return View(
        name=f"{name}_{AXES[axis]}",
        y=y[None, :, axis],
        baseline=np.ones((1, n, 1)),
        variance=variance[:, axis],
        coupling=np.ones((n, n)),
        project=np.broadcast_to(np.eye(3)[axis], (1, n, 3)),
        bins=np.arange(n),
        t=bins.t,
        duration=bins.duration,
        rest=bins.rest,
        **other,
    )


def attitudes(up: Array, angle: float = 0.2) -> Index:
    """Return which attitude each of `up` (n, 3) is nearest to, of those met that are `angle` (rad) apart."""
    met: list[Array] = []
    for u in up:
        if all(u @ m < np.cos(angle) for m in met):
            met.append(u)
    return np.asarray(np.argmax(up @ np.array(met).reshape(-1, 3).T, axis=1) if met else [], dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """Affine accelerometer fitted to gravity's norm. scale (3, 3), bias (3,), up: (n, 3), norm: (n,)."""

    scale: Array
    bias: Array
    up: Array
    norm: Array
    jacobian: Array

    @property
    def parameters(self) -> Array:
        """The nine parameters: bias, and the scale's excess over one and misalignment."""
        return np.array([*self.bias, *(self.scale[a, b] - (a == b) for a, b in PAIRS)])


@dataclass(frozen=True, slots=True, eq=False)
class Norms:
    """What the norm of gravity says of the nine parameters. force: (n, 3); weight: (n,) 1 / (m/s^2)."""

    force: Array
    weight: Array
    gravity: float

    def rows(self, x: Array) -> tuple[Array, Array]:
        """Return weighted rows (n + 9, 9) and their target (n + 9,) about parameters x (9,), priors below.

        What misses gravity by more than the bins' noise has that much less weight: far from a solution, and
        where bias wanders from rest to rest, the priors must not be nothing beside it.
        """
        fit = linearised(self.force, x)
        weight, away = self._weighed(fit)
        excess = np.sqrt(self._excess(away))
        design = np.vstack([_at_length(fit, self.gravity) * (weight / excess)[:, None], PRIOR])
        return design, np.concatenate([away / excess, -PRIOR @ x])

    def cost(self, x: Array) -> float:
        """Return twice the negative log of the parameters' posterior, whose least the rows lead to."""
        _, away = self._weighed(linearised(self.force, x))
        freedom, excess = max(away.size - x.size, 1), self._excess(away)
        prior = PRIOR @ x
        return float(freedom * np.log(excess) + away @ away / excess + prior @ prior)

    def _weighed(self, fit: Baseline) -> tuple[Array, Array]:
        """Return the weight (n,) of corrected norms and by how much they miss gravity, weighed (n,).

        The noise is of what was read: a scale below one makes it smaller in the corrected norm, and beside a
        bias that makes up for it would else pass for a better fit.
        """
        weight = self.weight / np.linalg.norm(fit.up @ fit.scale, axis=1)
        return weight, (self.gravity - fit.norm) * weight

    def _excess(self, away: Array) -> float:
        """Return how much more than the bins' noise the misses vary, at least one."""
        return max(float(away @ away) / float(max(away.size - PRIOR.shape[0], 1)), 1.0)


def norms_of(force: Array, variance: Array, rest: Index, gravity: float) -> Norms:
    """Weigh the bins of force (n, 3): a rest counts once, as uncertain as its bins wander."""
    return Norms(force, _rest_weights(np.linalg.norm(force, axis=1), variance.mean(axis=1), rest), gravity)


def fit_baseline(force: Array, variance: Array, rest: Index, gravity: float) -> Baseline:
    """Fit the nine parameters of |S (m - b)| = g by damped Gauss-Newton with priors of physical size.

    force, variance: (n, 3); rest: (n,). Norm of gravity alone leaves a common rotation free, so S is
    symmetric. Directions and columns are those of the rest's mean: a bin's own noise in the columns would
    be regressed on itself. In long rests they follow what creeps.
    """
    norms, x = norms_of(force, variance, rest, gravity), np.zeros(9)
    cost = norms.cost(x)
    for _ in range(STEPS):
        step = np.asarray(np.linalg.lstsq(*norms.rows(x), rcond=None)[0])
        x, before = _shortened(norms, x, step, cost), cost
        cost = norms.cost(x)
        if before - cost < SETTLED:
            break
    steady = linearised(rest_courses(force, rest), x)
    return replace(steady, norm=linearised(force, x).norm, jacobian=_at_length(steady, gravity))


def _at_length(fit: Baseline, gravity: float) -> Array:
    """Return a fit's columns (n, 9) at gravity's own length.

    Columns of scale would else hold what is left of the norm, and explain it.
    """
    length = np.where(np.arange(fit.jacobian.shape[1]) < 3, 1.0, gravity / fit.norm[:, None])
    return np.asarray(fit.jacobian * length)


def _shortened(norms: Norms, x: Array, step: Array, cost: float) -> Array:
    """Return x after as much of a step as lowers the cost; x itself where no part does."""
    for share in 0.5 ** np.arange(HALVINGS):
        if norms.cost(x + share * step) < cost:
            return np.asarray(x + share * step)
    return x


def _rest_weights(norm: Array, variance: Array, rest: Index) -> Array:
    """Weights (n,) of bins: white noise averages out in a rest; wander, the scatter of its bins, does not."""
    count = np.bincount(rest)[rest].astype(np.float64)
    away = norm - rest_means(norm[:, None], rest)[:, 0]
    freedom = max(norm.size - np.unique(rest).size, 1)
    wander = max(float(away @ away) / freedom - float(variance.mean()), 0.0)
    return np.asarray(1.0 / np.sqrt(variance + count * wander))


def rest_means(values: Array, rest: Index) -> Array:
    """Replace each bin's values (n, k) by the mean over its rest."""
    count = np.maximum(np.bincount(rest), 1)
    means = np.stack([np.bincount(rest, weights=c) / count for c in values.T], axis=1)
    return np.asarray(means[rest])


def affine(force: Array, x: Array) -> tuple[Array, Array, Array]:
    """Return S, S (m - b) (n, 3) and its derivative (n, 3, 9) by the nine parameters x (9,)."""
    scale = np.eye(3)
    for value, (a, b) in zip(x[3:], PAIRS, strict=True):
        scale[a, b] += value
        scale[b, a] = scale[a, b]
    centred = force - x[:3]
    moved = np.zeros((len(force), 3, 9))
    moved[:, :, :3] = -scale
    for k, (a, b) in enumerate(PAIRS, start=3):
        moved[:, a, k] = centred[:, b]
        moved[:, b, k] = centred[:, a]
    return scale, centred @ scale.T, moved


def linearised(force: Array, x: Array) -> Baseline:
    """Return the baseline with parameters x (9,): bias, and the scale's excess over one with misalignment."""
    scale, corrected, moved = affine(force, x)
    norm = np.linalg.norm(corrected, axis=1)
    up = corrected / norm[:, None]
    return Baseline(scale, x[:3], up, norm, np.einsum("na,nap->np", up, moved))


def rest_courses(values: Array, rest: Index) -> Array:
    """Replace each bin's values (n, k) by its rest's mean, in long rests with a ramp and settling."""
    out = rest_means(values, rest)
    for r in np.flatnonzero(np.bincount(rest) >= COURSE_BINS):
        rows = np.flatnonzero(rest == r)
        age = np.arange(rows.size, dtype=np.float64)
        design = np.column_stack([np.ones(rows.size), age, np.log1p(age / 2.0)])
        out[rows] = design @ np.linalg.lstsq(design, values[rows], rcond=None)[0]
    return out


def tilted(force: Array, x: Array) -> tuple[Array, Array]:
    """Return gravity's direction (n, 3) and its derivative (n, 3, 9) by the nine parameters."""
    _, corrected, moved = affine(force, x)
    norm = np.linalg.norm(corrected, axis=1)
    up = corrected / norm[:, None]
    along = np.einsum("na,nap->np", up, moved)
    return up, (moved - up[:, :, None] * along[:, None, :]) / norm[:, None, None]


def norm_view(bins: Bins, baseline: Baseline, gravity: float) -> View:
    """Residual of gravity's norm: blind to any tilt of the phone.

    A common scale is the baseline, being also gravity's. Bias, scale and misalignment may be as large as
    those of phones and no larger: what changes by more is no matter of attitude, however few there are.
    The residual is that of a faultless phone, linear about the fitted one.
    """
    variance = np.einsum("na,na->n", baseline.up**2, bins.force_variance)
    coarse = bins.force_rounding
    return View(
        name="norm",
        y=(baseline.norm - gravity - baseline.jacobian @ baseline.parameters)[None],
        baseline=np.ones((1, len(bins), 1)),
        absorbed=baseline.jacobian @ np.linalg.inv(PRIOR),
        variance=variance,
        coupling=baseline.up @ baseline.up.T,
        project=(baseline.up @ baseline.scale)[None],
        bins=np.arange(len(bins)),
        t=bins.t,
        duration=bins.duration,
        rest=bins.rest,
        shared=() if coarse is None else (of_groups(bins.rest, np.sqrt(baseline.up**2 @ coarse**2)),),
    )


def tangent_view(bins: Bins, baseline: Baseline) -> View | None:
    """Change of the two components across gravity inside long rests, creep of the support removed.

    A rest is here what the gyroscope saw no turn in. None where none has `CREEP_BINS` bins.
    """
    pose = bins.rest if bins.pose is None else bins.pose
    counts = np.bincount(pose, minlength=1)
    keep = np.flatnonzero(counts[pose] >= CREEP_BINS)
    if keep.size == 0:
        return None
    rest, t = pose[keep], bins.t[keep]
    across = _across(baseline.up[keep], rest)
    creep = _creep(t, rest)
    return View(
        name="tangent",
        y=np.einsum("bna,na->bn", across, bins.force[keep] - bins.force[keep].mean(axis=0)),
        baseline=np.stack([creep, creep]),
        variance=bins.force_variance[keep].mean(axis=1),
        coupling=(rest[:, None] == rest[None, :]).astype(np.float64),
        project=across,
        bins=keep,
        t=t,
        duration=bins.duration[keep],
        rest=rest,
    )


def _across(up: Array, rest: Index) -> Array:
    """Two unit vectors (2, n, 3) across the mean gravity of each rest, as near to body axes as can be."""
    across = np.empty((2, len(up), 3))
    for r in np.unique(rest):
        rows = rest == r
        mean = up[rows].mean(axis=0)
        first = np.eye(3)[np.argmin(np.abs(mean))]
        first = first - (first @ mean) * mean / (mean @ mean)
        first /= np.linalg.norm(first)
        across[0, rows], across[1, rows] = first, np.cross(mean, first) / np.linalg.norm(mean)
    return across


def _creep(t: Array, rest: Index) -> Array:
    """Offset, ramp and exponential relaxations of every rest: (n, 5 rests)."""
    columns = []
    for r in np.unique(rest):
        inside = rest == r
        age = np.where(inside, t - t[inside][0], 0.0)
        part = age / max(float(age.max()), 1e-9)
        columns += [inside.astype(np.float64), part, *(inside * np.exp(-part / tau) for tau in CREEP_TAUS)]
    return np.column_stack(columns)
