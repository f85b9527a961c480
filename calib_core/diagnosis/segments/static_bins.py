"""Cutting a recording into still bins: all that is judged slowly is judged on their means.

A bin belongs to one rest; between two rests the phone moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments import orientation as poses
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import (
    BINS,
    BRIEFEST_BIN,
    Index,
    plugs,
    rest_edges,
)
from stillcal.calib_core.diagnosis.segments.rests.stillness import SHORTEST_REST, still_seconds
from stillcal.calib_core.diagnosis.segments.thermometer import reconstructed
from stillcal.calib_core.diagnosis.segments.value_grid import rounding_error, step_at_rest
from stillcal.calib_core.diagnosis.segments.windows import (
    BRIEF_WINDOWS,
    WINDOW,
    Windows,
    windows,
    without_gaps,
    without_spikes,
)
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples
from stillcal.calib_core.streams.time_series import TimeSeries

POOLED_WEIGHT = 30.0

MANY = 40
"""Bins from which on no briefer windows are tried: a calibration takes nine, an effect up to nine more."""

PERSISTENT = 3.0
"""Ratio above which windows follow one another for a motion's sake: a gyroscope that walks far comes to 2."""

TURNED = 0.5
"""Part of what a gyroscope reads within a rest, from which it is the device that turns and not its noise."""

BEYOND_CHANCE = 3.0
"""Standard errors beyond which a part that comes about is none by chance."""

NEAR_BINS, NEAR_CHANGES = 5, 100
"""Neighbouring bins whose noise is taken to be alike where the phone moves in some: so many at least, and as
many as have that number of changes, of which a median tells as much as 60 do (`residuals.WITHIN_BINS`)."""

LEAST_FORCE, LEAST_RATE = 3e-7, 3e-8
"""m/s^2 and rad/s, about a millionth of a bias as phones have it: no mean is known better. A simulation
without any noise would else leave nothing of what is known beforehand, within the precision of floats."""

LOUDER = 0.01
"""Chance of noise as loud as a bin's from where on it is the bin's own, and not that of the others: what it
leaves out of their mean by mistake lowers that by 3 %."""

PER_BIN = (
    "t",
    "duration",
    "rest",
    "pose",
    "force",
    "force_variance",
    "vibration",
    "rate",
    "rate_variance",
    "temperature",
    "charging",
)
"""The columns of `Bins` that have a row a bin."""


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """Still bins. t, duration: (n,) s; rest: (n,) index; force, rate: (n, 3) means.

    force_variance, rate_variance: (n, 3) of the means, white noise only. temperature: (n,) degC or None;
    charging: (n,) part of the bin on the charger, None without events; charging_switches: (m, 2) s and state.
    activity: (w, 2) s and 1 where the phone moved, per window. vibration: (n,) (m/s^2)^2. span: (start, end)
    s of the recording. Columns that were not recorded are None. force_rounding, rate_rounding: (3,) sd of the
    error that a coarse step of the values leaves in the mean of a rest, the same in all its bins. pose: (n,)
    index of what the gyroscope saw no turn in, None without one. swings: whether what the phone lies on does.
    held: whether rests are so brief that a hand may hold the phone in them, and turn it a little; a table's
    rows may be parts of longer rests. breathes: whether most of what the gyroscope reads in a rest turns it,
    as on a chest or in a hand.
    """

    t: Array
    duration: Array
    rest: Index
    force: Array
    force_variance: Array
    vibration: Array
    activity: Array
    span: tuple[float, float]
    rate: Array | None = None
    rate_variance: Array | None = None
    temperature: Array | None = None
    charging: Array | None = None
    charging_switches: Array | None = None
    force_rounding: Array | None = None
    rate_rounding: Array | None = None
    pose: Index | None = None
    swings: bool = False
    held: bool = False
    breathes: bool = False

    def __len__(self) -> int:
        return int(self.t.size)

    def chosen(self, keep: NDArray[np.bool_]) -> Bins:
        """Return the bins where `keep` (n,) holds, their rests numbered anew."""
        kept: dict[str, Any] = {
            c: None if getattr(self, c) is None else getattr(self, c)[keep] for c in PER_BIN
        }
        kept["rest"] = _numbered(self.rest[keep])
        return replace(self, **kept)

    def within(self, others: Bins) -> Bins:
        """Return the bins whose middle lies in a rest of others."""
        begins = (others.t - others.duration / 2)[np.diff(others.rest, prepend=-1) != 0]
        ends = (others.t + others.duration / 2)[np.diff(others.rest, append=-1) != 0]
        at = self.t[:, None]
        return self.chosen(((begins <= at) & (at <= ends)).any(axis=1))


def _numbered(rest: Index) -> Index:
    """Return which rest each bin (n,) lies in, those that have any bins numbered from 0 on."""
    return np.asarray(np.unique(rest, return_inverse=True)[1], dtype=np.int64)


def _rounding(samples: Samples, parts: Windows, first: Array, last: Array) -> Array:
    """Return the sd (3,) of the error that steps leave in the mean of bins, [first, last) windows each."""
    if not first.size:
        return np.zeros(3)
    step = np.array([step_at_rest(column) or 0.0 for column in samples.xyz.T])
    count = parts.count[:, None]
    square = np.maximum(count - 1.0, 0.0) * parts.variance + count * parts.mean**2
    per_bin = _bin_means(np.hstack([count, count * parts.mean, square]), first, last)
    mean, square = per_bin[:, 1:4] / per_bin[:, :1], per_bin[:, 4:] / per_bin[:, :1]
    return rounding_error(mean, square - mean**2, step)


def overview_of(accelerometer: Samples, gyroscope: Samples | None) -> Overview:
    """Return the windows of a recording that is held whole."""
    span = (float(accelerometer.t[0]), float(accelerometer.t[-1]))
    rate = None if gyroscope is None or len(gyroscope) == 0 else windows(gyroscope, *span)
    return Overview(span, windows(accelerometer, *span), rate, _readings(accelerometer))


def cut(
    accelerometer: Samples,
    gyroscope: Samples | None,
    events: Sequence[Charging] = (),
    bin_length: float | None = None,
    overview: Overview | None = None,
) -> Bins:
    """Cut a recording into still bins of `bin_length` s (None: 10 s, or 1/200 of the recording).

    Where windows of a second find few rests, briefer ones are tried. overview: the recording's windows of a
    second, where the samples are only a part of it (None: they are made from the samples).
    """
    overview = overview or overview_of(accelerometer, gyroscope)
    span, force, rate = overview.span, overview.force, overview.rate
    edges = rest_edges(force, rate, span, bin_length)
    active = (~edges.still).astype(np.float64)
    whole = len(accelerometer) >= force.count.sum()
    for width in BRIEF_WINDOWS if whole else ():
        if edges.first.size >= MANY:
            break
        brief = windows(accelerometer, *span, width)
        turning = None if gyroscope is None or rate is None else windows(gyroscope, *span, width)
        finer = rest_edges(brief, turning, span, bin_length, width)
        if finer.shows_more_than(edges):
            edges, force, rate = finer, brief, turning
    edges = edges.beside_plugs(events, span[0])
    if rate is not None:
        force, rate = without_spikes(force, rate), without_spikes(rate, force)
    force, rate = without_gaps(force), None if rate is None else without_gaps(rate)
    first, last, rest, pose, width = edges.first, edges.last, edges.rest, None, edges.width
    if rate is not None:
        one, turned = poses.poses(edges.runs, force.mean, rate.mean, rate.count, width)
        rest, pose = one[rest], poses.of_bins(turned, first, last)
    swings = rate is not None and _swings(force.mean, rate.mean, first, last, rest)
    return Bins(
        t=span[0] + (first + last) * 0.5 * width,
        duration=(last - first) * width,
        rest=_numbered(rest),
        pose=pose,
        force=_bin_means(force.mean, first, last),
        force_variance=_white_variances(force.mean, first, last, LEAST_FORCE, swings),
        vibration=_bin_means(force.variance.sum(axis=1, keepdims=True), first, last)[:, 0],
        activity=np.stack([overview.force.t, active], axis=1),
        span=span,
        rate=None if rate is None else _bin_means(rate.mean, first, last),
        rate_variance=None if rate is None else _white_variances(rate.mean, first, last, LEAST_RATE, swings),
        swings=swings,
        held=_held(rest, (last - first) * width),
        breathes=rate is not None and _breathes(force.mean, rate.mean, first, last, width),
        temperature=_bin_temperatures(overview.thermometer, span[0], first, last, width),
        force_rounding=_rounding(accelerometer, force, first, last),
        rate_rounding=None if rate is None or gyroscope is None else _rounding(gyroscope, rate, first, last),
        **_charging(events, span, first, last, width),
    )


def cut_all(
    accelerometer: Samples,
    gyroscope: Samples | None,
    events: Sequence[Charging],
    span: tuple[float, float],
    moving: Array | None = None,
) -> Bins:
    """Cut a whole recording into bins, whether the phone moved or not; all of it counts as one rest.

    span: (start, end) s. A bin is 1/200 of it, and `BRIEFEST_BIN` windows at least. moving: (n,) 1 for bins
    whose white noise is that of the bins at rest about them; None where each shows its own.
    """
    force = windows(accelerometer, *span)
    rate = None if gyroscope is None else windows(gyroscope, *span)
    size = max(BRIEFEST_BIN, round((span[1] - span[0]) / WINDOW / BINS))
    first = np.arange(0, force.t.size - size + 1, size, dtype=np.float64)
    last = first + size
    return Bins(
        t=span[0] + (first + last) * 0.5 * WINDOW,
        duration=(last - first) * WINDOW,
        rest=np.zeros(first.size, dtype=np.int64),
        pose=None,
        force=_bin_means(force.mean, first, last),
        force_variance=_near_variances(force.mean, first, last, LEAST_FORCE, moving),
        vibration=_bin_means(force.variance.sum(axis=1, keepdims=True), first, last)[:, 0],
        activity=np.stack([force.t, np.zeros(force.t.size)], axis=1),
        span=span,
        rate=None if rate is None else _bin_means(rate.mean, first, last),
        rate_variance=None if rate is None else _near_variances(rate.mean, first, last, LEAST_RATE, moving),
        temperature=_bin_temperatures(_readings(accelerometer), span[0], first, last),
        **_charging(events, span, first, last),
    )


def _bin_means(values: Array, first: Array, last: Array) -> Array:
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    return np.asarray((total[last.astype(int)] - total[first.astype(int)]) / (last - first)[:, None])


def shaking(samples: Samples, bins: Bins) -> Array:
    """Return the mean square (n,) of a sensor's samples about the mean of each second, over three axes."""
    power = windows(samples, *bins.span).variance.sum(axis=1, keepdims=True)
    first, last = ((bins.t + side * bins.duration / 2.0 - bins.span[0]) / WINDOW for side in (-1.0, 1.0))
    return np.asarray(_bin_means(power, np.rint(first), np.rint(last))[:, 0])


def in_motion(force: Samples, rate: Samples | None, bins: Bins) -> Array:
    """Return 1 for each bin (n,) that is not at rest from its begin to its end, 0 for the others."""
    turning = None if rate is None else windows(rate, *bins.span)
    moved = (~still_seconds(windows(force, *bins.span), turning)).astype(np.float64)[:, None]
    first, last = ((bins.t + side * bins.duration / 2.0 - bins.span[0]) / WINDOW for side in (-1.0, 1.0))
    return (_bin_means(moved, np.rint(first), np.rint(last))[:, 0] > 0.0).astype(np.float64)


def _near_variances(
    values: Array, first: Array, last: Array, least: float, moving: Array | None = None
) -> Array:
    """Variance (n, 3) of bin means, from differences of window means inside bins.

    It is that of a bin and its neighbours, or the bin's own where that is louder by more than chance. It is
    at least `least`^2. Bins that are `moving` (n,) take no part in it, and have what lies between those at
    rest about them.
    """
    still = np.ones(first.size, dtype=bool) if moving is None else moving == 0.0
    own, common = _own_and_common(values, first[still], last[still])
    # Chi-squared: what one in twenty exceeds.
    louder = own > _times_exceeded(0.05, _freedom(first, last)) * common
    variance, centre = common, (first + last) / 2.0
    if moving is not None:
        variance = np.stack([np.interp(centre, centre[still], c) for c in common.T], axis=1)
    variance[still] = np.where(louder, own, common)
    return np.asarray(np.maximum(variance / (last - first)[:, None], least**2))


def _own_and_common(values: Array, first: Array, last: Array) -> tuple[Array, Array]:
    """Return the variance (n, 3) of windows by bin, and of the median one of it and its neighbours."""
    own, freedom = _by_changes(values, first, last), _freedom(first, last)
    side = min(max(NEAR_BINS, int(NEAR_CHANGES / freedom)) // 2, max(len(own) - 1, 0))
    padded = np.pad(own, ((side, side), (0, 0)), mode="reflect") if side else own
    near = np.stack([padded[i : i + len(own)] for i in range(len(padded) - len(own) + 1)])
    return own, np.median(near, axis=0) / _times_exceeded(0.5, freedom)


def _freedom(first: Array, last: Array) -> float:
    """Return how many changes of windows a bin has."""
    return float(last[0] - first[0] - 1.0) if first.size else 1.0


def _by_changes(values: Array, first: Array, last: Array) -> Array:
    """Return the variance (n, 3) of windows that their changes within each bin make of white noise."""
    return _bin_means(np.diff(values, axis=0) ** 2 / 2.0, first, last - 1.0)


def _by_spread(values: Array, first: Array, last: Array) -> Array:
    """Return the variance (n, 3) of windows about the mean of each bin."""
    count, away = (last - first)[:, None], values - values.mean(axis=0)
    spread = _bin_means(away**2, first, last) - _bin_means(away, first, last) ** 2
    return np.asarray(np.maximum(spread, 0.0) * count / np.maximum(count - 1.0, 1.0))


def _white_variances(values: Array, first: Array, last: Array, least: float, swings: bool = False) -> Array:
    """Variance (n, 3) of bin means, from differences of window means inside bins, shrunk to what they share.

    A bin that is louder than that by more than chance has its own: what shakes it does not shake the others.
    Where most bins show no noise at all, for coarse steps, nothing tells which are louder. It is at least
    `least`^2. Of what `swings` the mean is as uncertain as windows scatter: some of a swing is left in it.
    """
    own = _by_spread(values, first, last) if swings else _by_changes(values, first, last)
    count = (last - first - 1.0)[:, None]
    if not count.size:
        return own
    usual = np.median(own / _times_exceeded(0.5, count), axis=0)
    loud = (own > _times_exceeded(LOUDER, count) * usual) & (usual > 0.0)
    weight = np.where(loud, 0.0, count)
    pooled = (own * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
    shrunk = (own * count + pooled * POOLED_WEIGHT) / (count + POOLED_WEIGHT)
    return np.asarray(np.maximum(np.where(loud, own, shrunk) / (last - first)[:, None], least**2))


def _held(rest: Index, duration: Array) -> bool:
    """Whether the usual rest of bins (n,) is brief; duration: (n,) s, of each."""
    seconds = np.bincount(rest, weights=duration)
    return bool(seconds.size > 0 and np.median(seconds[seconds > 0.0]) < SHORTEST_REST * WINDOW)


def _breathes(force: Array, rate: Array, first: Array, last: Array, width: float) -> bool:
    """Whether most of what a gyroscope reads about its mean of a rest turns gravity, as a breath does.

    From window to window, `width` s apart, the force changes by force x rate (n, 3). The median over bins of
    the part of it that comes about is 1 for a turn and 0 for a gyroscope's noise. Beside a noisy
    accelerometer what a quiet gyroscope reads comes about by chance: the median has to be beyond that.
    """
    bins = [(a, b) for a, b in zip(first.astype(int), last.astype(int), strict=True) if b - a >= BRIEFEST_BIN]
    parts = []
    for a, b in bins:
        own = rate[a:b] - rate[a:b].mean(axis=0)
        middle = 0.5 * (force[a : b - 1] + force[a + 1 : b])
        turned = np.cross(middle, 0.5 * (own[1:] + own[:-1])) * width
        parts.append(float((turned * np.diff(force[a:b], axis=0)).sum() / max((turned**2).sum(), 1e-300)))
    if not parts:
        return False
    median = float(np.median(parts))
    scatter = MAD_TO_SD * float(np.median(np.abs(np.array(parts) - median)))
    error = float(np.sqrt(0.5 * np.pi / len(parts))) * scatter
    return median > max(TURNED, BEYOND_CHANCE * error)


def _swings(force: Array, rate: Array, first: Array, last: Array, rest: Index) -> bool:
    """Whether what the sensor lies on swings, as a ship rolls: windows follow one another in both."""
    return min(_persistence(values, first, last, rest) for values in (force, rate)) > PERSISTENT


def _persistence(values: Array, first: Array, last: Array, rest: Index) -> float:
    """Return the variance of windows within bins over what their successive differences make of it.

    It is the median over bins, of the axis that has it largest; 1 for white noise (von Neumann 1941). What
    goes on in the same direction from bin to bin, as a bias does that is heated, is no swing.
    """
    long = last - first >= BRIEFEST_BIN
    if not long.any():
        return 1.0
    first, last, rest = first[long], last[long], rest[long]
    away = values - _trend(values - values.mean(axis=0), first, last, rest)
    changes = np.maximum(_by_changes(away, first, last), LEAST_RATE**2)
    return float(np.median(_by_spread(away, first, last) / changes, axis=0).max())


def _trend(values: Array, first: Array, last: Array, rest: Index) -> Array:
    """Return by how much windows (w, 3) differ from their bin's mean on a line between the bins beside it."""
    mean, centre, index = _bin_means(values, first, last), (first + last) / 2.0, np.arange(first.size)
    joined = np.diff(rest) == 0
    before, after = index - np.append(False, joined), index + np.append(joined, False)
    slope = (mean[after] - mean[before]) / np.maximum(centre[after] - centre[before], 1.0)[:, None]
    window = np.arange(len(values))
    lies = np.clip(np.searchsorted(first, window, side="right") - 1, 0, None)
    return np.asarray(slope[lies] * (window + 0.5 - centre[lies])[:, None])


def _times_exceeded(chance: float, freedom: Array | float) -> Array:
    """Return how many times its mean a chi-squared of some degrees of freedom exceeds by this chance."""
    from scipy.special import chdtri  # noqa: PLC0415 - the daemon stays light

    return np.asarray(chdtri(freedom, chance) / freedom)


def _readings(samples: Samples) -> Array | None:
    """Return the known temperatures (k, 2), s and degC; None without a thermometer."""
    if samples.temperature is None:
        return None
    known = np.isfinite(samples.temperature)
    return np.stack([samples.t[known], samples.temperature[known]], axis=1)


def _bin_temperatures(
    readings: Array | None, t_start: float, first: Array, last: Array, width: float = WINDOW
) -> Array | None:
    if readings is None or len(readings) < 2 or first.size == 0:
        return None
    course = TimeSeries(readings[:, 0], reconstructed(*readings.T))
    return course.mean(t_start + (first + last) * 0.5 * width, (last - first) * width)


def _charging(
    events: Sequence[Charging],
    span: tuple[float, float],
    first: Array,
    last: Array,
    width: float = WINDOW,
) -> dict[str, Any]:
    """Return charging per bin and (m, 2) switching times; before the first event its opposite held."""
    switched = plugs(events)
    if not switched:
        return {"charging": None, "charging_switches": None}
    times = np.array([span[0], *(e.t for e in switched)])
    states = np.array(
        [float(switched[0].t > span[0] and not switched[0].on), *(float(e.on) for e in switched)]
    )
    fine = span[0] + np.arange(int((span[1] - span[0]) / width) + 1) * width
    at = states[np.maximum(np.searchsorted(times, fine, side="right") - 1, 0)]
    return {
        "charging": _bin_means(at[:, None], first, last)[:, 0],
        "charging_switches": np.stack([times, states], axis=1),
    }
