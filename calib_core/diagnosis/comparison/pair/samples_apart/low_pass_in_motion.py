"""A low-pass that one of two sensors on one motion has and the other has not, as their motion shows it.

Noise tells a low-pass only where it passes it. What both read of a motion is alike but for their responses.
So the part of each frequency that comes through is known, whatever the noise is (Bendat and Piersol, Random
Data, 4th ed. 2010, chapter 6: the response of a system by cross-spectra).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import LOW_PASS, cutoff_quantity, of_one_alone
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.vibrations import IN_MOTION, sample_by_sample
from stillcal.calib_core.diagnosis.comparison.quantity import Key, Quantity
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.diagnosis.model.settings import BANDWIDTH_LIMIT, CERTAIN_NATS
from stillcal.calib_core.diagnosis.noise.filter_kinds import kinds_of
from stillcal.calib_core.diagnosis.noise.low_pass import SHARED
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.streams.samples import Samples

STRETCH, LEAST_SAMPLES, EVEN = 2.56, 64, 0.05
"""s of a stretch, the least samples of one, and the part of its length by which these may take longer."""

PARTS, LEAST_WINDOWS = 8, 16
"""Parts of a recording that errors are taken from, and stretches that are needed."""

CLEAR = 10.0
"""Times the noise that motion must have at a frequency to tell what comes through."""

COHERENT = 0.8
"""Part of the power at a frequency that both must have in common: what one alone reads tells no filter."""

LEAST_FREQUENCIES = 16
SMOOTHED = 9
"""Frequencies that are needed, and that the noise of a spectrum is the mean of."""

FALLS, FITS = 0.8, 0.05
"""Part of the amplitude that is left at most where a low-pass is told, and how far a part may be off it."""

ALIKE = 0.01
"""Error of a part that comes through besides chance: readings are linear to about so much."""

CUTOFFS, WIDEST = 160, 0.45
"""Cutoffs that are tried, and the highest of them and of the frequencies, in parts of the rate."""

LEAST_NATS = 12.0
"""Nats for a low-pass beside none: among all that is compared, and among all cutoffs and kinds."""


@dataclass(frozen=True, slots=True)
class Followed:
    """A low-pass of one of two sensors. of_first: whether it is the first's; cutoff: Hz."""

    of_first: bool
    cutoff: Measured
    order: int


@dataclass(frozen=True, slots=True, eq=False)
class _Spectra:
    """Cross-spectrum and powers (P, F) of two sensors, a row for each part of the recording; f: (F,) Hz."""

    f: Array
    cross: NDArray[np.complex128]
    first: Array
    second: Array


def with_low_passes_in_motion(
    sides: Sequence[Mapping[Key, Quantity]], exams: tuple[Examination, Examination], sought: Collection[str]
) -> list[dict[Key, Quantity]]:
    """Return what two recordings of one motion show of noise, with the low-passes that motion shows.

    sought: the sensors that are asked for. Where noise shows that they differ, or that both are filtered, it
    is asked alone: it shows each by itself.
    """
    out = [dict(side) for side in sides]
    for sensor, (first, second) in _shared(exams).items():
        key = (LOW_PASS, sensor)
        asked = sensor in sought and not _by_noise([side.get(key) for side in out])
        found = low_pass_in_motion(first, second) if asked else None
        if found is None:
            continue
        rate = 1.0 / sample_period(first.t)
        where = Where(float(first.t[0]), float(first.t[-1]), (0.0, rate / 2.0), IN_MOTION)
        cutoff = Measured(float(np.log(found.cutoff.value)), found.cutoff.error / found.cutoff.value)
        none = Measured(float(np.log(rate / 2.0)), ALIKE)
        for side, has in zip(out, (found.of_first, not found.of_first), strict=True):
            side[key] = cutoff_quantity(sensor, where, cutoff if has else none, found.order if has else None)
    return out


def _by_noise(known: Sequence[Quantity | None]) -> bool:
    """Whether the noise of both tells their low-passes: that they differ, or that both are filtered."""
    nats = of_one_alone(known)
    return all(q is not None and not q.none for q in known) if nats is None else nats > CERTAIN_NATS


def _shared(exams: tuple[Examination, Examination]) -> dict[str, tuple[Samples, Samples]]:
    """Return the samples of both by sensor, of those that neither holds many of."""
    held = {s.sensor for exam in exams for s in exam.streams if s.repeats_many}
    return {sensor: both for sensor, both in sample_by_sample(exams).items() if sensor not in held}


def low_pass_in_motion(first: Samples, second: Samples) -> Followed | None:
    """Return the low-pass that one of two sensors has and the other has not, as their common motion shows it.

    None where neither has one or the motion has too little above its cutoff. The stamps have to be the same.
    """
    seen = _spectra(first, second)
    if seen is None:
        return None
    rate = 1.0 / sample_period(first.t)
    found = [_filtered(seen, rate, of_first=of_first) for of_first in (True, False)]
    told = [(nats, one) for nats, one in filter(None, found) if nats > LEAST_NATS]
    return max(told, key=lambda pair: pair[0])[1] if told else None


def _spectra(first: Samples, second: Samples) -> _Spectra | None:
    """Return the spectra of stretches without a gap; None where these are few."""
    period = sample_period(first.t)
    size = max(round(STRETCH / period), LEAST_SAMPLES)
    starts = np.arange(0, len(first) - size + 1, size // 2)
    length = first.t[starts + size - 1] - first.t[starts] if starts.size else np.zeros(0)
    starts = starts[np.abs(length - (size - 1) * period) < EVEN * size * period]
    if starts.size < LEAST_WINDOWS:
        return None
    rows = starts[:, None] + np.arange(size)
    window = np.hanning(size + 1)[:size, None]
    both = []
    for samples in (first, second):
        cut = samples.xyz[rows]
        both.append(np.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * window, axis=1))
    one, other = both
    part = np.arange(starts.size) * PARTS // starts.size

    def summed(products: NDArray[Any]) -> NDArray[Any]:
        of_all_axes = products.sum(axis=2)
        return np.array([of_all_axes[part == k].sum(axis=0) for k in range(PARTS)])

    f = np.asarray(np.fft.rfftfreq(size, period), dtype=np.float64)
    return _Spectra(f, summed(one * other.conj()), summed(np.abs(one) ** 2), summed(np.abs(other) ** 2))


def _filtered(seen: _Spectra, rate: float, *, of_first: bool) -> tuple[float, Followed] | None:
    """Return the low-pass of one sensor against the other, with the nats for it; None where there is none."""
    power = seen.second if of_first else seen.first
    whole = power.sum(axis=0)
    noise = float(np.convolve(whole[1:], np.ones(SMOOTHED) / SMOOTHED, "valid").min())
    both = seen.first.sum(axis=0) * seen.second.sum(axis=0)
    coherent = np.abs(seen.cross.sum(axis=0)) ** 2 > COHERENT * both
    clear = (whole > (1.0 + CLEAR) * noise) & coherent
    used = clear & (seen.f > 2.0 * seen.f[1]) & (seen.f < WIDEST * rate)
    if used.sum() < LEAST_FREQUENCIES:
        return None
    through, error = _through(seen.cross[:, used], power[:, used], noise)
    weight = 1.0 / (error**2 + ALIKE**2)
    flat = _misfit(through, weight, np.ones((1, through.size)))[0]
    cutoffs = np.geomspace(seen.f[used][0], WIDEST * rate, CUTOFFS)
    kinds = kinds_of(seen.f[used], cutoffs, rate)
    fits = [(kind, _misfit(through, weight, np.sqrt(kind.shapes))) for kind in kinds]
    common = [fit for fit in fits if fit[0].common]
    least = min(float(misfit.min()) for _, misfit in fits)
    usual = min(float(misfit.min()) for _, misfit in common)
    scale = max(least / max(through.size - 3, 1), 1.0) * SHARED
    kind, misfit = min(common if usual - least < 4.0 * scale else fits, key=lambda fit: fit[1].min())
    k = int(np.argmin(misfit))
    cutoff, shape = float(cutoffs[k]), np.sqrt(kind.shapes[k])
    gain = float((weight * through * shape).sum() / (weight * shape**2).sum())
    off = float(np.sqrt(np.average((through / gain - shape) ** 2, weights=weight)))
    inside = k > 0 and cutoff < BANDWIDTH_LIMIT * rate and float(shape.min()) < FALLS
    if not inside or off > FITS:
        return None
    near = cutoffs[misfit - misfit[k] < 4.0 * scale]
    measured = Measured(cutoff, max(float(np.ptp(near)) / 4.0, FITS / 2.0 * cutoff))
    return 0.5 * (flat - misfit[k]) / scale, Followed(of_first, measured, kind.order)


def _through(cross: NDArray[np.complex128], power: Array, noise: float) -> tuple[Array, Array]:
    """Return the part (F,) of the amplitude that comes through, and its error by leaving out rows."""
    n, whole, below = len(cross), cross.sum(axis=0), power.sum(axis=0)
    left = np.abs(whole - cross) / (below - power - (n - 1) / n * noise)
    error = np.sqrt((n - 1) / n * ((left - left.mean(axis=0)) ** 2).sum(axis=0))
    return np.abs(whole) / (below - noise), error


def _misfit(through: Array, weight: Array, shapes: Array) -> Array:
    """Return chi-squared (C,) of shapes (C, F) of amplitude, each times the gain that fits best."""
    both, own = (weight * through * shapes).sum(axis=1), (weight * shapes**2).sum(axis=1)
    return np.asarray((weight * through**2).sum() - both**2 / own)
