"""What single samples say of their order, place and code, and what an effect there does to other findings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.line import is_line, middle_hz, reach_hz
from stillcal.calib_core.diagnosis.noise.lines.steady_period import DRIVER as PERIOD
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.sequence.codes import DRIVER as OWN_CODE
from stillcal.calib_core.diagnosis.sequence.codes import by_code
from stillcal.calib_core.diagnosis.sequence.dropouts import dropouts
from stillcal.calib_core.diagnosis.sequence.lone_values import lone_values
from stillcal.calib_core.diagnosis.sequence.order import wrong_order
from stillcal.calib_core.diagnosis.sequence.places import DRIVER as COUNT
from stillcal.calib_core.diagnosis.sequence.places import Noise, by_count
from stillcal.calib_core.diagnosis.sequence.recurrence import STALE, delivered_again, stale_axes
from stillcal.calib_core.streams.samples import Samples

SPOILED = ("noise_heavy_tailed", "noise_level", "noise_unequal_axes")
"""Names that samples in a wrong place or with a wrong code may look like; so may a line in the spectrum."""

NAMED_CODES = "missing_codes"
"""The name of what an axis leaves out or keeps by its own code."""

AT_OVERTONE_HZ = 0.05
"""Difference from a batch's overtone that is none: what a stretch of 20 s tells apart."""

LEAST_SAMPLES = 200


def sequence_findings(
    samples: Samples, calm: Samples, sensor: str, bins: Bins, vibrations: Sequence[float] = ()
) -> list[Finding]:
    """Return what one sensor's samples show that has no name.

    calm: the same without single outliers (`neighbours.without_outliers`); bins: the still ones; vibrations:
    those that were found, frequencies a sample.
    """
    if len(samples) < LEAST_SAMPLES:
        return []
    still = still_rows(samples.t, bins)
    noise = Noise.of(calm.xyz, still, vibrations)
    drops, dropped = dropouts(samples, sensor)
    found = [
        drops,
        delivered_again(samples, sensor, still),
        wrong_order(samples, sensor),
        stale_axes(samples, sensor, dropped),
        by_code(samples, sensor, noise),
        None if noise is None else by_count(samples, sensor, noise),
    ]
    shown = [f for f in found if f is not None]
    lone = None if shown else lone_values(samples, sensor, still)
    return shown if lone is None else [lone]


def still_rows(t: Array, bins: Bins) -> NDArray[np.bool_]:
    """Return which samples, at t (n,) s, lie in still bins."""
    edges = np.zeros(t.size + 1, dtype=np.int64)
    np.add.at(edges, np.searchsorted(t, bins.t - bins.duration / 2), 1)
    np.add.at(edges, np.searchsorted(t, bins.t + bins.duration / 2), -1)
    return np.asarray(np.cumsum(edges)[:-1] > 0)


def beside_names(nameless: Sequence[Finding], named: Sequence[Finding]) -> list[Finding]:
    """Return both, without names that a nameless effect of the same sensor's samples looks like.

    What depends on an axis' own code, or keeps a value, has a name where values are missing. A batch
    of samples has lines at its overtones alone.
    """
    coded = {f.sensor for f in named if f.effect == NAMED_CODES}
    own = [f for f in nameless if f.where.driver not in (OWN_CODE, STALE) or f.sensor not in coded]
    spoiled = [f for f in named if any(_looks_like(f, one) for one in own if one.sensor == f.sensor)]
    return [*own, *(f for f in named if not any(f is other for other in spoiled))]


def _looks_like(named: Finding, nameless: Finding) -> bool:
    """Whether a finding may be no more than how a nameless effect of its sensor's samples looks."""
    periodic = named.where.driver == PERIOD
    if not is_line(named) and not periodic:
        return named.effect in SPOILED
    if nameless.where.driver != COUNT:
        return not periodic
    samples = float(np.asarray(nameless.parameters["period_samples"].value))
    if not samples.is_integer():  # a beat, which gives vibrations sidebands
        return not periodic
    batches = 2.0 * nameless.where.band_hz[1] / samples
    overtone = batches * round(middle_hz(named) / batches)
    return abs(middle_hz(named) - overtone) < AT_OVERTONE_HZ + reach_hz(named)
