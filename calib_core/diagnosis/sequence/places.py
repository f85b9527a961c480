"""Noise that follows the count of the samples: other noise at some place of every batch, or at a steady beat.

A batch of n samples, as a FIFO or a bus delivers it, gives the size of the noise a line at n samples and its
overtones; a sensor that is resampled by interpolation gives it one at the difference of the rates. Lines are
held against the spectrum about them, which is the null: periods of this recording that are not quite those.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import Seen, direct_finding, of_chance, sized
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Where
from stillcal.calib_core.diagnosis.sequence.neighbours import (
    LEAST_SPREAD,
    REACH,
    residual,
    spread,
    without_lines,
)
from stillcal.calib_core.streams.samples import Samples

DRIVER = "count of the samples"
LARGEST = 64
"""Samples in a batch, at most."""

ASIDE, OWN = 16, 4
"""Lines of the neighbourhood on either side, and those between that are a line's own."""

INDEPENDENT = 2 * ASIDE / 1.5
"""Of these: neighbouring lines under a Hann window are correlated."""

SLOWEST = 0.02
"""Lines a sample below which what changes is the phone's surroundings."""

FARTHEST = 4.0
"""Spreads at which the size of a residual is held."""

LEAST_SAMPLES = 1000
MOST_HELD = 0.01
"""Part of the samples at rest that may repeat the one before: where values are held, or steps hide the noise,
residuals are as regular as these are."""


def by_count(samples: Samples, sensor: str, size: Array) -> Finding | None:
    """Find noise at rest whose size follows the count of the samples. size: as `noise_size` has it."""
    line = lines(size)
    period, batched = batch(line)
    beat, single = _beat(line)
    nats, say = max(
        (batched, f"at one place of every {period:.0f} samples"), (single, f"every {1.0 / beat:.4g} samples")
    )
    length = float(period) if batched >= single else 1.0 / beat
    told = f"The size of the {NAME[sensor]}'s noise at rest changes {say}, as no motion does."
    half = 0.5 * len(samples) / max(float(samples.t[-1] - samples.t[0]), 1e-9)
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, half), DRIVER)
    sizes = sized({"period_samples": (length, "samples"), "depth": (depth(size, length), "1")})
    return direct_finding(
        "unknown", sensor, [0, 1, 2], where, sizes, statement=told, seen=Seen(nats - float(np.log(2.0)))
    )


def noise_size(xyz: Array, still: NDArray[np.bool_]) -> Array | None:
    """Return the size (m,) of the noise of each sample, less its mean, nothing where the phone moved."""
    rest = still[REACH:-REACH]
    if rest.sum() < LEAST_SAMPLES:
        return None
    held = (np.diff(xyz, axis=0)[still[1:]] == 0.0).all(axis=1)
    left = residual(xyz)
    unit = spread(left[rest])
    if held.mean() > MOST_HELD or (unit <= LEAST_SPREAD).any():
        return None
    left = without_lines(np.where(rest[:, None], left, 0.0))
    size = np.minimum(np.abs(left) / unit, FARTHEST).mean(axis=1)
    return np.asarray(np.where(rest, size - size[rest].mean(), 0.0))


def lines(size: Array) -> Array:
    """Return nats (k,) of lines of a series (m,), up to half a period a sample: by chance exponential."""
    from scipy.fft import next_fast_len  # noqa: PLC0415 - the daemon stays light
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    length = next_fast_len(size.size + 1, real=True) // 2 * 2
    power = np.abs(np.fft.rfft(size * np.hanning(size.size), length)) ** 2
    own, every = 2 * OWN + 1, 2 * (ASIDE + OWN) + 1
    around = every * uniform_filter1d(power, every) - own * uniform_filter1d(power, own)
    usual = np.maximum(around / (every - own), 1e-300)
    return np.asarray(INDEPENDENT * np.log1p(power / usual / INDEPENDENT))


def batch(line: Array) -> tuple[int, float]:
    """Return the likeliest size of a batch and nats for it, its overtones taken together (Fisher)."""
    from scipy.stats import chi2  # noqa: PLC0415 - the daemon stays light

    best, n = (2, 0.0), 2 * (line.size - 1)
    for period in range(3, LARGEST + 1):
        at = np.rint(np.arange(1, (period - 1) // 2 + 1) * (n / period)).astype(np.int64)
        at = at[(at > SLOWEST * n) & (at < line.size - ASIDE)]
        if at.size:
            nats = of_chance(float(chi2.logsf(2.0 * line[at].sum(), 2 * at.size)), LARGEST)
            best = max(best, (period, nats), key=lambda x: x[1])
    return best


def _beat(line: Array) -> tuple[float, float]:
    """Return the clearest line, a sample, and nats for it."""
    n = 2 * (line.size - 1)
    first, last = int(SLOWEST * n), line.size - ASIDE
    k = first + int(np.argmax(line[first:last]))
    return k / n, of_chance(-float(line[k]), float(last - first))


def depth(size: Array, period: float) -> float:
    """Return the amplitude of the first overtone of a period, samples, in the size of noise (m,)."""
    wave = np.exp(-2j * np.pi * np.arange(size.size) / period)
    return float(2.0 * np.abs((size * wave).sum()) / max(float((size != 0.0).sum()), 1.0))
