"""Stamps as a clock that goes evenly for seconds would have made them, whatever they are rounded to."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from stillcal.calib_core.arrays import Array, frozen, once_per_array
from stillcal.calib_core.diagnosis.model.measurement import Index
from stillcal.calib_core.diagnosis.segments.bursts import PAUSE_S, bursts
from stillcal.calib_core.diagnosis.segments.sample_period import bunched, sample_period
from stillcal.calib_core.diagnosis.stamps.timestamps import LONGEST_GAP, Grid

EVEN, OF_BURSTS = 5.0, 30.0
"""s over which stamps are evened, and those of bursts, of which each comes some 10 ms too late or early."""

PART, STALLED = 0.5, 5.0
"""s of which a median tells how late stamps are; usual deviations from it beyond which they have waited."""


class Even(NamedTuple):
    """Samples in their places (n,), of which the next is `period` s away; t: (n,) s, the evened stamps."""

    period: float
    place: Index
    t: Array


@once_per_array
def evened(t: Array) -> Even:
    """Even stamps t (n,), s: samples that were lost leave their places empty."""
    in_bursts = bunched(t)
    if in_bursts:
        place, _, period = bursts(t)
    else:
        usual = sample_period(t)
        place = np.concatenate([[0], np.cumsum(1 + Grid.of(t, usual).lost().astype(np.int64))])
        period = _own_period(t, place, usual)
    return Even(period, place, frozen(_evened(t, place, period, in_bursts=in_bursts)))


def _own_period(t: Array, place: Index, period: float) -> float:
    """Return how far apart places (n,) are by stamps t (n,), s: the usual period over times without a pause.

    period: s, the usual interval. Of stamps that scatter it is a little off, and so were all frequencies.
    """
    count = max(min(round(EVEN / period), t.size // 4), 1)
    pauses = np.concatenate([[0], np.cumsum(np.diff(t) > LONGEST_GAP * period)])
    first = np.arange(0, t.size - count, max(count // 8, 1))
    first = first[pauses[first + count] == pauses[first]]
    periods = np.sort((t[first + count] - t[first]) / (place[first + count] - place[first]))
    middle = periods[periods.size // 4 : -(periods.size // 4) or None]
    return float(middle.mean()) if middle.size else period


def _evened(t: Array, place: Index, period: float, *, in_bursts: bool) -> Array:
    """Return stamps (n,), s, as a clock that goes evenly for seconds would have made them. place: (n,).

    Stamps in whole milliseconds, or of batches, are off by a good part of a period: by them, what shakes at
    one frequency would be noise at all others, far above the noise that samples in their places have.
    """
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    late = t - period * place
    pause, even = (PAUSE_S, OF_BURSTS) if in_bursts else (LONGEST_GAP * period, EVEN)
    longest = 2 * round(even / 2.0 / period) + 1
    after = np.flatnonzero(np.diff(t) > pause) + 1
    later = [np.median(late[k : k + longest]) - np.median(late[max(k - longest, 0) : k]) for k in after]
    ends = [0, *after[np.array(later) > 0.5 * pause].tolist(), t.size]
    for first, last in pairwise(ends):
        own, count = late[first:last], min(longest, last - first)
        half = count // 2
        own[:] = _without_stalls(own, max(round(PART / period), 1))
        begin, end = _line(own[:count]), _line(own[last - first - count :])
        own[:] = uniform_filter1d(own, count)
        own[:half], own[last - first - half :] = begin[:half], end[count - half :]
    return np.asarray(np.maximum.accumulate(late + period * place))


def _without_stalls(late: Array, part: int) -> Array:
    """Return how late stamps are (n,), s, with those cut short that waited far longer than others do.

    Where a delivery stalls, its samples tell nothing of the clock, and would move all within seconds of them.
    part: samples of which each median is taken.
    """
    from scipy.ndimage import median_filter  # noqa: PLC0415 - the daemon stays light

    parts, half = late.size // part, round(EVEN / PART) // 2
    if parts <= half:
        return late
    own = np.median(late[: parts * part].reshape(parts, part), axis=1)
    own = median_filter(np.pad(own, half, mode="reflect", reflect_type="odd"), 2 * half + 1)[half:-half]
    usual = np.interp(np.arange(late.size), (np.arange(parts) + 0.5) * part - 0.5, own)
    most = STALLED * float(np.median(np.abs(late - usual)))
    return np.asarray(np.clip(late, usual - most, usual + most))


def _line(values: Array) -> Array:
    """Return the straight line (n,) through evenly spaced values (n,)."""
    at = np.arange(values.size, dtype=np.float64) - (values.size - 1) / 2.0
    return np.asarray(values.mean() + float(at @ values) / max(float(at @ at), 1.0) * at)
