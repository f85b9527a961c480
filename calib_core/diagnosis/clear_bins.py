"""The static bins that slow effects are judged on: clear of what spoils values, as sure as steps allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.axis_exchange import outside
from stillcal.calib_core.diagnosis.direct.quantisation import Steps
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.segments.leaning import without_leaning
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut
from stillcal.calib_core.diagnosis.segments.vibration_gate import shaking_of, steady
from stillcal.calib_core.diagnosis.stream import Stream
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples

CLEAR = 4.0
"""Standard deviations of the noise that a mean must be below a limit."""


def still_bins(
    accelerometer: Samples,
    gyroscope: Samples | None,
    events: Sequence[Charging] = (),
    overview: Overview | None = None,
) -> Bins:
    """Return the bins in which the phone lay still, a vehicle's turns left out; overview: as in `cut`."""
    bins = without_leaning(cut(accelerometer, gyroscope, events, overview=overview))
    return steady(bins, shaking_of(accelerometer, bins))


def outside_of(bins: Bins, found: Sequence[Finding]) -> Bins:
    """Return the bins that do not touch the time of any of the findings."""
    for f in found:
        bins = outside(bins, f.where.t_start, f.where.t_end)
    return bins


def unlimited(bins: Bins, found: Sequence[Finding], force: Stream) -> Bins:
    """Return the bins whose force is clear of a limit that was found: what is cut off shifts the mean."""
    limits = limits_of("accel_saturation", found)
    if not limits or not len(bins):
        return bins
    clear = limits[0] - CLEAR * force.steps.sd
    return bins.chosen(np.asarray((np.abs(bins.force) < clear).all(axis=1)))


def roughened(bins: Bins, seen: dict[str, Steps]) -> Bins:
    """Return bins whose means are no surer than steps that hide the noise allow, however many lie as one."""
    for sensor, values in (("accel", "force"), ("gyro", "rate")):
        mean, error = getattr(bins, values), getattr(bins, f"{values}_rounding")
        if len(bins) and mean is not None and error is not None and seen[sensor].blurs_level():
            variance = getattr(bins, f"{values}_variance") + _shared_error(mean, error, seen[sensor])
            bins = replace(bins, **{f"{values}_variance": variance})
    return bins


def _shared_error(mean: Array, error: Array, seen: Steps) -> Array:
    """Return variances (n, 3): the steps' error (3,), which bins share whose means on an axis round alike."""
    out = np.empty_like(mean)
    for axis, cells in enumerate(np.rint(mean / max(seen.largest, 1e-300)).T):
        _, which, count = np.unique(cells, return_inverse=True, return_counts=True)
        out[:, axis] = error[axis] ** 2 * count[which]
    return out


def limits_of(effect: str, found: Sequence[Finding | None]) -> list[float]:
    """Return the limits, SI, that findings of an effect state; of several axes the lowest."""
    said = [f for f in found if f is not None and f.effect == effect]
    return [float(np.min(f.parameters["limit"].value)) for f in said]
