"""Gravity carried from rest to rest by the gyroscope, and both sensors' affine parameters fitted to it.

The error of the gyroscope is first order: an error d(t) of the rate moves gravity, as predicted at the end of
a turn, by (R_end' sum R(t) d(t) dt) x up_end, with R(t) from the body at t to the body at the start.

Few attitudes leave the accelerometer's parameters unknown, but turns between them tell some of what the norm
of gravity does not. Norm and turns are fitted together (Gauss-Newton, robust weights), and the parameters
that the norm leaves unknown go with the turns, as errors that their covariance holds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.residuals import (
    MISALIGNMENT_SIZE,
    SCALE_SIZE,
    Baseline,
    Norms,
    fit_baseline,
    linearised,
    norms_of,
    rest_courses,
    tilted,
)
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.turns import Cut, Rates, _angle, as_read, cuts
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.maths.rotation import attitudes, matrix
from stillcal.calib_core.streams.samples import Samples

LEAST_TURNS = 9

ROUNDS = 8

SETTLED = 1e-6

GYRO_SCALE_SIZE = 0.2
"""Prior standard deviation of what is left of its scale and misalignment where errors of turns are judged."""

GYRO_PRIOR = 1.0 / np.where(np.eye(3) > 0.0, SCALE_SIZE, MISALIGNMENT_SIZE).ravel()
"""One over the prior standard deviations of its scale and misalignment in this fit, row by row."""

HALVED = 15.0
"""Every other sample of a smooth rate misses 16 times what all of them do: the rule is of fourth order."""

ROUGHER = 2.0
"""Times that error which is allowed for: a rate that is not smooth from sample to sample makes more."""

FACTORS = np.exp(np.arange(-3.0, 3.01, 0.1))

FAR, SOME = 0.25, 10
"""rad of a turn, beyond which a common factor of the rates is looked for; turns that it is taken from."""

TWICE, CHECKED = 2.0, 3
"""By how many times `FAR` gravity must move in a turn that a factor is taken from, so that no rates at all
miss it; how many such turns are needed: one may fit any factor, the others must agree."""

TRUSTED = 3.0
"""Scatters beyond which a turn's weight falls."""


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """One turn. t: (n,) s; rate: (n, 3) rad/s, corrected; carried: (n, 3, 3) R_end' R(t) dt; up, miss: (3,).

    first: of the bins, that it begins at; end, duration: s; angle: rad turned through; ends: (2, 3, 9) what
    the accelerometer's parameters do to `miss` by gravity before and after; between: (3,) rad, one standard
    deviation of what its samples may not tell of it; stretch: the part of its time that is unsure.
    """

    first: int
    end: float
    duration: float
    t: Array
    rate: Array
    carried: Array
    up: Array
    miss: Array
    ends: Array
    angle: float
    temperature: float
    between: Array
    stretch: float = 0.0

    @property
    def unsure(self) -> Array:
        """What the accelerometer's parameters do to `miss`, (3, 9)."""
        return np.asarray(self.ends.sum(axis=0))

    def columns(self, response: Array) -> Array:
        """Return what errors of the rate (n, 3, k) do to gravity's direction at the end, (3, k) rad."""
        return np.cross(np.einsum("nij,njk->ki", self.carried, response), self.up).T

    def scale_columns(self) -> Array:
        """Return what the nine numbers of scale and misalignment, row by row, do to it, (3, 9)."""
        turned = np.einsum("nij,nk->ijk", self.carried, self.rate).reshape(3, 9)
        return np.cross(turned.T, self.up).T

    def by_stamps(self) -> float:
        """Return by how much stamps that are off by 1 s, each by itself, move a component of it, rad.

        One that is late takes from the step after it what it adds to the one before.
        """
        turned = self.carried / np.maximum(np.gradient(self.t), 1e-9)[:, None, None]
        moved = np.cross(np.einsum("nij,nj->ni", turned, np.gradient(self.rate, axis=0)), self.up)
        return float(np.sqrt((moved**2).sum() / 2.0))

    def by_scale(self) -> Array:
        """Return by how much (3,) rad a scale of all rates moves it, for a unit of that."""
        return np.asarray(self.scale_columns() @ np.eye(3).ravel())

    def by_stretch(self) -> Array:
        """Return by how much (3,) rad time that is unsure as a whole moves it, one standard deviation."""
        return np.asarray(self.stretch * self.by_scale())

    def across(self) -> Array:
        """Return two unit vectors (2, 3) across gravity at the end."""
        first = np.cross(self.up, np.eye(3)[np.argmin(np.abs(self.up))])
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.up, first)])


@dataclass(frozen=True, slots=True)
class Unsteady:
    """What of a recording moves gravity at the end of its turns besides noise, one standard deviation.

    wander, scatter: m/s^2, by how much the accelerometer's bias moves about its mean slowly, and from rest to
    rest; jitter: s, of the gyroscope's time stamps.
    """

    wander: float = 0.0
    scatter: float = 0.0
    jitter: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """Both sensors' affine parameters, and the turns under them.

    baseline: of the accelerometer, as norm and turns fit it together; bias: (3,) of the rate, at rest;
    mapping: (3, 3), takes the rate as read to the true one; unsure: (9, 9), a column a standard deviation of
    the accelerometer's parameters, as the norm alone leaves them; away: (9,) how far off the norm alone has
    them; errors: (18, 18), the same as `unsure` of these and of the rate's error, row by row, as norm and
    turns leave them together; None with few turns. unsteady: what else moves gravity at the end of a turn.
    """

    turns: list[Turn]
    baseline: Baseline
    bias: Array
    mapping: Array
    unsure: Array
    away: Array
    errors: Array | None
    unsteady: Unsteady = Unsteady()

    def left_unknown(self) -> Array:
        """Return `errors`; with few turns what the norm, and a usual gyroscope's spread, leave, (18, 18)."""
        if self.errors is not None:
            return self.errors
        found = np.diag(np.concatenate([np.zeros(9), 1.0 / GYRO_PRIOR]))
        found[:9, :9] = self.unsure
        return found


def aligned(
    gyroscope: Samples, bins: Bins, gravity: float, limit: float = np.inf, rates: Rates = as_read
) -> Aligned:
    """Fit the affine parameters of both sensors to norm and turns; with few turns the norm's stand alone.

    limit: rad/s, the rate that no turn may reach. rates: takes known errors off the samples of a turn; what
    is known is off `bins` as well.
    """
    found = cuts(gyroscope, bins, limit, rates)
    norms = norms_of(bins.force, bins.force_variance, bins.rest, gravity)
    steady = rest_courses(bins.force, bins.rest)
    baseline = fit_baseline(bins.force, bins.force_variance, bins.rest, gravity)
    if len(found) < LEAST_TURNS:
        turns, mapping, errors = _carried(found, steady, baseline.parameters, np.eye(3)), np.eye(3), None
    else:
        factor = _nominal(found, steady, baseline.parameters)
        found = [replace(c, rate=factor * c.rate) for c in found]
        turns, x, mapping, errors = _fitted(found, steady, norms, baseline.parameters)
        baseline, mapping = linearised(steady, x), factor * mapping
    design, target = norms.rows(baseline.parameters)
    unsure = np.linalg.inv(np.linalg.qr(design, mode="r"))
    away = np.asarray(np.linalg.lstsq(design, target, rcond=None)[0], dtype=np.float64)
    bias = np.zeros(3) if bins.rate is None else np.median(bins.rate, axis=0)
    return Aligned(turns, baseline, bias, mapping, unsure, away, errors)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """x: (9,) the accelerometer's parameters; mapping: (3, 3); part: of what is between the samples."""

    x: Array
    mapping: Array
    part: float


def _fitted(
    found: list[Cut], steady: Array, norms: Norms, x: Array
) -> tuple[list[Turn], Array, Array, Array]:
    """Return turns, the accelerometer's parameters (9,), the mapping (3, 3) and the `errors` of both."""
    fit = _Fit(x, np.eye(3), 0.0)
    between = _between_samples(_carried(found, steady, fit.x, fit.mapping))
    for _ in range(ROUNDS):
        turns = _carried(found, steady, fit.x, fit.mapping, between, part=fit.part)
        solved = np.linalg.lstsq(*_rows(turns, norms, fit), rcond=None)[0]
        error = solved[10:].reshape(3, 3) @ fit.mapping
        fit = _Fit(fit.x + solved[1:10], fit.mapping - error, fit.part + float(solved[0]))
        if np.abs(solved[1:]).max() < SETTLED:
            break
    turns = _carried(found, steady, fit.x, fit.mapping, between, part=fit.part)
    design, _ = _rows(turns, norms, fit)
    errors = np.linalg.inv(np.linalg.qr(design, mode="r"))[1:, 1:]
    return turns, fit.x, fit.mapping, errors


def _between_samples(turns: list[Turn]) -> Array:
    """Return `Turn.between` of turns, (k, 3) rad: nearly the same part of it is missed by all of them.

    Their rates are alike.
    """
    out = []
    for turn in turns:
        rows = np.arange(turn.t.size - 1, -1, -2)[::-1]
        rows = rows if rows[0] == 0 else np.insert(rows, 0, 0)
        carried = turn.up - turn.miss
        start = matrix(attitudes(turn.t, turn.rate)[:, -1]) @ carried
        by_every_other = matrix(attitudes(turn.t[rows], turn.rate[rows])[:, -1]).T @ start
        out.append((by_every_other - carried) * (ROUGHER / HALVED))
    return np.array(out)


def _nominal(found: list[Cut], steady: Array, x: Array) -> float:
    """Return the factor of the rates about which their scale is fitted: 1 but where most turns miss by far.

    Rates of another range or unit are several times too large, and the fit is linear in small errors. Turns
    that leave gravity where it was do not tell: rates of nothing fit them best.
    """
    up, _ = tilted(steady, x)
    moved = [c for c in found if _apart(up[c.first], up[c.first + 1]) > TWICE * FAR]
    if len(moved) < CHECKED:
        return 1.0
    some = moved[:: -(-len(moved) // SOME)]

    def miss(factor: float) -> float:
        turns = _carried(some, steady, x, factor * np.eye(3))
        return float(np.median([np.linalg.norm(t.miss) for t in turns]))

    if miss(1.0) <= FAR:
        return 1.0
    best = min(FACTORS.tolist(), key=miss)
    return best if miss(best) <= FAR else 1.0


def _apart(before: Array, after: Array) -> float:
    """Return the angle between two unit vectors (3,), rad."""
    return float(np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after))


def _carried(
    found: list[Cut],
    steady: Array,
    x: Array,
    mapping: Array,
    between: Array | None = None,
    *,
    part: float = 0.0,
) -> list[Turn]:
    """Carry gravity through the turns. between: (k, 3) as `Turn` has it; part: of it, that is missed."""
    up, slope = tilted(steady, x)
    untold = np.zeros((len(found), 3)) if between is None else between
    out = []
    for cut, own in zip(found, untold, strict=True):
        i, rate, dt = cut.first, cut.rate @ mapping.T, np.gradient(cut.t)
        R = matrix(attitudes(cut.t, rate))
        carried = np.einsum("ki,nkj->nij", R[-1], R) * dt[:, None, None]
        out.append(
            Turn(
                i,
                float(cut.t[-1]),
                float(cut.t[-1] - cut.t[0]),
                cut.t,
                rate,
                carried,
                up[i + 1],
                up[i + 1] - R[-1].T @ up[i] - part * own,
                np.stack([-R[-1].T @ slope[i], slope[i + 1]]),
                _angle(cut.t, rate),
                cut.temperature,
                own,
                cut.stretch,
            )
        )
    return out


def _rows(turns: list[Turn], norms: Norms, fit: _Fit) -> tuple[Array, Array]:
    """Return weighted rows (m, 19) of norm and turns, and their target (m,), about a fit.

    The first column is the part of what is between samples, then come the accelerometer's nine parameters
    and the error of the rates, row by row. The priors are of what these become, and not of the step.
    """
    y = np.concatenate([t.across() @ t.miss for t in turns])
    accel = np.concatenate([t.across() @ t.unsure for t in turns])
    gyro = np.concatenate([t.across() @ t.scale_columns() for t in turns])
    # The gyroscope's parameters are fitted to the turns, and leave less than their noise.
    smaller = np.sqrt(1.0 - GYRO_PRIOR.size / y.size)
    spread = max(MAD_TO_SD * float(np.median(np.abs(y))) / smaller, 1e-5)
    weight = (np.minimum(1.0, TRUSTED * spread / np.maximum(np.abs(y), 1e-12)) ** 0.5 / spread)[:, None]
    rows, target = norms.rows(fit.x)
    usual = GYRO_PRIOR * (np.eye(3) - np.linalg.inv(fit.mapping)).ravel()
    free = np.diag(np.concatenate([[1.0], np.zeros(9), GYRO_PRIOR]))
    missed = np.concatenate([t.across() @ t.between for t in turns])
    design = [
        np.pad(rows, ((0, 0), (1, 9))),
        np.hstack([missed[:, None], -accel, gyro]) * weight,
        free[[0, *range(10, 19)]],
    ]
    return np.vstack(design), np.concatenate([target, y * weight[:, 0], [-fit.part], usual])
