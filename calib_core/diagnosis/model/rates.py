"""The gyroscope at rest: its rate is the Earth's, and that of a support which gives way.

What gravity's direction confirms is motion and no bias: the accelerometer sees how the phone tilts within a
rest.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.earth import RATE, Ground
from stillcal.calib_core.diagnosis.model.residuals import View, attitudes, axis_view, of_groups
from stillcal.calib_core.diagnosis.model.turning_support import courses, turning
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.maths.rms import rms

OF_ATTITUDE = 0.25
"""Part of the Earth's rate that may be linear in `up`, element by element, standard deviation: where a phone
whose heading is not known is turned about one line only, heading is a matter of attitude."""

ADDED = 0.1
"""Part of the gyroscope's own variance that the accelerometer's noise may add to a rate of tilt."""


SHAPE_ERROR = 0.3
"""Part of a rate of tilt by which a parabola through bins misses it, standard deviation: at an exponential as
short as a bin it is a tenth at the first bin, more where the phone still settles in hand."""

TWIST = 1.0
"""How much a support that tilts a phone turns it about gravity besides, as a part of the tilt, standard
deviation: a phone on a cushion slides and turns as freely as it tilts. The same in all bins of a rest."""


def tilt_rate(bins: Bins, up: Array) -> Array:
    """Return the rate (n, 3) rad/s at which the phone tilts within its rests, as gravity shows it.

    up: (n, 3) unit gravity, bin by bin. The rate across gravity is d(up)/dt x up; the turn about gravity is
    not seen. The slope is that of a parabola through as many neighbouring bins of a rest as keep its noise
    below `ADDED` of the gyroscope's, or of a line through two; rests with fewer bins give none, 0. Motion
    itself is taken for noise there, and many bins smooth a swing away: fewer, 3 at least, are taken where the
    gyroscope's rate varies less about what they show. Noise alone never makes it vary less.
    """
    rate = np.zeros_like(up)
    assert bins.rate is not None and bins.rate_variance is not None, "asked for with a gyroscope only"
    noise = float(np.median(bins.force_variance)) / float(np.median(np.linalg.norm(bins.force, axis=1))) ** 2
    allowed = ADDED * float(np.median(bins.rate_variance))
    spacing = float(np.median(bins.duration))
    # A slope through m values of variance v, d apart, has the variance 12 v / (m^3 d^2).
    width = int(np.ceil(np.cbrt(12.0 * noise / (max(allowed, 1e-300) * spacing**2))))
    least, odd = max(2, width), max(3, width + 1 - width % 2)
    for r in np.flatnonzero(np.bincount(bins.rest) >= min(least, 3)):
        rows = np.flatnonzero(bins.rest == r)
        usual = min(odd, rows.size) if rows.size >= least else 0
        fewer = range(3, usual or rows.size + 1, 2)
        tilts = [_tilt(bins.t[rows], up[rows], n) for n in (usual, *fewer)]
        left = [float((bins.rate[rows] - tilt).var(axis=0).sum()) for tilt in tilts]
        rate[rows] = tilts[int(np.argmin(left))]
    return rate


def _tilt(t: Array, up: Array, through: int) -> Array:
    """Return the rate (n, 3) rad/s of tilt of up (n, 3) in one rest; none, 0, through no bins."""
    return np.cross(_slope(t, up, through), up) if through else np.zeros_like(up)


def _slope(t: Array, values: Array, width: int) -> Array:
    """Return the slope (n, k) of values (n, k) at t (n,): of a parabola, or line, through `width` bins."""
    out = np.empty_like(values)
    for i in range(t.size):
        first = int(np.clip(i - width // 2, 0, t.size - width))
        near = slice(first, first + width)
        powers = np.vander(t[near] - t[i], min(width, 3), increasing=True)
        out[i] = np.linalg.lstsq(powers, values[near], rcond=None)[0][1]
    return out


def rate_views(bins: Bins, up: Array, motion: Array, over: Ground) -> list[View]:
    """Rate at rest, one view an axis; the baseline is a constant. up: (n, 3) unit gravity in the bins.

    motion: (n, 3) rad/s, at which the phone was seen to tilt: as much of it as the rate shows is absorbed. A
    rest too short to see it tilts as the others do.

    The Earth's rate is shared by the axes (`earth_rate`), as far as headings are known (`over`). What is not,
    all bins of a rest share, and half of it all rests in one attitude, for a phone often lies again as it lay
    before. A turn of the support about gravity that the rests show (`turning_support`) is no bias.
    """
    if bins.rate is None or bins.rate_variance is None:
        return []
    rounding = np.zeros(3) if bins.rate_rounding is None else bins.rate_rounding
    lost = 1.0 - over.trust**2
    heading, place = 0.25 * RATE**2 * (1.0 - up**2) * lost[:, None], attitudes(up)
    tilting = np.linalg.norm(motion, axis=1)
    seen = tilting > 0.0
    unseen = np.where(seen, 0.0, rms(tilting[seen]))
    between, within = turning(bins, up, motion)
    course = courses(bins, within)
    linear = OF_ATTITUDE * RATE * up * np.sqrt(lost)[:, None]
    variance = bins.rate_variance + (SHAPE_ERROR * motion) ** 2 + (within * up) ** 2
    return [
        axis_view(
            "rate",
            a,
            bins,
            bins.rate,
            variance,
            shared=(
                of_groups(bins.rest, np.sqrt(rounding[a] ** 2 + heading[:, a])),
                of_groups(place, np.sqrt(heading[:, a])),
                of_groups(bins.rest, TWIST * tilting * np.abs(up[:, a])),
                of_groups(bins.rest, unseen),
                of_groups(bins.rest, between * np.abs(up[:, a])),
            ),
            absorbed=np.column_stack(
                [np.delete(linear, a, axis=1), motion[:, a], course * np.abs(up[:, a, None])]
            ),
        )
        for a in range(3)
    ]
