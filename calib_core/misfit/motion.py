"""What motion says of the time between the sensors where there are not rests enough to carry gravity between.

Gravity as the accelerometer sees it must turn as the gyroscope says it turns: d up/dt = -rate x up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.misfit.beyond import MEMORY
from stillcal.calib_core.misfit.bins import Bins
from stillcal.calib_core.misfit.delay import delay_finding
from stillcal.calib_core.misfit.left_out import blocks, rms
from stillcal.calib_core.misfit.quick import Measured, Seen
from stillcal.calib_core.misfit.records import Claims, Finding, Where
from stillcal.calib_core.samples import Array, Samples

LAGS = 41
LONGEST_LAG = 0.1
LEAST_RATE = 0.3
LEAST_STRETCHES = 5
STRETCH = 20.0
PARTS = 40


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """Gravity's turning on an even grid. t: (n,) s; up, up_dot, rate: (n, 3); use: (n,) bool."""

    t: Array
    force: Array
    up: Array
    up_dot: Array
    rate: Array
    use: Array
    step: float


def motion_findings(
    accelerometer: Samples, gyroscope: Samples, bins: Bins, claims: Claims, spoiled: Where | None = None
) -> list[Finding]:
    """Return what stretches of motion show; nothing where there are too few. spoiled: when not to look."""
    if len(gyroscope) < 200:
        return []
    motion = turning(accelerometer, gyroscope, bins, claims.gravity)
    if spoiled is not None:
        motion.use[(motion.t > spoiled.t_start) & (motion.t < spoiled.t_end)] = False
    found = time_offset(motion)
    return [] if found is None else [found]


def turning(accelerometer: Samples, gyroscope: Samples, bins: Bins, gravity: float) -> Turning:
    """Bring both sensors on one grid and smooth both alike, over three samples."""
    step = float(np.median(np.diff(accelerometer.t)))
    t = np.arange(accelerometer.t[0], accelerometer.t[-1], step)
    force, rate = (_smooth(_on(t, s)) for s in (accelerometer, gyroscope))
    rate = rate - (np.median(bins.rate, axis=0) if bins.rate is not None and len(bins) else 0.0)
    norm = np.linalg.norm(force, axis=1)
    up = force / np.maximum(norm, 1e-9)[:, None]
    quiet = np.abs(norm - gravity) < 0.15 * gravity
    fast = np.linalg.norm(rate, axis=1) > LEAST_RATE
    return Turning(t, force, up, np.gradient(up, step, axis=0), rate, quiet & fast, step)


def _on(t: Array, samples: Samples) -> Array:
    return np.stack([np.interp(t, samples.t, samples.xyz[:, a]) for a in range(3)], axis=1)


def _smooth(values: Array) -> Array:
    out = values.copy()
    out[1:-1] = (values[:-2] + 2.0 * values[1:-1] + values[2:]) / 4.0
    return out


def lag_misfits(motion: Turning) -> tuple[Array, Array, Array]:
    """Return lags (L,) s, misfits (stretches, L) and samples (stretches,).

    Misfits are sums of squares of d up/dt + rate(t + lag) x up, (rad/s)^2.
    """
    lags: Array = np.linspace(-LONGEST_LAG, LONGEST_LAG, LAGS)
    stretch = ((motion.t - motion.t[0]) / STRETCH).astype(int)
    rows = np.flatnonzero(motion.use)
    where, up, dot = stretch[rows], motion.up[rows], motion.up_dot[rows]
    misfits = []
    for lag in lags:
        rate = np.stack(
            [np.interp(motion.t[rows] + lag, motion.t, motion.rate[:, a]) for a in range(3)], axis=1
        )
        left = np.minimum(((dot + np.cross(rate, up)) ** 2).sum(axis=1), 1.0)
        misfits.append(np.bincount(where, weights=left, minlength=stretch[-1] + 1))
    count = np.bincount(where, minlength=stretch[-1] + 1)
    enough = count > 1.0 / motion.step
    kept = np.asarray(np.array(misfits, dtype=np.float64).T[enough], dtype=np.float64)
    return lags, kept, np.asarray(count[enough], dtype=np.float64)


def time_offset(motion: Turning) -> Finding | None:
    """Find the delay of the gyroscope behind the accelerometer; its error from leaving stretches out."""
    lags, misfits, count = lag_misfits(motion)
    if len(misfits) < LEAST_STRETCHES:
        return None
    delay = jackknife(lags, misfits)
    if abs(delay.value) > 0.9 * LONGEST_LAG:
        return None
    where = Where(float(motion.t[0]), float(motion.t[-1]), (0.1, 0.5 / motion.step), "rate of turn")
    seen = _left_out(lags, misfits, count, motion.step, delay.beyond(0.0, 0.0))
    return delay_finding(delay, seen, where, motion.step)


def _left_out(lags: Array, misfits: Array, count: Array, step: float, sigmas: float) -> Seen:
    """Predict stretches left out with the others' delay, and with none.

    Two normal residuals each `MEMORY` s.
    """
    fold, gain = blocks(len(misfits)), 0.0
    left = np.empty((len(misfits), 2))
    for k in np.unique(fold):
        train, test = fold != k, fold == k
        delay = _lowest(lags, misfits[train].sum(axis=0))
        both = np.array([[np.interp(x, lags, m) for x in (0.0, delay)] for m in misfits])
        null, own = both[train].sum(axis=0) / count[train].sum()
        independent = count[test].sum() * step / MEMORY
        none, shifted = both[test].sum(axis=0) / count[test].sum()
        gain += float(independent * (np.log(null / own) + none / null - shifted / own))
        left[test] = both[test] / count[test, None]
    before, after = np.sqrt(left).T
    return Seen(sigmas, gain, rms(before), rms(after))


def jackknife(lags: Array, misfits: Array) -> Measured:
    """Return the lag of least misfit with its standard error from leaving out parts of the stretches."""
    parts = np.arange(len(misfits)) % min(PARTS, len(misfits))
    best = _lowest(lags, misfits.sum(axis=0))
    left_out = np.array([_lowest(lags, misfits[parts != p].sum(axis=0)) for p in np.unique(parts)])
    n = left_out.size
    error = float(np.sqrt((n - 1) / n * ((left_out - left_out.mean()) ** 2).sum()))
    return Measured(best, max(error, 2e-4))


def _lowest(lags: Array, misfit: Array) -> float:
    """Return the minimum of a curve by a parabola through its three lowest points."""
    k = int(np.clip(np.argmin(misfit), 1, lags.size - 2))
    left, middle, right = misfit[k - 1 : k + 2]
    curvature = left - 2.0 * middle + right
    shift = 0.0 if curvature <= 0.0 else 0.5 * (left - right) / curvature
    return float(lags[k] + np.clip(shift, -1.0, 1.0) * (lags[1] - lags[0]))
