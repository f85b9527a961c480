"""The views of the gyroscope at rest: its rate is nothing but the Earth's."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit.bins import Bins
from stillcal.calib_core.misfit.views import View
from stillcal.calib_core.samples import Array

EARTH = 7.292e-5 / np.sqrt(2.0)
"""rad/s: the Earth's rate about the vertical, as large as at 45 degrees of latitude."""


def rate_views(bins: Bins, up: Array) -> list[View]:
    """Rate at rest, one view an axis; the baseline is a constant and the Earth's turn about `up` (n, 3).

    What the Earth turns about the horizontal follows heading: that scatters between rests.
    """
    if bins.rate is None or bins.rate_variance is None:
        return []
    n = len(bins)
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
            rounding=None if bins.rate_rounding is None else np.full(n, bins.rate_rounding[a]),
            absorbed=EARTH * up[:, a : a + 1],
        )
        for a in range(3)
    ]
