"""A faint line that keeps its phase from the first rest to the last: all rests and axes together show it.

Stretches by themselves tell a line by its power, of which most is noise. What keeps its phase through the
whole recording stands out of the spectrum of all rests as one series, nothing between them. A fan wanders too
much for that, and so does every body: hearts and hands are no such lines at any frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import blocks
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, HeldOut, Index, of_chance
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.intermittent_line import SILENT
from stillcal.calib_core.diagnosis.noise.lines.line_estimate import (
    CLOCK,
    IN_STEP,
    SIGNIFICANT,
    axes_alike,
    of_axes,
    peak,
    vibration,
)
from stillcal.calib_core.diagnosis.noise.lines.line_spectrum import ASIDE, FAR_ASIDE, OWN, ZEROS, faint_lines
from stillcal.calib_core.diagnosis.noise.lines.steady_segments import Places, Stretches
from stillcal.calib_core.diagnosis.stamps.timestamps import LONGEST_GAP
from stillcal.calib_core.maths.rms import rms

NEVER = 0.49
"""Part of the sample rate above which no line is told from its alias."""

FINE = 0.1
"""Steps of the frequency's fit, in what the whole recording tells apart."""

LOUDEST = 2.0
"""Times the median size of a stretch's sum from which one counts for no more."""

MOST_PASSED = 4
"""Frequencies that are looked at for a line, for time: what few stretches have is passed over."""

EDGE = 0.025
"""Weight of all tapers together, below which a rest begins or ends: one second of 20, as hands let go."""


@dataclass(frozen=True, slots=True, eq=False)
class CoherentSpectrum:
    """The spectrum of all rests as one series: lines that keep their phase stand out of it.

    told: (F, 3) nats of lines, by chance exponential; f: (F,) Hz.
    """

    seen: Stretches
    rests: _Rests
    told: Array
    f: Array

    @classmethod
    def of(cls, places: Places, seen: Stretches) -> CoherentSpectrum:
        """Transform the stretches of these places."""
        rests = _Rests.of(places, seen)
        told = np.stack([faint_lines(axis, rests.recorded) for axis in rests.series.T], axis=1)
        return cls(seen, rests, told, np.linspace(0.0, rests.rate / 2.0, len(told)))

    def clearest(self, sensor: str, between: tuple[float, float], known: Sequence[float]) -> Finding | None:
        """Find the clearest line; None where chance makes one as clear.

        known: Hz, lines that the stretches are without, near which none is sought; between: Hz, outside which
        none is.
        """
        f, own, edge = self.f, OWN * float(self.seen.f[1]), round(ZEROS * ASIDE / self.rests.recorded)
        free = (f > between[0]) & (f < min(between[1], NEVER * self.rests.rate))
        for frequency in known:
            free &= np.abs(f - frequency) > own
        free[:edge] = free[-edge:] = False
        for _ in range(MOST_PASSED):
            at = np.flatnonzero(free)
            if not at.size:
                return None
            tries = float(at.size * (self.told.shape[1] + 1))
            best = of_axes(self.told[None, at])
            if not DirectEvidence(of_chance(-float(best.max()), tries)).stated:
                return None
            k = int(at[np.argmax(best)])
            nats = float(of_axes(self.told[None, [k]], axes_alike=axes_alike(self.told[self._beside(k)]))[0])
            line = _stated(sensor, self.rests, self.seen, float(f[k]), (nats, tries))
            if line is not None:
                return line
            free &= np.abs(f - f[k]) > own
        return None

    def _beside(self, k: int) -> Index:
        """Return the wide neighbourhood of a frequency, by index."""
        own, far = (round(ZEROS * n / self.rests.recorded) for n in (OWN, FAR_ASIDE + OWN))
        away = np.arange(own + 1, far + 1)
        return np.asarray(np.clip(k + np.concatenate([-away, away]), 0, len(self.told) - 1), dtype=np.int64)

    def in_step(self, line: Finding) -> bool:
        """Whether a line of this spectrum keeps its phase, so that this foretells `IN_STEP` of its power.

        What noise adds to its power is within two standard deviations.
        """
        frequency = float(np.asarray(line.parameters["frequency"].value))
        power = np.abs(self.rests.sums(self.seen, frequency)) ** 2 / self.rests.of_sums(self.seen)
        above, by_chance = float((power - 1.0).sum()), 2.0 * float(np.sqrt(power.size))
        foretold = line.evidence.heldout_log_score_gain or 0.0
        return foretold + by_chance >= IN_STEP * max(above, by_chance)


@dataclass(frozen=True, slots=True, eq=False)
class _Rests:
    """All stretches in their places as one series, each weighed by its noise.

    Each sample counts as one, shared by the stretches that hold it: under their tapers alone a rest no longer
    than one of them would count for half.

    rate: Hz; series: (N, 3); recorded: the part of it in stretches; first: (S,) rows where stretches begin;
    weight: (S, 3) of each one's values, the usual one 1; noise: (S, 3) variance of a sample; share: (S, n)
    what of a tapered value is its stretch's.
    """

    rate: float
    series: Array
    recorded: float
    first: Index
    weight: Array
    noise: Array
    share: Array

    @classmethod
    def of(cls, places: Places, seen: Stretches) -> _Rests:
        """Lay the stretches where they were recorded."""
        first = np.searchsorted(places.t, seen.span[:, 0])
        power = np.median(seen.power[:, 1:], axis=1) / np.log(2.0)
        least = max(SILENT * float(seen.power.max()), 1e-300)
        noise = np.maximum(power, least) / (seen.taper**2).sum(axis=1)[:, None]
        weight = np.median(noise, axis=0) / noise
        within = [slice(a, a + n) for a, n in zip(first, seen.length, strict=True)]
        cover, series, share = (
            np.zeros(places.t.size),
            np.zeros((places.t.size, 3)),
            np.zeros_like(seen.taper),
        )
        for row, at in enumerate(within):
            cover[at] += seen.taper[row, : seen.length[row]] ** 2
        for row, (at, n) in enumerate(zip(within, seen.length, strict=True)):
            share[row, :n] = seen.taper[row, :n] / np.maximum(cover[at], EDGE)
            series[at] += weight[row] * (share[row, :n, None] * seen.tapered[row, :n])
        steps = np.diff(places.t)
        inside = steps <= LONGEST_GAP * places.period
        rate = float(inside.sum() / steps[inside].sum())
        return cls(rate, series, float(np.mean(cover > EDGE)), first, weight, noise, share)

    def sums(self, seen: Stretches, frequency: float) -> Array:
        """Return the sums (S, 3) of each stretch's values, turned back by a frequency, Hz."""
        by_place = -2j * np.pi * frequency / self.rate
        turned = np.exp(by_place * np.arange(seen.tapered.shape[1]))
        there = np.einsum("n,sn,sna->sa", turned, self.share, seen.tapered)
        return np.asarray(np.exp(by_place * self.first)[:, None] * there)

    def of_sums(self, seen: Stretches) -> Array:
        """Return the variance (S, 3) that noise has in these sums."""
        return np.asarray(self.noise * ((self.share * seen.taper) ** 2).sum(axis=1)[:, None])

    def of_line(self, seen: Stretches) -> Array:
        """Return the sums (S, 1) of a line of amplitude 1."""
        return np.asarray((self.share * seen.taper).sum(axis=1)[:, None] / 2.0)


def _stated(
    sensor: str, rests: _Rests, seen: Stretches, near: float, chance: tuple[float, float]
) -> Finding | None:
    """State the line near a frequency, Hz; chance: nats that it tells, and how many were looked at."""
    step = rests.rate / len(rests.series)
    sums, middle = rests.sums(seen, near), seen.span.mean(axis=1)

    def whole(away: Array, of: Array) -> Array:
        turned = np.exp(-2j * np.pi * np.outer(away, middle - middle.mean()))
        return np.asarray(turned @ (rests.weight * of))

    grid = step * np.arange(-1.0, 1.0 + FINE, FINE)
    off = peak(grid, (np.abs(whole(grid, sums)) ** 2).sum(axis=1))
    length = (rests.weight * rests.of_line(seen)).sum(axis=0)
    line = whole(np.array([off]), sums)
    frequency, power = near + off, np.abs(line[0]) ** 2
    # Beside the line is the noise, once the line is gone: gaps between rests spread it over its neighbours.
    phases = np.exp(2j * np.pi * off * (middle - middle.mean()))
    left = sums - rests.of_line(seen) * phases[:, None] * line / length
    aside = np.arange(OWN + 1, OWN + ASIDE + 1) * step
    about = (np.abs(whole(off + np.concatenate([-aside, aside]), left)) ** 2).mean(axis=0)
    floor = np.maximum(about, max(SILENT * float(power.max()), 1e-300))
    amplitude, scatter = np.sqrt(np.maximum(power - floor, 0.0)) / length, np.sqrt(floor / 2.0) / length
    axes = [a for a in range(3) if amplitude[a] > SIGNIFICANT * scatter[a]] or [int(np.argmax(amplitude))]
    # Cramer and Rao's bound of a sine's frequency, by how far it stands above the noise.
    above = float(np.sqrt(2.0 * (power / floor).sum()))
    error = float(np.hypot(np.sqrt(6.0) * step / np.pi / above, CLOCK * frequency))
    sums, (told, tries) = rests.sums(seen, frequency), chance
    nats = of_chance(-told * _even(rests.weight * sums), tries)
    evidence = DirectEvidence(nats, _left_out(sums, rests, seen))
    pitch, size = (frequency, error), (amplitude, scatter)
    return vibration(sensor, seen, axes, pitch=pitch, size=size, span=seen.whole, evidence=evidence)


def _even(sums: Array) -> float:
    """Return the part of a line's power that stays if no stretch counts for more than `LOUDEST` usual ones.

    sums: (S, 3). Of noise that takes 2^-4 of its power (Rayleigh's law), which is given back. Where a strong
    vibration begins or ends, a stretch has power at all frequencies about it.
    """
    size = np.abs(sums)
    most = LOUDEST * np.median(size, axis=0)
    even = sums * np.minimum(1.0, most / np.maximum(size, 1e-300))
    power, whole = ((np.abs(x.sum(axis=0)) ** 2).sum() for x in (even, sums))
    return min(float(power / max(whole, 1e-300)) / (1.0 - float(2.0 ** -(LOUDEST**2))), 1.0)


def _left_out(sums: Array, rests: _Rests, seen: Stretches) -> HeldOut:
    """Predict the sums (S, 3) of stretches left out by the line that the others have."""
    length = rests.of_line(seen)
    noise = rests.of_sums(seen)
    fold, gain = blocks(len(sums)), 0.0
    before, after = [], []
    for k in np.unique(fold):
        train, test = fold != k, fold == k
        line = (sums * length / noise)[train].sum(axis=0) / (length**2 / noise)[train].sum(axis=0)
        left = np.abs(sums[test] - line * length[test])
        gain += float(((np.abs(sums[test]) ** 2 - left**2) / noise[test]).sum())
        before.append(rms(np.abs(sums[test]) / length[test]))
        after.append(rms(left / length[test]))
    return HeldOut(gain, rms(np.array(before)), rms(np.array(after)))
