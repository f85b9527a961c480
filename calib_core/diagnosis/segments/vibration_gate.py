"""Bins in which something shook the phone and turned it too: a car that creeps along lies still to no sensor.

Vibration alone is no reason to leave a bin out: what shakes may shift a bias, which is then by its power. A
machine that runs at its own speed turns nothing, however loud it is: its lines do not count as shaking. Nor
does what is as strong at all frequencies in most bins, if a sensor may have as much: that is its own noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.noise_range import loudest
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.maths.welch import densities
from stillcal.calib_core.streams.samples import Samples

LOUD = 2.0
"""Times the spread of the quietest tenth of the bins that a shaken one has."""

SHAKEN = 0.14
"""m/s^2 on three axes at which no phone lies still: twice what 400 ug/sqrt(Hz), the most that Android's
compatibility definition (7.3.1) allows, are over 100 Hz."""

FEWEST = 6
"""Quiet bins that tell where the rate lies at rest."""

TURNED = 6.0
"""Robust standard deviations of the quiet bins' rates."""

SEGMENT, LEAST_SAMPLES = 5.0, 100
"""s of a spectrum, which tells apart 0.2 Hz, and samples that it has at least; where bins hold fewer, all
power counts as shaking."""

LEAST_LINE_HZ = 4.0
"""Hz below which what shakes is no machine: cars sway at one or two."""

AROUND, OWN = 25, 3
"""Frequencies of a line's neighbourhood, and those on either side that a Hann window gives it."""

LINE = 8.0
"""Times the median of its neighbourhood from which a frequency is a line, as noise that is averaged over bins
never is."""


WHITE = 0.1
"""Part of the frequencies at which what shakes is no louder than the sensor's own noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Shaking:
    """Power of what has no steady frequency, (m/s^2)^2. power: (n,) of each bin; own: the sensor's noise."""

    power: Array
    own: float = 0.0


def steady(bins: Bins, shaking: Shaking) -> Bins:
    """Return the bins without shaken ones whose rate is neither that of quiet bins nor follows the power.

    Where nine in ten are shaken, nothing tells a bias from a vehicle's slow turn, and they have no rate.
    """
    if bins.rate is None or bins.rate_variance is None or not len(bins):
        return bins
    floor = float(np.quantile(shaking.power, 0.1))
    if floor - shaking.own > SHAKEN**2:
        return replace(bins, rate=None, rate_variance=None)
    loud = shaking.power > LOUD**2 * floor
    if not loud.any() or (~loud).sum() < FEWEST:
        return bins
    quiet = bins.rate[~loud]
    middle = np.median(quiet, axis=0)
    scatter = MAD_TO_SD * np.median(np.abs(quiet - middle), axis=0)
    spread = np.maximum(np.sqrt(bins.rate_variance), scatter)
    power = np.where(loud, shaking.power, 0.0)
    shifted = np.median((bins.rate[loud] - middle) / power[loud, None], axis=0)
    away = np.abs(bins.rate - middle - power[:, None] * shifted) / spread
    return bins.chosen(~loud | (away.max(axis=1) < TURNED))


def shaking_of(accelerometer: Samples, bins: Bins) -> Shaking:
    """Return the bins' power of vibration without lines that half of them have.

    An engine that drives has another speed in every bin.
    """
    first = np.searchsorted(accelerometer.t, bins.t - bins.duration / 2.0)
    last = np.searchsorted(accelerometer.t, bins.t + bins.duration / 2.0)
    period = sample_period(accelerometer.t)
    size = round(SEGMENT / period)
    held = np.flatnonzero(last - first >= size)
    if not held.size or size < LEAST_SAMPLES:
        return Shaking(bins.vibration)
    pieces = [accelerometer.xyz[first[i] : last[i]] for i in held]
    power = densities(pieces, 1.0 / period, size).sum(axis=2)
    f = np.fft.rfftfreq(size, period)
    usual = np.median(power, axis=0)
    lines = _lines(usual) & (f > LEAST_LINE_HZ)
    broad = bins.vibration.copy()
    broad[held] *= 1.0 - power[:, lines].sum(axis=1) / np.maximum(power.sum(axis=1), 1e-300)
    own = min(float(np.quantile(usual[1:], WHITE)), 3.0 * loudest("accel", 1.0 / period) ** 2)
    return Shaking(broad, own * 0.5 / period)


def _lines(power: Array) -> NDArray[np.bool_]:
    """Return which frequencies (F,) belong to lines."""
    from scipy.ndimage import binary_dilation, median_filter  # noqa: PLC0415 - the daemon stays light

    return np.asarray(binary_dilation(power > LINE * median_filter(power, AROUND), iterations=OWN))
