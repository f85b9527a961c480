"""The gyroscope at rest: its rate is nothing but the Earth's."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.residuals import View, attitudes
from stillcal.calib_core.diagnosis.segments.static_bins import Bins

EARTH = 7.292e-5
"""rad/s (WGS 84)."""

OF_ATTITUDE = 0.25
"""Part of the Earth's rate that may be linear in `up`, element by element, standard deviation."""


def rate_views(bins: Bins, up: Array) -> list[View]:
    """Rate at rest, one view an axis; the baseline is a constant and the Earth's turn about `up` (n, 3).

    The latitude is not known: what the Earth turns about `up` is as large as at 45 degrees, what it turns
    about the horizontal as at the equator. That follows heading, which all bins of a rest share, and half of
    it all rests in one attitude, for a phone often lies again as it lay before. Turned about one line only,
    heading is a matter of attitude, and the rate is linear in `up`, as a g-sensitivity's is.
    """
    if bins.rate is None or bins.rate_variance is None:
        return []
    n = len(bins)
    rounding = np.zeros(3) if bins.rate_rounding is None else bins.rate_rounding
    heading, place = 0.25 * EARTH**2 * (1.0 - up**2), attitudes(up)
    linear = OF_ATTITUDE + (1.0 / np.sqrt(2.0) - OF_ATTITUDE) * np.eye(3)
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
            shared=(
                (bins.rest, np.sqrt(rounding[a] ** 2 + heading[:, a])),
                (place, np.sqrt(heading[:, a])),
            ),
            absorbed=EARTH * up * linear[a],
        )
        for a in range(3)
    ]
