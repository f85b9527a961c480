"""The accelerometer's distance from the point the motion turns about.

Between two rests gravity is carried by the gyroscope; what the accelerometer shows beyond it is
rate x (rate x r) + d rate/dt x r, where the motion has a pivot, plus whatever else moved the phone.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.left_out import blocks, rms
from stillcal.calib_core.misfit.quick import SIGNIFICANT, Seen, direct_finding, vector
from stillcal.calib_core.misfit.records import Finding, Where
from stillcal.calib_core.misfit.turns import LEAST_TURNS, Turn
from stillcal.calib_core.misfit.views import Baseline
from stillcal.calib_core.samples import Array, Samples

PARTS = 15
MEMORY = 0.25
"""s for which a hand's acceleration keeps its direction."""


def lever_arm(
    accelerometer: Samples, baseline: Baseline, found: list[Turn], gravity: float
) -> Finding | None:
    """Find a lever arm that all turns agree on and that predicts the turns it was not fitted to."""
    if len(found) < LEAST_TURNS:
        return None
    sums = [_sums(accelerometer, baseline, turn, gravity) for turn in found]
    information = np.array([s[0] for s in sums])
    target = np.array([s[1] for s in sums])
    power = np.array([s[2] for s in sums])
    arm, covariance, gain = _jackknifed(information, target, power)
    sigmas = float(np.sqrt(arm @ np.linalg.solve(covariance, arm)))
    if sigmas < SIGNIFICANT + 1.0 or gain < thresholds.LEVER_GAIN:
        return None
    error = np.sqrt(covariance.diagonal())
    axes = [a for a in range(3) if abs(arm[a]) > thresholds.AXIS_SIGMA * error[a]]
    where = Where(found[0].end - found[0].duration, found[-1].end, (0.1, 10.0), "rate of turn")
    text = ", ".join(f"{100.0 * x:.1f}" for x in arm)
    say = f"The accelerometer sits {text} cm from the point that the phone turns about."
    parameters = {"position": vector(arm, error, "m")}
    count = np.array([len(t.rate) for t in found], dtype=np.float64)
    memory = MEMORY / np.median(np.diff(found[0].t))
    seen = _left_out((information, target, power), count, float(memory), sigmas)
    return direct_finding("lever_arm", "accel", axes, where, parameters, statement=say, seen=seen)


def _left_out(sums: tuple[Array, Array, Array], count: Array, memory: float, sigmas: float) -> Seen:
    """Predict turns left out with the others' arm, and with none.

    Three normal residuals each `memory` samples.
    """
    information, target, power = sums
    fold, gain = blocks(len(power)), 0.0
    after = np.empty(len(power))
    for k in np.unique(fold):
        train, test = fold != k, fold == k
        arm = np.linalg.solve(information[train].sum(axis=0), target[train].sum(axis=0))
        left = power - 2.0 * target @ arm + np.einsum("a,nab,b->n", arm, information, arm)
        null, own = power[train].sum() / count[train].sum(), left[train].sum() / count[train].sum()
        independent = count[test].sum() / memory
        none, with_arm = power[test].sum() / count[test].sum(), left[test].sum() / count[test].sum()
        gain += float(1.5 * independent * (np.log(null / own) + none / null - with_arm / own))
        after[test] = left[test]
    return Seen(sigmas, gain, rms(np.sqrt(power / count)), rms(np.sqrt(np.maximum(after, 0.0) / count)))


def _sums(samples: Samples, baseline: Baseline, turn: Turn, gravity: float) -> tuple[Array, Array, float]:
    """Return the normal equations of one turn: (3, 3), (3,) and the residual's power."""
    raw = np.stack([np.interp(turn.t, samples.t, samples.xyz[:, a]) for a in range(3)], axis=1)
    force = (raw - baseline.bias) @ baseline.scale.T
    left = force - gravity * turn.gravity()
    spin = _cross_matrix(turn.rate)
    design = spin @ spin + _cross_matrix(np.gradient(turn.rate, turn.t, axis=0))
    return (
        np.einsum("nij,nik->jk", design, design),
        np.einsum("nij,ni->j", design, left),
        float((left**2).sum()),
    )


def _cross_matrix(v: Array) -> Array:
    """Return the matrices (n, 3, 3) of v x."""
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _jackknifed(information: Array, target: Array, power: Array) -> tuple[Array, Array, float]:
    """Return the arm, its covariance and the part of the power of left-out turns that it explains."""
    part = np.arange(len(power)) % PARTS
    arm = np.linalg.solve(information.sum(axis=0), target.sum(axis=0))
    others, explained = [], 0.0
    for p in range(PARTS):
        inside = part == p
        r = np.linalg.solve(information[~inside].sum(axis=0), target[~inside].sum(axis=0))
        others.append(r)
        explained += 2.0 * float(r @ target[inside].sum(axis=0)) - float(
            r @ information[inside].sum(axis=0) @ r
        )
    away = np.array(others) - np.mean(others, axis=0)
    covariance = (PARTS - 1) / PARTS * away.T @ away + 1e-12 * np.eye(3)
    return arm, covariance, explained / float(power.sum())
