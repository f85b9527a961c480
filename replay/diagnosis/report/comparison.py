"""Comparison of a recording and a simulated one: whether their residuals have the same statistics.

The units compared are independent of each other, unlike samples: static bins, spans of time stamps, rests,
and coefficients with their coloured uncertainty. A difference counts only beyond a tolerance within which
phones of one model differ; p-values are corrected for the number of comparisons (Holm, Scand. J. Statist. 6,
1979).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.codec import plain
from stillcal.calib_core.diagnosis.direct.low_pass import quiet, spectra
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.measurement import Measured, mean_of, tail
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT, comb_step
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.report.comparison_slow import SlowSide, slow_differences, slow_side
from stillcal.replay.formats.trace import Recording

LEVEL = 0.01
"""Corrected p-value below which the simulation is rejected."""

BANDS = 4
"""Bands of equal width in the logarithm of frequency."""

SPREAD_TOLERANCE = 0.1
"""Relative difference of noise levels that does not count."""

BAND_TOLERANCE = 0.2
"""The same for the power in a band, which is a square."""

SHAPE_TOLERANCE = 0.15
"""Difference of excess kurtosis that does not count."""

PIECES = 40
"""Spans of time of equally many intervals; each gives one value of a statistic of the time stamps."""


@dataclass(frozen=True, slots=True)
class Compared:
    """One comparison. recorded, simulated: the statistic's mean in either, in `unit`."""

    statistic: str
    channel: str
    recorded: float
    simulated: float
    unit: str
    p_value: float
    p_corrected: float = 1.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """All comparisons, most different first. accepted: whether none is below the level."""

    accepted: bool
    level: float
    tests: list[Compared]

    def plain(self) -> dict[str, Any]:
        """Return the comparison as plain values."""
        values: dict[str, Any] = plain(self)
        return values


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One recording with its static bins and their slow statistics."""

    recording: Recording
    bins: Bins
    gravity: float
    slow: SlowSide


def side_of(recording: Recording, bins: Bins, gravity: float) -> Side:
    """Prepare a recording for comparisons."""
    return Side(recording, bins, gravity, slow_side(bins, gravity))


def compare(recorded: Side, simulated: Side) -> Comparison:
    """Compare all statistics that both recordings have."""
    comparisons = [*_compare_stamps(recorded.recording, simulated.recording)]
    streams = (
        ("accel", recorded.recording.accelerometer, simulated.recording.accelerometer),
        ("gyro", recorded.recording.gyroscope, simulated.recording.gyroscope),
    )
    for sensor, one, other in streams:
        if one is not None and other is not None:
            comparisons += _compare_samples(sensor, (one, recorded.bins), (other, simulated.bins))
    comparisons += [Compared(*row) for row in slow_differences(recorded.slow, simulated.slow)]
    return holm_corrected(comparisons)


def holm_corrected(comparisons: Sequence[Compared], level: float = LEVEL) -> Comparison:
    """Return the comparisons with p-values corrected by Holm's method, most different first."""
    ordered = sorted(comparisons, key=lambda c: c.p_value)
    steps = [min(1.0, c.p_value * (len(ordered) - i)) for i, c in enumerate(ordered)]
    rising: list[float] = np.maximum.accumulate(steps).tolist() if steps else []
    tests = [replace(c, p_corrected=p) for c, p in zip(ordered, rising, strict=True)]
    return Comparison(all(c.p_corrected >= level for c in tests), level, tests)


def difference(one: Measured, other: Measured, tolerance: float) -> float:
    """Return the two-sided p-value of a difference of two means beyond the tolerance."""
    distance = Measured(one.value - other.value, float(np.hypot(one.error, other.error)))
    return tail(distance.beyond(-tolerance, tolerance))


def _compare_stamps(one: Recording, other: Recording) -> Iterator[Compared]:
    period = float(np.median(np.diff(one.accelerometer.t)))
    sides = [_intervals(r.accelerometer, period) for r in (one, other)]
    tolerances = (
        ("mean interval", "s", thresholds.RATE_TOLERANCE * period),
        ("scatter of intervals", "s", 2.0 * thresholds.JITTER_TOLERANCE * period),
        ("missing samples per sample recorded", "1", 10.0 * thresholds.DROP_TOLERANCE),
    )
    for i, (what, unit, tolerance) in enumerate(tolerances):
        yield _compare_pieces(what, "stamps", unit, (sides[0][i], sides[1][i]), tolerance)
    arrivals = [_burst_parts(r.accelerometer, period) for r in (one, other)]
    if arrivals[0] is not None and arrivals[1] is not None:
        both = (arrivals[0], arrivals[1])
        yield _compare_pieces(
            "part of samples in bursts", "arrival", "1", both, 2.0 * thresholds.BURST_TOLERANCE
        )


def _compare_pieces(
    what: str, channel: str, unit: str, sides: tuple[Array, Array], tolerance: float
) -> Compared:
    means = [_mean(side) for side in sides]
    p = difference(means[0], means[1], tolerance)
    return Compared(what, channel, means[0].value, means[1].value, unit, p)


def _mean(pieces: Array) -> Measured:
    """Return the mean of pieces with its standard error, which is at least 1e-12."""
    error = float(pieces.std(ddof=1)) / np.sqrt(pieces.size)
    return Measured(float(pieces.mean()), max(error, 1e-12))


def _intervals(samples: Samples, period: float) -> tuple[Array, Array, Array]:
    """Return mean, scatter and missing samples per sample of the intervals, (PIECES,) each."""
    parts = np.array_split(np.diff(samples.t), PIECES)
    even = [p[np.abs(p - period) < 0.75 * period] for p in parts]
    mean = [float(np.median(p)) for p in parts]
    scatter = [float(np.diff(e).std() / np.sqrt(6.0)) if e.size > 8 else 0.0 for e in even]
    hops = [np.maximum(np.rint(p / period) - 1.0, 0.0) for p in parts]
    missing = [float(h[h < 50].sum() / max(h.size, 1)) for h in hops]
    return np.array(mean), np.array(scatter), np.array(missing)


def stamps_measured(samples: Samples) -> tuple[float, float]:
    """Return the standard deviation of a stamp about an even rate, s, and the part of samples missing."""
    _, scatter, missing = _intervals(samples, float(np.median(np.diff(samples.t))))
    missing_share = float(missing.mean())
    return float(np.median(scatter)), missing_share / (1.0 + missing_share)


def _burst_parts(samples: Samples, period: float) -> Array | None:
    if samples.t_arrival is None:
        return None
    late = np.diff(samples.t_arrival) < 0.2 * period
    return np.array(
        [float(p.mean()) for p in np.array_split(late & (np.diff(samples.t) > 0.5 * period), PIECES)]
    )


def _compare_samples(
    sensor: str, recorded: tuple[Samples, Bins], simulated: tuple[Samples, Bins]
) -> Iterator[Compared]:
    """Compare what single samples do inside still bins, bin by bin."""
    one, other = (quiet(samples, bins) for samples, bins in (recorded, simulated))
    if min(len(one.pieces), len(other.pieces)) < 5:
        return
    rate = min(one.rate, other.rate)
    moments = [_per_bin(still.pieces) for still in (one, other)]
    power = [_band_power(spectra(still), rate) for still in (one, other)]
    steps = [[comb_step(s.xyz[:, a]) or 0.0 for a in range(3)] for s, _ in (recorded, simulated)]
    for a, axis in enumerate("xyz"):
        name, unit = f"{sensor} {axis}", UNIT[sensor]
        yield _compare_steps(name, unit, (steps[0][a], steps[1][a]), moments)
        if _coarse(steps[0][a], moments[0]) and _coarse(steps[1][a], moments[1]):
            continue  # noise below a step depends on where a rest lies between two values
        spreads, shapes = (
            (moments[0][what][:, a], moments[1][what][:, a]) for what in ("spread", "kurtosis")
        )
        yield _compare_logarithms("spread of samples at rest", name, unit, spreads, SPREAD_TOLERANCE)
        yield _compare_means("excess kurtosis of samples at rest", name, "1", shapes, SHAPE_TOLERANCE)
        for b in range(BANDS):
            low, high = _edges(rate)[b : b + 2]
            what = f"power from {_hertz(low)} to {_hertz(high)} Hz"
            bands = (power[0][:, b, a], power[1][:, b, a])
            yield _compare_logarithms(what, name, f"({unit})^2/Hz", bands, BAND_TOLERANCE)


def _hertz(f: float) -> str:
    return f"{f:.1f}" if f < 10.0 else f"{f:.0f}"


def _compare_means(
    what: str, channel: str, unit: str, sides: tuple[Array, Array], tolerance: float
) -> Compared:
    one, other = (mean_of(side, 1e-12) for side in sides)
    return Compared(what, channel, one.value, other.value, unit, difference(one, other, tolerance))


def _compare_logarithms(
    what: str, channel: str, unit: str, sides: tuple[Array, Array], tolerance: float
) -> Compared:
    """Compare logarithms; the result has the geometric means, in `unit`."""
    logarithmic = _compare_means(what, channel, unit, sides, tolerance)
    return replace(
        logarithmic,
        recorded=float(np.exp(logarithmic.recorded)),
        simulated=float(np.exp(logarithmic.simulated)),
    )


def _per_bin(pieces: Sequence[Array]) -> dict[str, Array]:
    """Return the logarithm of the spread and the excess kurtosis of every bin, (n, 3) each."""
    sd = np.array([p.std(axis=0) for p in pieces])
    fourth = np.array([np.mean(p**4, axis=0) for p in pieces])
    floor = np.maximum(sd, 1e-12)
    return {"spread": np.log(floor), "kurtosis": fourth / floor**4 - 3.0}


def _compare_steps(
    channel: str, unit: str, step: tuple[float, float], moments: list[dict[str, Array]]
) -> Compared:
    """Compare quantisation steps: they differ where one is coarse relative to the noise and not equal."""
    coarse = any(_coarse(s, side) for s, side in zip(step, moments, strict=True))
    same = not coarse or abs(step[0] - step[1]) < 0.02 * max(step)
    return Compared("step of values", channel, *step, unit, 1.0 if same else 1e-12)


def _coarse(step: float, moments: dict[str, Array]) -> bool:
    return step > 0.5 * float(np.exp(np.median(moments["spread"])))


def _edges(rate: float) -> Array:
    return np.asarray(np.geomspace(0.02 * rate, 0.45 * rate, BANDS + 1))


def _band_power(measured: tuple[Array, Array], rate: float) -> Array:
    """Return the logarithm of the mean density of every bin in every band, (n, BANDS, 3)."""
    f, power = measured
    band = np.digitize(f, _edges(rate)) - 1
    means = [power[:, band == b].mean(axis=1) for b in range(BANDS)]
    return np.asarray(np.log(np.maximum(np.stack(means, axis=1), 1e-300)))
