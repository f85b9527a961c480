"""What stamps say: the clock's rate, jitter, samples that never came, delivery in bursts."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.quick import SIGNIFICANT, Measured, direct_finding, mean_of
from stillcal.calib_core.misfit.records import Claims, Finding, Parameter, Where
from stillcal.calib_core.samples import Array, Samples

PIECES = 40
LONGEST_GAP = 50


def timing_findings(samples: Samples, claims: Claims) -> list[Finding]:
    """Return what the stamps of one stream show. Needs 200 samples."""
    if len(samples) < 200:
        return []
    period = float(np.median(np.diff(samples.t)))
    if period <= 0.0:
        return []
    found = (
        _skew(samples, claims),
        _jitter(samples.t, period),
        _drops(samples.t, period),
        _bursts(samples, period),
    )
    return [f for f in found if f is not None]


def _where(samples_t: Array, period: float) -> Where:
    return Where(float(samples_t[0]), float(samples_t[-1]), (0.0, 0.5 / period), "time stamps")


def clock_rate(t: Array, arrival: Array) -> Measured:
    """Device seconds per host second, less 1, from the quickest deliveries of `PIECES` pieces."""
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
    return Measured(float(coefficients[1]), scatter / float(np.linalg.norm(design[keep, 1])))


def _skew(samples: Samples, claims: Claims) -> Finding | None:
    if samples.t_arrival is not None and np.isfinite(samples.t_arrival).all():
        rate, tolerance = clock_rate(samples.t, samples.t_arrival), thresholds.CLOCK_TOLERANCE
    elif claims.nominal_rate_hz:
        pieces = [1.0 / np.median(np.diff(p)) for p in np.array_split(samples.t, PIECES)]
        relative = mean_of(np.array(pieces) / claims.nominal_rate_hz - 1.0, 1e-6)
        rate, tolerance = relative, thresholds.RATE_TOLERANCE
    else:
        return None
    sigmas = rate.beyond(-tolerance, tolerance)
    if sigmas < SIGNIFICANT:
        return None
    say = f"The sensor's clock runs {rate.value * 1e6:+.0f} ppm against its reference."
    where = _where(samples.t, float(np.median(np.diff(samples.t))))
    parameter = {"relative": rate.parameter("1")}
    return direct_finding("clock_skew", "timing", [], where, parameter, statement=say, sigmas=sigmas)


def _jitter(t: Array, period: float) -> Finding | None:
    """White jitter of stamps: the second difference of an even grid has six times its variance."""
    steps = np.diff(t)
    even = np.abs(steps - period) < 0.75 * period
    second = np.diff(steps)[even[1:] & even[:-1]]
    if second.size < 100:
        return None
    pieces = [float(np.sqrt(np.mean(p**2) / 6.0)) for p in np.array_split(second, PIECES)]
    sigma = mean_of(np.array(pieces), 1e-3 * period / np.sqrt(second.size))
    sigmas = sigma.beyond(0.0, thresholds.JITTER_TOLERANCE * period)
    if sigmas < SIGNIFICANT:
        return None
    say = f"Stamps scatter by {sigma.value * 1e3:.2f} ms about an even rate; resample by the fitted clock."
    where, parameter = _where(t, period), {"sigma": sigma.parameter("s")}
    return direct_finding("timestamp_jitter", "timing", [], where, parameter, statement=say, sigmas=sigmas)


def _drops(t: Array, period: float) -> Finding | None:
    multiples = np.rint(np.diff(t) / period)
    gaps = multiples[(multiples >= 2) & (multiples <= LONGEST_GAP)] - 1
    missing = float(gaps.sum())
    total = t.size + missing
    if gaps.size < thresholds.LEAST_GAPS or missing / total < thresholds.DROP_TOLERANCE:
        return None
    fraction = missing / total
    error = np.sqrt(float((gaps**2).sum())) / total
    low, high = max(fraction - 1.96 * error, 0.0), fraction + 1.96 * error
    say = f"{fraction:.2%} of the samples are missing, in {gaps.size} gaps."
    parameter = {"fraction": Parameter(fraction, [low, high], "1")}
    return direct_finding(
        "dropped_samples", "timing", [], _where(t, period), parameter, statement=say, sigmas=fraction / error
    )


def _bursts(samples: Samples, period: float) -> Finding | None:
    """Part of the samples that arrived on the heels of the one before, against the device's own spacing."""
    if samples.t_arrival is None:
        return None
    late = np.diff(samples.t_arrival) < 0.2 * period
    spaced = np.diff(samples.t) > 0.5 * period
    pieces = np.array([float(p.mean()) for p in np.array_split(late & spaced, PIECES)])
    fraction = float(pieces.mean())
    if fraction < thresholds.BURST_TOLERANCE:
        return None
    error = max(float(pieces.std(ddof=1)) / np.sqrt(PIECES), 1e-6)
    measured = Measured(fraction, error)
    say = (
        f"{fraction:.1%} of the samples were delivered in bursts; take the sensor's stamps, not the arrival."
    )
    where = _where(samples.t, period)
    parameter = {"fraction": measured.parameter("1")}
    return direct_finding(
        "arrival_bursts", "timing", [], where, parameter, statement=say, sigmas=fraction / error
    )
