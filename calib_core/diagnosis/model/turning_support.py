"""A support that turns about gravity, as a boat at its mooring or a turntable does.

The accelerometer does not see such a turn, and in one attitude it is an error of the gyroscope. In several it
is not: whatever the attitude, only the rate along gravity changes from rest to rest, while a bias belongs to
the body's axes.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.earth import RATE
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import Index
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.maths.rms import rms

SURE = 4.8
"""Nats that one variance more gains by chance once in 1000 (half of chi-squared of one degree of freedom)."""

MOST_RESTS = 200
"""Rests that are looked at, spread over the recording: a variance is then known to a tenth."""

COSINES = 3
"""Of a rest's course: the amplitudes of any smooth wander hardly go together."""

LARGEST = 5.0
"""Limit of the covariance's factors, in units of what is left of the means, and of the log variance."""

LOWER = np.tril_indices(3)


def turning(bins: Bins, up: Array, motion: Array) -> tuple[float, float]:
    """Return by how much the support's rate about gravity varies, rad/s: between rests, and within them.

    up: (n, 3) unit gravity in the bins; motion: (n, 3) rad/s at which the phone was seen to tilt. It is
    asked of the rests' mean rates, and of the first cosines of their courses within rests (`_sure`). The
    means have a constant, and what is linear in gravity (the Earth's vertical rate, g-sensitivity). 0 and 0
    where neither shows it.
    """
    assert bins.rate is not None and bins.rate_variance is not None, "asked for with a gyroscope only"
    rate, rests = bins.rate - motion, np.unique(bins.rest)
    of = [np.flatnonzero(bins.rest == r) for r in rests[:: -(-rests.size // MOST_RESTS)]]
    means = np.array([rate[rows].mean(axis=0) for rows in of])
    along = np.array([up[rows].mean(axis=0) for rows in of])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    white = np.array([bins.rate_variance[rows].mean(axis=0) / rows.size for rows in of])
    long = [i for i, rows in enumerate(of) if rows.size > COSINES]
    heading = 0.5 * RATE**2 * (np.eye(3) - along[:, :, None] * along[:, None, :])
    linear = np.einsum("nk,ab->nabk", along, np.eye(3)).reshape(len(of), 3, 9)
    design = np.concatenate([np.broadcast_to(np.eye(3), (len(of), 3, 3)), linear], axis=2)
    known = white[:, :, None] * np.eye(3) + heading
    between = _sure(means, along, known, design, np.arange(len(of)))
    waves = np.array([_cosines(of[i].size) @ rate[of[i]] for i in long]).reshape(-1, 3)
    which = np.repeat(np.array(long, dtype=np.int64), COSINES)
    bin_white = np.array([bins.rate_variance[of[i]].mean(axis=0) for i in which]).reshape(-1, 3)
    known = bin_white[:, :, None] * np.eye(3)
    quick = _sure(waves, along[which], known, np.zeros((len(which), 3, 0)), which)
    if between == 0.0 and quick == 0.0:
        return 0.0, 0.0
    away = np.concatenate([rate[rows] - rate[rows].mean(axis=0) for rows in of])
    about, across = _powers(away, up[np.concatenate(of)])
    within = float(np.sqrt(max(about - across, 0.0) / len(away)))
    return max(between, within), within


def _powers(rates: Array, along: Array) -> tuple[float, float]:
    """Return the sums of squares of rates (n, 3) along gravity (n, 3), and across it by component."""
    about = float((np.einsum("na,na->n", rates, along) ** 2).sum())
    return about, (float((rates**2).sum()) - about) / 2.0


def _cosines(size: int) -> Array:
    """Return the first cosines (k, size) over so many bins, each of length one."""
    turns = np.outer(1.0 + np.arange(COSINES), np.arange(size) + 0.5) / size
    return np.asarray(np.sqrt(2.0 / size) * np.cos(np.pi * turns))


def courses(bins: Bins, within: float) -> Array:
    """Return cosines (n, k), rad/s, that the support's rate about gravity may follow within rests.

    within: rad/s, by how much it varies there; any one of a rest's cosines may be all of it. The quickest has
    a period of four bins: what is quicker averages out, and is left to the white noise.
    """
    columns = [np.zeros((len(bins), 0))]
    for r in np.unique(bins.rest) if within else ():
        rows = np.flatnonzero(bins.rest == r)
        cosines = np.zeros((len(bins), rows.size // 2))
        turns = np.outer(np.arange(rows.size) + 0.5, 1.0 + np.arange(rows.size // 2)) / rows.size
        cosines[rows] = np.sqrt(2.0) * within * np.cos(np.pi * turns)
        columns.append(cosines)
    return np.hstack(columns)


def _sure(y: Array, along: Array, known: Array, design: Array, rest: Index) -> float:
    """Return the standard deviation along gravity of rates y (n, 3); 0 where it is not sure.

    along: (n, 3) unit gravity; known: (n, 3, 3) covariance of their errors; design: (n, 3, p) what is free;
    rest: (n,). It is a variance component (restricted likelihood, Patterson and Thompson 1971) beside a
    covariance in the body's axes that is as it comes. What one rest alone shows is not sure.
    """
    from scipy.optimize import minimize  # noqa: PLC0415 - the daemon stays light

    n, free = len(y), design.shape[2]
    if 3 * n <= free + LOWER[0].size + 1:
        return 0.0
    flat = design.reshape(3 * n, free)
    left = y - (design @ np.linalg.lstsq(flat, y.ravel(), rcond=None)[0] if free else 0.0)
    size, (about, across) = rms(left), _powers(left, along)
    if size == 0.0 or about < across * (1.0 + np.sqrt(3.0 / n)):  # one standard deviation of such a ratio
        return 0.0
    y, outer = y / size, along[:, :, None] * along[:, None, :]
    known = known / size**2 + 1e-9 * np.eye(3)

    def likelihoods(x: Array) -> tuple[float, Array]:
        """Return the log likelihood, and (n,) of each rest; x: (6,) the body's factor, log variance along."""
        factor = np.zeros((3, 3))
        factor[LOWER] = x[:6]
        extra = np.exp(x[6]) if x.size > 6 else 0.0
        covariance = known + factor @ factor.T + extra * outer
        weight, logs = np.linalg.inv(covariance), np.linalg.slogdet(covariance)[1]
        weighed = (weight @ design).reshape(3 * n, free)
        normal = flat.T @ weighed
        left = y - design @ np.linalg.lstsq(normal, weighed.T @ y.ravel(), rcond=None)[0] if free else y
        own = -0.5 * (logs + np.einsum("na,nab,nb->n", left, weight, left))
        return float(own.sum() - 0.5 * np.log(np.maximum(np.linalg.eigvalsh(normal), 1e-9)).sum()), own

    def highest(starts: list[Array]) -> Array:
        limits = [(-LARGEST, LARGEST)] * 6 + [(-4.0 * LARGEST, LARGEST)] * (starts[0].size - 6)
        fits = [minimize(lambda x: -likelihoods(x)[0], x, method="L-BFGS-B", bounds=limits) for x in starts]
        return np.asarray(min(fits, key=lambda fit: float(fit.fun)).x)

    body = highest([k * np.eye(3)[LOWER] for k in (0.3, 0.03)])
    both = highest([np.append(k * body, np.log(v)) for k, v in ((1.0, 0.02), (0.1, 0.4))])
    (without, each_without), (with_it, each_with) = likelihoods(body), likelihoods(both)
    most = float(np.bincount(rest, weights=each_with - each_without).max())
    sure = with_it - without - max(most, 0.0) > SURE
    return float(np.exp(both[6] / 2.0) * size) if sure else 0.0
