"""The accelerometer's distance from the point the motion turns about.

Between two rests gravity is carried by the gyroscope; what the accelerometer shows beyond it is
rate x (rate x r) + d rate/dt x r, where the motion has a pivot, plus whatever else moved the phone.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.beyond import Regression, beyond_gravity, of_arm
from stillcal.calib_core.misfit.quick import SIGNIFICANT, direct_finding, vector
from stillcal.calib_core.misfit.records import Finding, Where
from stillcal.calib_core.misfit.turns import Turn
from stillcal.calib_core.misfit.views import Baseline
from stillcal.calib_core.samples import Samples

PARTS = 15


def lever_arm(
    accelerometer: Samples, baseline: Baseline, found: list[Turn], gravity: float
) -> Finding | None:
    """Find a lever arm that all turns agree on and that predicts the turns it was not fitted to."""
    lefts = [beyond_gravity(accelerometer, baseline, turn, gravity) for turn in found]
    sums = Regression.of([of_arm(turn) for turn in found], lefts)
    arm, covariance, gain = sums.jackknifed(PARTS)
    sigmas = float(np.sqrt(arm @ np.linalg.solve(covariance, arm)))
    if sigmas < SIGNIFICANT + 1.0 or gain < thresholds.LEVER_GAIN:
        return None
    error = np.sqrt(covariance.diagonal())
    axes = [a for a in range(3) if abs(arm[a]) > thresholds.AXIS_SIGMA * error[a]]
    where = Where(found[0].end - found[0].duration, found[-1].end, (0.1, 10.0), "rate of turn")
    text = ", ".join(f"{100.0 * x:.1f}" for x in arm)
    say = f"The accelerometer sits {text} cm from the point that the phone turns about."
    parameters = {"position": vector(arm, error, "m")}
    seen = sums.seen(sigmas, float(np.median(np.diff(found[0].t))))
    return direct_finding("lever_arm", "accel", axes, where, parameters, statement=say, seen=seen)
