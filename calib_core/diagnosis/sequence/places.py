"""Noise that follows the count of the samples: other noise at some place of every batch, or at a steady beat.

A batch of n samples, as a FIFO or a bus delivers it, gives the size of the noise a line at n samples and its
overtones; a sensor that is resampled by interpolation gives it one at the difference of the rates. Lines are
held against the spectrum about them, which is the null: periods of this recording that are not quite those.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Index,
    direct_finding,
    of_chance,
    sized,
)
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Where
from stillcal.calib_core.diagnosis.noise.lines.line_spectrum import ASIDE, OWN, lines
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.sequence.neighbours import LEAST_SPREAD, REACH, residual, spread
from stillcal.calib_core.diagnosis.sequence.spectrum import (
    without_bands,
    without_lines,
    without_sines,
)
from stillcal.calib_core.maths.chi_squared import log_tail
from stillcal.calib_core.streams.samples import Samples

DRIVER = "count of the samples"
NO_MOTION = "as no motion makes it"
IN_STEP = "as motion makes it only if it keeps in step with the samples"

FEW = 3
"""Overtones of a batch that as many vibrations may be, which simulators easily make at whole Hz."""

LARGEST = 64
"""Samples in a batch, at most."""

SLOWEST = 0.02
"""Lines a sample below which what changes is the phone's surroundings."""

FARTHEST = 4.0
"""Spreads at which the size of a residual is held."""

BURST = 1.0 / 32.0
"""Frequencies, a sample, on either side of a tone's that its bursts take: of 32 samples and more."""

LOUD = 2.0
"""Times the power of the quietest tenth from which `LARGEST` samples are not noise alone, which is a quarter
below the mean by chance."""

LEAST_SAMPLES = 1000
MOST_HELD = 0.01
"""Part of the samples at rest that may repeat the one before on all axes, beyond chance.

Where values are held, residuals are as regular as a driver holds them."""


@dataclass(frozen=True, eq=False)
class Noise:
    """What neighbours leave of each sample, in spreads; nothing where the phone moved.

    rest: (m,), where the phone lay; values, plain: (m, 3), `plain` without vibrations; vibrations: (k,) their
    frequencies, a sample.
    """

    rest: NDArray[np.bool_]
    values: Array
    plain: Array
    vibrations: Array

    @classmethod
    def of(cls, xyz: Array, still: NDArray[np.bool_], known: Sequence[float] = ()) -> Noise | None:
        """Return the noise of values (n, 3), m = n - 4 of them; None where rests do not show it.

        known: frequencies, a sample, of vibrations that were found.
        """
        rest = still[REACH:-REACH]
        if rest.sum() < LEAST_SAMPLES:
            return None
        same = np.diff(xyz, axis=0)[still[1:]] == 0.0
        held = float(same.all(axis=1).mean() - same.mean(axis=0).prod())
        left = np.where(rest[:, None], residual(xyz), 0.0)
        unit = spread(left[rest])
        if held > MOST_HELD or (unit <= LEAST_SPREAD).any():
            return None
        plain, vibrations = without_sines(left, rest, known)
        return cls(rest, left / unit, plain / spread(plain[rest]), vibrations)

    @cached_property
    def hushed(self) -> Array:
        """The same as `plain`, its lines cut."""
        return without_lines(self.plain)

    @cached_property
    def size(self) -> Array:
        """The size (m,) of all axes, less its mean, without vibrations."""
        return _size(self.hushed, self.rest)

    @cached_property
    def calm(self) -> NDArray[np.bool_]:
        """Where (m,) noise is no louder than where it is quiet: a burst of a vibration is, no batch is."""
        from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

        power = np.minimum(np.abs(self.hushed), FARTHEST) ** 2
        there = np.maximum(uniform_filter1d(self.rest.astype(np.float64), LARGEST), 1.0 / LARGEST)
        near = uniform_filter1d(power, LARGEST, axis=0) / there[:, None]
        quiet = near < LOUD * np.quantile(near[self.rest], 0.1, axis=0)
        return np.asarray(self.rest & quiet.all(axis=1))

    def lines_of_size(self) -> Array:
        """Return the lines of the size of calm noise."""
        return lines(_size(self.hushed, self.calm))

    def lines_of_size_without_tone(self, beat: float) -> Array:
        """Return the same without frequencies at which a tone would give the size this beat.

        The square of a sine has twice its frequency, of which samples tell no more than what is left of whole
        turns. Noise that is larger at some samples is so at all frequencies.
        """
        bare = without_bands(self.hushed, (beat / 2.0, 0.5 - beat / 2.0), BURST)
        return lines(_size(bare, self.calm))

    def lines_of_values(self) -> list[Array]:
        """Return the lines of calm values, by axis, without what vibrations leak elsewhere."""
        out = []
        for values, plain in zip(self.values.T, self.plain.T, strict=True):
            every = lines(np.clip(values, -FARTHEST, FARTHEST))
            bare = lines(np.where(self.calm, np.clip(plain, -FARTHEST, FARTHEST), 0.0))
            for frequency in self.vibrations:
                k = round(frequency * 2 * (every.size - 1))
                bare[k - OWN : k + OWN + 1] = every[k - OWN : k + OWN + 1]
            out.append(bare)
        return out


def _size(values: Array, used: NDArray[np.bool_]) -> Array:
    """Return the size (m,) of values (m, 3) of all axes, less its mean, nothing where they are not used."""
    if not used.any():
        return np.zeros(len(values))
    size = np.minimum(np.abs(values), FARTHEST).mean(axis=1)
    return np.where(used, size - size[used].mean(), 0.0)


def by_count(samples: Samples, sensor: str, noise: Noise) -> Finding | None:
    """Find noise at rest that follows the count of the samples, by its size or by its values."""
    size = noise.lines_of_size()
    period, batched = batch([size], tones=1)
    beat, single = _beat(size, noise)
    other, offset = batch(noise.lines_of_values(), tones=max(len(noise.vibrations), 1))
    half = 0.5 / max(sample_period(samples.t), 1e-9)
    nats, length, say, why = max(
        (
            batched,
            float(period),
            f"size of the {NAME[sensor]}'s noise at rest is another at one place of every",
            NO_MOTION,
        ),
        (
            single,
            1.0 / beat,
            f"size of the {NAME[sensor]}'s noise at rest goes up and down in every",
            NO_MOTION,
        ),
        (
            offset,
            float(other),
            f"{NAME[sensor]}'s mean at rest is another at some places of every",
            _or_vibrations(other, 2.0 * half),
        ),
    )
    told = f"The {say} {length:.4g} samples, {why}."
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, half), DRIVER)
    sizes = sized({"period_samples": (length, "samples")})
    seen = DirectEvidence(nats - float(np.log(3.0)))
    return direct_finding("unknown", sensor, [0, 1, 2], where, sizes, statement=told, seen=seen)


def _or_vibrations(size: int, rate: float) -> str:
    """Say what else makes the mean go with the places in a batch, at a rate in Hz."""
    overtones = [f"{rate * k / size:.4g}" for k in range(1, (size - 1) // 2 + 1)]
    if len(overtones) > FEW:
        return IN_STEP
    listed = " and ".join(filter(None, [", ".join(overtones[:-1]), *overtones[-1:]]))
    return f"or the phone vibrates at {listed} Hz"


def batch(series: Sequence[Array], *, tones: int = 0) -> tuple[int, float]:
    """Return the likeliest size of a batch and nats for it, all its overtones taken together (Fisher).

    series: of lines, as `lines` has them. tones: how many lines a series may have by itself, which are no
    batch: a weak vibration gives values one, and their size one at twice its frequency. So many of the
    clearest of each are then left out, a third of all at most, and two at least must be left.
    """
    best = (2, 0.0)
    for period in range(3, LARGEST + 1):
        at = _overtones(series[0], period)
        left = at.size - min(tones, max(at.size // 3, 1))
        count = len(series) * left
        if left > (1 if tones else 0):
            told = sum(float(np.sort(line[at])[:left].sum()) for line in series)
            nats = of_chance(float(log_tail(2.0 * told, 2 * count)), LARGEST)
            best = max(best, (period, nats), key=lambda x: x[1])
    return _least(series, best[0]), best[1]


def _overtones(line: Array, period: int) -> Index:
    """Return the places of a batch's overtones in lines, those that are sought."""
    n = 2 * (line.size - 1)
    at = np.rint(np.arange(1, (period - 1) // 2 + 1) * (n / period)).astype(np.int64)
    return np.asarray(at[(at > SLOWEST * n) & (at < line.size - ASIDE)])


def _least(series: Sequence[Array], period: int) -> int:
    """Return the least size of a batch whose overtones are all that is there of those of `period`.

    Of one of five samples two overtones are sought, of which one may be a vibration; of ten there are four.
    """
    every = _overtones(series[0], period)
    for least in (size for size in range(3, period // 2 + 1) if period % size == 0):
        others = np.setdiff1d(every, _overtones(series[0], least))
        told = sum(float(line[others].sum()) for line in series)
        by_chance = float(log_tail(2.0 * told, 2 * len(series) * others.size))
        if of_chance(by_chance, LARGEST) < 0.0:
            return least
    return period


def _beat(line: Array, noise: Noise) -> tuple[float, float]:
    """Return the clearest line of the size, a sample, and nats for it, without what a tone may make."""
    n = 2 * (line.size - 1)
    first, last = int(SLOWEST * n), line.size - ASIDE
    k = first + int(np.argmax(line[first:last]))
    told = min(float(line[k]), float(noise.lines_of_size_without_tone(k / n)[k]))
    return k / n, of_chance(-told, float(last - first))
