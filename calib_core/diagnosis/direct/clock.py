"""What the clock says: its rate against the host's and against the nominal one, and delivery in bursts."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct import timestamps as stamps
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.left_out import blocks, of_counts, rms
from stillcal.calib_core.diagnosis.model.measurement import (
    SIGNIFICANT,
    Measured,
    Seen,
    direct_finding,
    mean_of,
)
from stillcal.calib_core.diagnosis.model.records import Claims, Finding, Where
from stillcal.calib_core.streams.samples import Samples

PIECES = 40
HEELS = 0.2
LEAST_GROUP = 3


def timing_findings(samples: Samples, claims: Claims) -> list[Finding]:
    """Return what the stamps of one stream show. Needs 200 samples."""
    if len(samples) < 200:
        return []
    period = stamps.typical_period(samples.t)
    if period <= 0.0:
        return []
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.5 / period), "time stamps")
    arrived = _arrived(samples)
    grid = stamps.Grid.of(samples.t, period)
    found = (
        _skew(samples.t, arrived, claims, period, where),
        stamps.jitter(grid, where),
        stamps.drops(grid, where),
        None if arrived is None else _bursts(samples.t, arrived, period, where),
    )
    return [f for f in found if f is not None]


def _arrived(samples: Samples) -> Array | None:
    """Return the times of arrival, None unless nearly all are known.

    The others lie between their neighbours.
    """
    if samples.t_arrival is None:
        return None
    known = np.isfinite(samples.t_arrival)
    if known.mean() < 0.9:
        return None
    return np.asarray(np.interp(samples.t, samples.t[known], samples.t_arrival[known]), dtype=np.float64)


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
        keep = np.abs(residual) <= 5.0 * 1.4826 * np.median(np.abs(residual)) + 1e-9
    scatter = max(float(residual[keep].std(ddof=2)), 1e-6)
    rate = Measured(float(coefficients[1]), scatter / float(np.linalg.norm(design[keep, 1])))
    return rate, np.column_stack([x, y])


def _skew(t: Array, arrived: Array | None, claims: Claims, period: float, where: Where) -> Finding | None:
    """Find a clock that is fast or slow against the host's, or a sample rate that is not the nominal one.

    A sensor stamped by its own clock shows the first, one stamped by the host's the second; both are the true
    rate over the nominal one, less 1.
    """
    parts: list[tuple[Measured, float, Array]] = []
    if arrived is not None:
        rate, leads = clock_rate(t, arrived)
        parts.append((rate, thresholds.CLOCK_TOLERANCE, leads))
    if claims.nominal_rate_hz:
        mean = np.array([stamps.mean_period(p) for p in np.array_split(t, PIECES)])
        relative = mean_of(1.0 / (mean * claims.nominal_rate_hz) - 1.0, 1e-6)
        x = t[0] + (np.arange(PIECES) + 0.5) * (t[-1] - t[0]) / PIECES
        lead = np.cumsum(1.0 / (mean * claims.nominal_rate_hz) - 1.0) * (t[-1] - t[0]) / PIECES
        parts.append((relative, thresholds.RATE_TOLERANCE, np.column_stack([x, lead])))
    beyond = [(m.beyond(-tolerance, tolerance), m, leads) for m, tolerance, leads in parts]
    sure = [b for b in beyond if b[0] >= SIGNIFICANT]
    if not sure:
        return None
    total = _product([m for _, m, _ in sure])
    if len(sure) == 2 and total.beyond(-thresholds.CLOCK_TOLERANCE, thresholds.CLOCK_TOLERANCE) < SIGNIFICANT:
        # Samples come at the nominal rate; it is the stamps alone that run fast or slow.
        total = sure[0][1]
    value = total.value
    sigmas, _, leads = max(sure, key=lambda b: b[0])
    say = f"The sensor's clock runs {abs(value) * 1e6:.0f} ppm {'fast' if value > 0.0 else 'slow'}."
    parameter = {"relative": total.parameter("1")}
    seen = _of_line(leads, sigmas)
    return direct_finding("clock_skew", "timing", [], where, parameter, statement=say, seen=seen)


def _product(rates: list[Measured]) -> Measured:
    """Return the rate, less 1, of clocks that each run by the one before."""
    value = float(np.prod([1.0 + m.value for m in rates])) - 1.0
    return Measured(value, float(np.sqrt(sum(m.error**2 for m in rates))))


def _of_line(leads: Array, sigmas: float) -> Seen:
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
    return Seen(sigmas, gain, rms(before), rms(after))


def _bursts(t: Array, arrived: Array, period: float, where: Where) -> Finding | None:
    """Find samples that waited and were delivered together, three at a time or more.

    Two may come together where delivery is merely uneven. The device's own spacing must be as ever.
    """
    heels = (np.diff(arrived) < HEELS * period) & (np.diff(t) > 0.5 * period)
    edges = np.diff(np.concatenate([[False], heels, [False]]).astype(np.int8))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    size = last - first + 1
    many = size >= LEAST_GROUP
    waited = np.zeros(t.size)
    # Of a group, the last came as it should as often as the threshold has it.
    np.add.at(waited, first[many], size[many] - HEELS)
    pieces = np.array_split(waited, PIECES)
    hits, of = np.array([p.sum() for p in pieces]), np.array([float(p.size) for p in pieces])
    fraction = float(hits.sum() / of.sum())
    if fraction < thresholds.BURST_TOLERANCE or many.sum() < thresholds.LEAST_GAPS:
        return None
    error = max(
        float((hits / of).std(ddof=1)) / np.sqrt(PIECES), 0.3 / float(size[many].mean()) * fraction / 2.0
    )
    measured = Measured(fraction, error)
    sigmas = measured.beyond(0.0, thresholds.BURST_TOLERANCE)
    if sigmas < SIGNIFICANT - 2.0:
        return None
    say = f"{fraction:.1%} of the samples arrive in bursts; use the sensor's time stamps, not the arrivals."
    seen = of_counts(np.minimum(hits, of), of, thresholds.BURST_TOLERANCE, sigmas)
    parameter = {"fraction": measured.parameter("1")}
    return direct_finding("arrival_bursts", "timing", [], where, parameter, statement=say, seen=seen)
