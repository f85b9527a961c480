"""Bins in which something shook the phone and turned it too: a car that creeps along lies still to no sensor.

Vibration alone is no reason to leave a bin out: what shakes may shift a bias, which is then by its power.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.segments.static_bins import Bins

LOUD = 2.0
"""Times the spread of the quietest tenth of the bins that a shaken one has."""

SHAKEN = 0.14
"""m/s^2 on three axes at which no phone lies still: twice what 400 ug/sqrt(Hz), the most that Android's
compatibility definition (7.3.1) allows, are over 100 Hz."""

FEWEST = 6
"""Quiet bins that tell where the rate lies at rest."""

TURNED = 6.0
"""Robust standard deviations of the quiet bins' rates."""


def steady(bins: Bins) -> Bins:
    """Return the bins without shaken ones whose rate is neither that of quiet bins nor follows the power.

    Where nine in ten are shaken, nothing tells a bias from a vehicle's slow turn, and they have no rate.
    """
    if bins.rate is None or bins.rate_variance is None or not len(bins):
        return bins
    floor = float(np.quantile(bins.vibration, 0.1))
    if floor > SHAKEN**2:
        return replace(bins, rate=None, rate_variance=None)
    loud = bins.vibration > LOUD**2 * floor
    if not loud.any() or (~loud).sum() < FEWEST:
        return bins
    quiet = bins.rate[~loud]
    middle = np.median(quiet, axis=0)
    scatter = 1.4826 * np.median(np.abs(quiet - middle), axis=0)
    spread = np.maximum(np.sqrt(bins.rate_variance), scatter)
    power = np.where(loud, bins.vibration, 0.0)
    shifted = np.median((bins.rate[loud] - middle) / power[loud, None], axis=0)
    away = np.abs(bins.rate - middle - power[:, None] * shifted) / spread
    return bins.chosen(~loud | (away.max(axis=1) < TURNED))
