"""What single samples say of their order, place and code, and what an effect there does to other findings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.line import is_line
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.sequence.codes import DRIVER as OWN_CODE
from stillcal.calib_core.diagnosis.sequence.codes import by_code
from stillcal.calib_core.diagnosis.sequence.dropouts import dropouts
from stillcal.calib_core.diagnosis.sequence.lone_values import lone_values
from stillcal.calib_core.diagnosis.sequence.order import wrong_order
from stillcal.calib_core.diagnosis.sequence.places import Noise, by_count
from stillcal.calib_core.diagnosis.sequence.recurrence import STALE, delivered_again, stale_axes
from stillcal.calib_core.streams.samples import Samples

SPOILED = ("noise_heavy_tailed", "noise_level", "noise_unequal_axes")
"""Names that samples in a wrong place or with a wrong code may look like; so may a line in the spectrum."""

NAMED_CODES = "missing_codes"
"""The name of what an axis leaves out or keeps by its own code."""

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

    What depends on an axis' own code, or keeps a value, has a name where values are missing.
    """
    coded = {f.sensor for f in named if f.effect == NAMED_CODES}
    own = [f for f in nameless if f.where.driver not in (OWN_CODE, STALE) or f.sensor not in coded]
    sensors = {f.sensor for f in own}
    spoiled = [f for f in named if f.sensor in sensors and (f.effect in SPOILED or is_line(f))]
    return [*own, *(f for f in named if not any(f is other for other in spoiled))]
