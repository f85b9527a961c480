"""The gyroscope at rest: its rate is nothing but the Earth's."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit.bins import Bins
from stillcal.calib_core.misfit.views import View
from stillcal.calib_core.samples import Array

EARTH = 7.292e-5
"""rad/s (WGS 84)."""


def rate_views(bins: Bins, up: Array) -> list[View]:
    """Rate at rest, one view an axis; the baseline is a constant and the Earth's turn about `up` (n, 3).

    The latitude is not known: both parts are as large as at 45 degrees. What the Earth turns about the
    horizontal follows heading, which all bins of a rest share and the next rest does not.
    """
    if bins.rate is None or bins.rate_variance is None:
        return []
    n = len(bins)
    rounding = np.zeros(3) if bins.rate_rounding is None else bins.rate_rounding
    heading = 0.25 * EARTH**2 * (1.0 - up**2)
    return [
        View(
            name=f"rate_{'xyz'[a]}",
            y=bins.rate[None, :, a],
            baseline=np.ones((1, n, 1)),
            variance=bins.rate_variance[:, a],
            coupling=np.ones((n, n)),
            project=np.broadcast_to(np.eye(3)[a], (1, n, 3)),
            bins=np.arange(n),
            t=bins.t,
            duration=bins.duration,
            rest=bins.rest,
            rounding=np.sqrt(rounding[a] ** 2 + heading[:, a]),
            absorbed=EARTH / np.sqrt(2.0) * up[:, a : a + 1],
        )
        for a in range(3)
    ]
