"""The accelerometer's distance from the point the motion turns about.

Beyond gravity it shows rate x (rate x r) + d rate/dt x r, where the motion has a pivot, plus whatever else
moved the phone.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.measurement import direct_finding, vector
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.motion.block_regression import PARTS, Regression

SURE = 5.0
"""Normal deviations from nothing, a walker's steps being no pure chance."""

ALIKE = 0.4
"""Standard error, as a part of the arm, by which frequencies and directions may disagree."""


def lever_arm(sums: Regression, apart: float, where: Where) -> Finding | None:
    """Find an arm, three columns, that windows agree on and that predicts those left out.

    apart: by what part of it frequencies and directions disagree, one standard error. A leg that swings as
    its walker steps is no arm: it looks like another one at each.
    """
    arm, covariance, gain = sums.jackknifed(PARTS)
    square = float(arm @ np.linalg.solve(covariance, arm))
    sigmas = _sigmas(square, min(PARTS, len(sums.power)))
    error = np.sqrt(covariance.diagonal())
    # A covariance from few windows may be far too narrow in some direction, hardly along an axis.
    if min(sigmas, float(np.abs(arm / error).max())) < SURE or gain < thresholds.LEVER_GAIN or apart > ALIKE:
        return None
    error = np.hypot(error, apart * arm)
    axes = [a for a in range(3) if abs(arm[a]) > thresholds.AXIS_SIGMA * error[a]]
    text = ", ".join(f"{100.0 * x:.1f}" for x in arm)
    say = f"The accelerometer is {text} cm (x, y, z) away from the point about which the phone turns."
    parameters = {"position": vector(arm, error, "m")}
    seen = sums.seen(sigmas)
    return direct_finding("lever_arm", "accel", axes, where, parameters, statement=say, seen=seen)


def _sigmas(square: float, parts: int) -> float:
    """Return how sure a vector of three is with a covariance from `parts` parts, as a normal deviation.

    Hotelling's T^2 is F with 3 and parts - 3 degrees of freedom (Hotelling, Ann. Math. Statist. 2, 1931).
    """
    from scipy.special import fdtrc, ndtri  # noqa: PLC0415 - the daemon stays light

    chance = fdtrc(3.0, parts - 3.0, square * (parts - 3.0) / (3.0 * (parts - 1.0)))
    return float(-ndtri(max(chance, 1e-300) / 2.0))
