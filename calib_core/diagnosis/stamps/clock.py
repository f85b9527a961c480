"""What the clock says: its rate against the host's and against the nominal one, and delivery in bursts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import SHARE_PIECES, blocks, of_shares
from stillcal.calib_core.diagnosis.model.measurement import (
    HeldOut,
    Measured,
    direct_finding,
    of_measured,
    share_of,
)
from stillcal.calib_core.diagnosis.model.records import Claims, Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import SoundPhones, Usual, usual
from stillcal.calib_core.diagnosis.segments.sample_period import HEELS as ON_HEELS
from stillcal.calib_core.diagnosis.segments.sample_period import bunched, sample_period
from stillcal.calib_core.diagnosis.stamps import timestamps as stamps
from stillcal.calib_core.diagnosis.stamps.clock_wander import wander
from stillcal.calib_core.diagnosis.stamps.interval_memory import interval_memory
from stillcal.calib_core.diagnosis.stamps.rate_changes import rate_change, stretches
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.streams.samples import Samples

PIECES = 40
HEELS = 0.2
"""Part of the period after another within which a sample arrives on its heels."""

LEAST_GROUP = 3
"""Samples in a burst: two may come together where delivery is merely uneven."""

LEAST_SHARE = 1e-3
"""Share of samples in bursts that is none, on the logarithmic scale of populations."""

LEAST_SAMPLES = 200

MOST_OFF = 0.2
"""Part of its rate by which no sensor's oscillator is off: datasheets allow 1 to 15 %. Beyond, stamps leave
out pauses, or count another unit."""

DRIVER = "stamps that pass another time than the host"


def timing_findings(samples: Samples, claims: Claims, sound: SoundPhones) -> list[Finding]:
    """Return what the stamps of one stream show. Needs 200 samples."""
    period = sample_period(samples.t)
    if len(samples) < LEAST_SAMPLES or period <= 0.0:
        return []
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.5 / period), "time stamps")
    arrived, changes = arrivals(samples), stretches(samples.t)
    nominal = claims.nominal_rate_hz
    found = [_skew(samples.t, arrived, None if changes else nominal, sound, where)]
    found.append(rate_change(samples.t, changes, sound["rate_change"], 0.5 / period))
    if arrived is not None:
        found.append(wander(samples.t, arrived, sound["clock_wander"], where))
    if bunched(samples.t):
        found.append(_stamped_in_bursts(samples.t, period, sound["arrival_bursts"], where))
    else:
        grid = stamps.Grid.of(samples.t, period)
        together = interval_memory(grid, sound["interval_memory"], where)
        alone = stamps.jitter(grid, usual(sound, "timestamp_jitter", nominal), where)
        found.append(together or alone)
        if grid.told:
            found.append(stamps.drops(grid, usual(sound, "dropped_samples", nominal), where))
        if arrived is not None:
            common = usual(sound, "arrival_bursts", nominal)
            found.append(_bursts(samples.t, waited(samples.t, arrived, period), common, where))
    return [f for f in found if f is not None]


def arrivals(samples: Samples) -> Array | None:
    """Return the times of arrival, None unless nearly all are known.

    The others lie between their neighbours.
    """
    if samples.t_arrival is None:
        return None
    known = np.isfinite(samples.t_arrival)
    if known.mean() < 0.9:
        return None
    return np.asarray(np.interp(samples.t, samples.t[known], samples.t_arrival[known]), dtype=np.float64)


def rate_against_host(samples: Samples | None) -> Measured:
    """Return device seconds per host second, less 1: surely nothing where the host's time is not recorded."""
    arrived = arrivals(samples) if samples is not None and len(samples) >= LEAST_SAMPLES else None
    if samples is None or arrived is None:
        return Measured(0.0, 0.0)
    return clock_rate(samples.t, arrived)[0]


def clock_rate(t: Array, arrival: Array) -> tuple[Measured, Array]:
    """Return device seconds per host second, less 1, from the quickest deliveries of `PIECES` pieces.

    Also those pieces' host time and lead (PIECES, 2) s.
    """
    latency = arrival - t
    pieces = np.array_split(np.arange(t.size), PIECES)
    quickest = np.array([p[np.argmin(latency[p])] for p in pieces])
    x, y = arrival[quickest] - arrival[0], t[quickest] - arrival[quickest]
    design = np.column_stack([np.ones_like(x), x - x.mean()])
    keep = np.ones(x.size, dtype=bool)
    for _ in range(3):
        coefficients = np.linalg.lstsq(design[keep], y[keep], rcond=None)[0]
        residual = y - design @ coefficients
        keep = np.abs(residual) <= 5.0 * MAD_TO_SD * np.median(np.abs(residual)) + 1e-9
    scatter = max(float(residual[keep].std(ddof=2)), 1e-6)
    rate = Measured(float(coefficients[1]), scatter / float(np.linalg.norm(design[keep, 1])))
    return rate, np.column_stack([x, y])


def nominal_rate_error(grid: stamps.Grid, nominal_rate_hz: float) -> tuple[Measured, Array]:
    """Return the true rate over the nominal one, less 1, and what it makes of the stamps (PIECES, 2) s."""
    t = grid.t
    mean, pieces = grid.mean_rate(PIECES, 1e-6)
    ratio, off = np.exp(mean.value) / nominal_rate_hz, np.exp(pieces) / nominal_rate_hz - 1.0
    x = t[0] + (np.arange(PIECES) + 0.5) * (t[-1] - t[0]) / PIECES
    leads = np.column_stack([x, np.cumsum(off) * (t[-1] - t[0]) / PIECES])
    return Measured(float(ratio) - 1.0, float(ratio) * mean.error), leads


def rate_errors(
    t: Array, arrived: Array | None, nominal: float | None, sound: SoundPhones
) -> list[tuple[Measured, Array, Usual]]:
    """Return the clock's error against the host's and of the sample rate, where they are known.

    With each go its pieces (PIECES, 2) s and what sound phones show.
    """
    parts = []
    if arrived is not None:
        parts.append((*clock_rate(t, arrived), sound["clock_skew"]))
    grid = stamps.Grid.of(t, sample_period(t)) if nominal and not bunched(t) else None
    if nominal and grid is not None and grid.told:
        parts.append((*nominal_rate_error(grid, nominal), sound["nominal_rate"]))
    return parts


def _skew(
    t: Array, arrived: Array | None, nominal: float | None, sound: SoundPhones, where: Where
) -> Finding | None:
    """Find a clock that is fast or slow against the host's, or a sample rate that is not the nominal one.

    A sensor stamped by its own clock shows the first, one stamped by the host's the second; both are the true
    rate over the nominal one, less 1.
    """
    parts = [
        (rate, of_measured(rate, common, _of_line(leads)))
        for rate, leads, common in rate_errors(t, arrived, nominal, sound)
    ]
    sure = [(rate, seen) for rate, seen in parts if seen.stated]
    if not sure:
        return None
    total = _product([rate for rate, _ in sure])
    if len(sure) == 2 and not of_measured(total, sound["clock_skew"]).stated:
        # Samples come at the nominal rate; it is the stamps alone that run fast or slow.
        total = sure[0][0]
    value = total.value
    say = f"The sensor's clock runs {abs(value) * 1e6:.0f} ppm {'fast' if value > 0.0 else 'slow'}."
    parameter = {"relative": total.parameter("1")}
    seen = max((s for _, s in sure), key=lambda s: s.log_bayes_factor)
    found = direct_finding("clock_skew", "timing", [], where, parameter, statement=say, seen=seen)
    return found if found is None or arrived is None else _no_clock(found, parts[0][0].value)


def _no_clock(found: Finding, against_host: float) -> Finding:
    """Return a clock's error, without the name where no clock is so far off the host's."""
    if abs(against_host) <= MOST_OFF:
        return found
    say = (
        f"The stamps pass {1.0 + against_host:.3g} s in each second of the host's time, which no clock does:"
        " they leave out pauses, or are in another unit."
    )
    return replace(found, effect="unknown", where=replace(found.where, driver=DRIVER), statement=say)


def _product(rates: list[Measured]) -> Measured:
    """Return the rate, less 1, of clocks that each run by the one before."""
    value = float(np.prod([1.0 + m.value for m in rates])) - 1.0
    return Measured(value, float(np.sqrt(sum(m.error**2 for m in rates))))


def _of_line(leads: Array) -> HeldOut:
    """Predict leads (n, 2) left out by a line through the others, and by their mean; before, after in s."""
    x, y = leads.T
    fold, gain = blocks(x.size), 0.0
    before, after = np.zeros(x.size), np.zeros(x.size)
    for k in np.unique(fold):
        test = fold == k
        line, level = np.polyfit(x[~test], y[~test], 1), float(y[~test].mean())
        off, flat = y - np.polyval(line, x), y - level
        own, null = rms(off[~test]) + 1e-9, rms(flat[~test]) + 1e-9
        gain += float(
            (np.log(null / own) + 0.5 * (flat[test] / null) ** 2 - 0.5 * (off[test] / own) ** 2).sum()
        )
        before[test], after[test] = flat[test], off[test]
    return HeldOut(gain, rms(before), rms(after))


def waited(t: Array, arrived: Array, period: float) -> tuple[Array, float]:
    """Return which samples waited (n,), as numbers, and how many wait together on average.

    They were delivered together, three at a time or more, though the device's own spacing was as ever.
    """
    heels = (np.diff(arrived) < HEELS * period) & (np.diff(t) > 0.5 * period)
    edges = np.diff(np.concatenate([[False], heels, [False]]).astype(np.int8))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    size = last - first + 1
    many = size >= LEAST_GROUP
    waited = np.zeros(t.size)
    # Of a group, the last came as it should as often as the threshold has it.
    np.add.at(waited, first[many], size[many] - HEELS)
    return waited, float(size[many].mean()) if many.any() else 1.0


def burst_share(waiting: tuple[Array, float]) -> Measured:
    """Return the share of samples that wait. waiting: from `waited`."""
    hits, together = waiting
    return share_of(float(hits.sum()), float(hits.size), together)


def _bursts(t: Array, waiting: tuple[Array, float], common: Usual, where: Where) -> Finding | None:
    """Find samples that waited and were delivered together. common: of log10 of their share plus 1e-3."""
    fraction = burst_share(waiting)
    pieces = np.array_split(waiting[0], SHARE_PIECES)
    hits, of = np.array([p.sum() for p in pieces]), np.array([float(p.size) for p in pieces])
    held_out = of_shares(np.minimum(hits, of), of, min(10.0**common.highest, 0.9))
    seen = of_measured(fraction.log(LEAST_SHARE), common, held_out)
    share = f"{fraction.value:.1%}"
    where, when = stamps.located(t, waiting[0], where)
    say = f"{share} of the samples arrive in bursts{when}; use the sensor's time stamps, not the arrivals."
    parameter = {"fraction": fraction.parameter("1")}
    return direct_finding("arrival_bursts", "timing", [], where, parameter, statement=say, seen=seen)


def stamped_share(t: Array, period: float) -> Measured:
    """Return the share of samples that are stamped, t (n,) s, on the heels of the one before."""
    heels = np.diff(t) < ON_HEELS * period
    runs = int((heels[1:] & ~heels[:-1]).sum()) + 1
    return share_of(float(heels.sum()), float(heels.size), max(float(heels.sum()) / runs, 1.0))


def _stamped_in_bursts(t: Array, period: float, common: Usual, where: Where) -> Finding | None:
    """State stamps that are times of delivery: most samples are stamped on the heels of another."""
    fraction = stamped_share(t, period)
    seen = of_measured(fraction.log(LEAST_SHARE), common)
    say = (
        f"{fraction.value:.0%} of the samples are stamped in bursts, within {ON_HEELS:.0%} of the mean"
        f" interval after another: the stamps are times of delivery. The rate is {1.0 / period:.4g} Hz."
    )
    parameter = {"fraction": fraction.parameter("1")}
    return direct_finding("arrival_bursts", "timing", [], where, parameter, statement=say, seen=seen)
