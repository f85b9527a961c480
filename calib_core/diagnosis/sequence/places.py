"""Noise that follows the count of the samples: other noise at some place of every batch, or at a steady beat.

A batch of n samples, as a FIFO or a bus delivers it, gives the size of the noise a line at n samples and its
overtones; a sensor that is resampled by interpolation gives it one at the difference of the rates. Lines are
held against the spectrum about them, which is the null: periods of this recording that are not quite those.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
"""Part of the samples at rest that may repeat the one before on all axes, beyond chance.

Where values are held, residuals are as regular as a driver holds them."""


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """What neighbours leave of each sample at rest, nothing where the phone moved.

    size: (m,) of all axes, free of lines, less its mean; signed: (m, 3), in spreads, held at `FARTHEST`.
    """

    size: Array
    signed: Array

    @classmethod
    def of(cls, xyz: Array, still: NDArray[np.bool_]) -> Noise | None:
        """Return the noise of values (n, 3), m = n - 4 of them; None where rests do not show it."""
        rest = still[REACH:-REACH]
        if rest.sum() < LEAST_SAMPLES:
            return None
        same = np.diff(xyz, axis=0)[still[1:]] == 0.0
        held = float(same.all(axis=1).mean() - same.mean(axis=0).prod())
        left = residual(xyz)
        unit = spread(left[rest])
        if held > MOST_HELD or (unit <= LEAST_SPREAD).any():
            return None
        left = np.where(rest[:, None], left / unit, 0.0)
        size = np.minimum(np.abs(without_lines(left)), FARTHEST).mean(axis=1)
        return cls(np.where(rest, size - size[rest].mean(), 0.0), np.clip(left, -FARTHEST, FARTHEST))


def by_count(samples: Samples, sensor: str, noise: Noise) -> Finding | None:
    """Find noise at rest that follows the count of the samples, by its size or by its values."""
    size = lines(noise.size)
    period, batched = batch([size], tones=True)
    beat, single = _beat(size)
    other, offset = batch([lines(axis) for axis in noise.signed.T], tones=True)
    nats, length, say = max(
        (
            batched,
            float(period),
            f"size of the {NAME[sensor]}'s noise at rest is another at one place of every",
        ),
        (single, 1.0 / beat, f"size of the {NAME[sensor]}'s noise at rest goes up and down in every"),
        (offset, float(other), f"{NAME[sensor]}'s mean at rest is another at some places of every"),
    )
    told = f"The {say} {length:.4g} samples, as no motion makes it."
    half = 0.5 * len(samples) / max(float(samples.t[-1] - samples.t[0]), 1e-9)
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, half), DRIVER)
    sizes = sized({"period_samples": (length, "samples")})
    seen = Seen(nats - float(np.log(3.0)))
    return direct_finding("unknown", sensor, [0, 1, 2], where, sizes, statement=told, seen=seen)


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


def batch(series: Sequence[Array], *, tones: bool = False) -> tuple[int, float]:
    """Return the likeliest size of a batch and nats for it, all its overtones taken together (Fisher).

    series: of lines, as `lines` has them. tones: whether a series may have a line by itself, which is no
    batch: a weak vibration gives values one, and their size one at twice its frequency. The clearest of each
    is then left out, and two at least must be left.
    """
    from scipy.stats import chi2  # noqa: PLC0415 - the daemon stays light

    best, n = (2, 0.0), 2 * (series[0].size - 1)
    for period in range(3, LARGEST + 1):
        at = np.rint(np.arange(1, (period - 1) // 2 + 1) * (n / period)).astype(np.int64)
        at = at[(at > SLOWEST * n) & (at < series[0].size - ASIDE)]
        count = len(series) * (at.size - tones)
        if at.size > 2 * tones:
            told = sum(float(line[at].sum()) - tones * float(line[at].max()) for line in series)
            nats = of_chance(float(chi2.logsf(2.0 * told, 2 * count)), LARGEST)
            best = max(best, (period, nats), key=lambda x: x[1])
    return best


def _beat(line: Array) -> tuple[float, float]:
    """Return the clearest line, a sample, and nats for it."""
    n = 2 * (line.size - 1)
    first, last = int(SLOWEST * n), line.size - ASIDE
    k = first + int(np.argmax(line[first:last]))
    return k / n, of_chance(-float(line[k]), float(last - first))
