"""The accelerometer's distance from the point the motion turns about.

Beyond gravity it shows rate x (rate x r) + d rate/dt x r, where the motion has a pivot, plus whatever else
moved the phone.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, of_vector, vector
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.motion.block_regression import STRETCHES, Regression

SIZES = (0.1, 0.03, 0.01)
"""m: prior standard deviations of an arm on each axis: of what holds a phone, half of it, a chip's place."""

LEAST_ARM = 1.5e-3
"""m, per axis: half of the usual package (3 mm), in which the two sensors are anywhere."""

ALIKE = 0.4
"""Standard error, as a part of the arm, by which frequencies and directions may disagree."""


def lever_arm(sums: Regression, apart: float, where: Where) -> Finding | None:
    """Find an arm, three columns, that windows agree on and that predicts those left out.

    apart: by what part of it frequencies and directions disagree, one standard error. A leg that swings as
    its walker steps is no arm: it looks like another one at each. Windows of one walk are no trials of their
    own: they are left out in stretches of the recording.
    """
    arm, covariance, gain = sums.jackknifed(STRETCHES, in_a_row=True)
    if gain < thresholds.LEVER_GAIN or apart > ALIKE:
        return None
    # A covariance from few windows may be far too narrow in some direction, hardly along an axis.
    within = np.diag(covariance.diagonal() * _widened(min(STRETCHES, len(sums.power))) + LEAST_ARM**2)
    error = np.hypot(np.sqrt(within.diagonal()), apart * arm)
    axes = [a for a in range(3) if abs(arm[a]) > thresholds.AXIS_SIGMA * error[a]]
    text = ", ".join(f"{100.0 * x:.1f}" for x in arm)
    say = f"The accelerometer is {text} cm (x, y, z) away from the point about which the phone turns."
    parameters = {"position": vector(arm, error, "m")}
    nats = [of_vector(arm, within, size) - np.log(len(SIZES)) for size in SIZES]
    seen = DirectEvidence(float(np.logaddexp.reduce(nats)), sums.held_out())
    return direct_finding("lever_arm", "accel", axes, where, parameters, statement=say, seen=seen)


def _widened(parts: int) -> float:
    """Return the factor on a variance from `parts` parts for a normal to have the variance of Student's t."""
    return (parts - 1.0) / (parts - 3.0)
