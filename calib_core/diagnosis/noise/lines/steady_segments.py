"""Steady stretches of a recording, and their spectra above those of their neighbourhood.

Samples stand in their places on the grid of the stamps; places that are empty weigh nothing. Closed up, they
would shift the phase of every line, gap by gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import Index
from stillcal.calib_core.diagnosis.noise.lines.even_stamps import evened
from stillcal.calib_core.streams.samples import Samples

STEADY = {"accel": 0.1, "gyro": 0.03}
NEIGHBOURS, OWN = 34, 7
INDEPENDENT = NEIGHBOURS / 1.5
"""Of the neighbours: powers under half a sine are correlated by 1/4 one line apart, by nothing further."""

SHORTER = 0.92
"""Each length that is tried where a longer one finds no room is so much of that before."""

LEAST_SAMPLES = 100

AT_ONCE = 200_000
"""Numbers that are worked on at once: a day's spectra, all at once, take as much memory as the day."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """Steady stretches, overlapping by half; a rest too short for the longest is one as long as it holds.

    t: (S, n) s, from each one's middle; taper: (S, n), half a sine of its own length, zeros after it and
    where a sample is missing; tapered: (S, n, 3), no means, under it; length: (S,) places; whole: s, first
    and last of the recording, span: (S, 2), of each; share: (S,), what of each the next does not hold;
    to_amplitude: (S,), what makes amplitudes of sums of tapered values; f: (F,) Hz; free: (F,), where no
    known line is; power: (S, F, 3).
    """

    t: Array
    taper: Array
    tapered: Array
    length: Index
    whole: tuple[float, float]
    span: Array
    share: Array
    to_amplitude: Array
    f: Array
    free: NDArray[np.bool_]
    power: Array

    @property
    def wider(self) -> Array:
        """How many of the frequencies `f` lie between two that a stretch of its length tells apart, (S,)."""
        return np.asarray(self.tapered.shape[1] / self.length, dtype=np.float64)

    @property
    def rate(self) -> float:
        """The sample rate, Hz: of stretches of odd length no frequency is half of it."""
        return float(self.f[1] * self.tapered.shape[1])

    def ratio(self) -> Array:
        """Return the ratio (S, F, 3) of the power to the mean of the free ones of its neighbours."""
        return _ratios(self.power, self.wider, self.free)

    def rests(self) -> tuple[Array, Array]:
        """Return when (R,) rests begin and end, s: stretches that overlap are of one."""
        reached = np.maximum.accumulate(self.span[:, 1])
        begins = np.concatenate([[0], np.flatnonzero(self.span[1:, 0] > reached[:-1]) + 1])
        return self.span[begins, 0], reached[np.append(begins[1:], reached.size) - 1]

    def only(self, rows: Index) -> Stretches:
        """Return some of them."""
        return replace(
            self,
            t=self.t[rows],
            taper=self.taper[rows],
            tapered=self.tapered[rows],
            length=self.length[rows],
            span=self.span[rows],
            share=self.share[rows],
            to_amplitude=self.to_amplitude[rows],
            power=self.power[rows],
        )

    def without(self, frequency: float, half: float) -> Stretches:
        """Return them without the line at a frequency, Hz: a sine fitted to each is taken off.

        What is within `half` Hz of it is no more free: a sine leaves less there than noise.
        """
        phase = 2.0 * np.pi * frequency * self.t
        sine = np.stack([np.cos(phase), np.sin(phase)], axis=1) * self.taper[:, None]
        own, across = sine @ np.swapaxes(sine, 1, 2), sine @ self.tapered
        tapered = self.tapered - np.swapaxes(sine, 1, 2) @ np.linalg.solve(own, across)
        free = self.free & (np.abs(self.f - frequency) > half)
        return replace(self, tapered=tapered, free=free, power=_powers(tapered))


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Samples on the grid of their stamps, `period` s apart.

    t: (N,) s; xyz: (N, 3), interpolated where not `there` (N,).
    """

    period: float
    t: Array
    xyz: Array
    there: NDArray[np.bool_]

    @classmethod
    def of(cls, samples: Samples) -> Places | None:
        """Put samples in their places; None where they are too few for any stretches."""
        if len(samples) < 3 * LEAST_SAMPLES:
            return None
        period, place, stamps = evened(samples.t)
        every = np.arange(place[-1] + 1)
        there = np.zeros(every.size, dtype=np.bool_)
        there[place] = True
        xyz = np.stack([np.interp(every, place, axis) for axis in samples.xyz.T], axis=1)
        t = np.interp(every, place, stamps)
        return cls(period, t, xyz, there)


def stretches(
    places: Places | None, sensor: str, seconds: float, least: float | None = None
) -> Stretches | None:
    """Return the steady stretches of one sensor, or None where there are fewer than three.

    They are `seconds` long, and down to `least` (s) where there is no room for longer ones.
    """
    if places is None:
        return None
    rate = 1.0 / places.period
    longest, shortest = int(seconds * rate), int((least or seconds) * rate)
    if shortest < LEAST_SAMPLES or places.there.sum() < 3 * shortest:
        return None
    first, length = _steady(places.xyz, max(round(rate), 1), longest, shortest, STEADY[sensor])
    span = np.stack([places.t[first], places.t[first + length - 1]], axis=1)
    whole = span[:, 1] - span[:, 0] < 1.2 * length / rate
    first, length, span = first[whole], length[whole], span[whole]
    if first.size < 3:
        return None
    t, taper, tapered = _tapered(places, first, length, longest)
    f = np.asarray(np.fft.rfftfreq(longest, 1.0 / rate), dtype=np.float64)
    share = np.minimum(np.append(np.diff(first), longest) / length, 1.0)
    free = np.ones(f.size, dtype=np.bool_)
    whole_span = float(places.t[0]), float(places.t[-1])
    return Stretches(
        t, taper, tapered, length, whole_span, span, share, 2.0 / taper.sum(axis=1), f, free, _powers(tapered)
    )


def _steady(xyz: Array, second: int, longest: int, shortest: int, most: float) -> tuple[Index, Index]:
    """Return first rows and lengths of stretches whose means over a second stay where they are.

    They are rests, shaken or not; each begins half way through the one before, where a taper has given
    half of its weight, or as the phone comes to rest.
    """
    count = len(xyz) // second
    means = xyz[: count * second].reshape(count, second, 3).mean(axis=1)
    taken, placed = np.zeros(len(xyz), dtype=np.bool_), []
    for length in _lengths(longest, shortest):
        starts = _starts(means, second, length, most, taken)
        for start in starts:
            taken[start : start + length] = True
        placed += [(start, length) for start in starts]
    ordered = np.array(sorted(placed), dtype=np.int64).reshape(-1, 2)
    return ordered[:, 0], ordered[:, 1]


def _lengths(longest: int, shortest: int) -> list[int]:
    """Return the lengths to try, longest first."""
    lengths = [longest]
    while lengths[-1] > shortest:
        lengths.append(max(int(SHORTER * lengths[-1]), shortest))
    return lengths


def _starts(means: Array, second: int, length: int, most: float, taken: NDArray[np.bool_]) -> list[int]:
    """Return where stretches of one length begin; taken: (N,), which rows longer ones hold."""
    span = max(length // second, 1)
    if span > len(means):
        return []
    still = _range(means, span).max(axis=1) < most
    still = still[: max((taken.size - length) // second + 1, 0)]
    before = np.concatenate([[0], np.cumsum(taken)])
    begins = np.flatnonzero(still) * second
    begins = begins[before[begins + length] == before[begins]]
    starts, next_one = [], 0
    for begin in begins:
        if begin >= next_one:
            starts.append(int(begin))
            next_one = starts[-1] + length // 2
    return starts


def _range(values: Array, span: int) -> Array:
    """Return the range (n - span + 1, k) of every `span` successive rows of values (n, k)."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # noqa: PLC0415 - the daemon stays light

    first = -(span // 2)  # the filter's window then begins at each row
    high = maximum_filter1d(values, span, axis=0, origin=first)
    low = minimum_filter1d(values, span, axis=0, origin=first)
    return np.asarray((high - low)[: len(values) - span + 1])


def _taper(n: int) -> Array:
    """Return half a sine (n,), a window that wastes little of a short rest."""
    return np.asarray(np.sin(np.pi * (np.arange(n) + 0.5) / n))


def _tapered(places: Places, first: Index, length: Index, longest: int) -> tuple[Array, Array, Array]:
    """Return times about each one's middle, its taper, (S, n) both, and tapered values (S, n, 3).

    The taper is zero after its end and where a sample is missing.
    """
    t, taper = np.zeros((first.size, longest)), np.zeros((first.size, longest))
    values = np.zeros((first.size, longest, 3))
    for i, (a, n) in enumerate(zip(first, length, strict=True)):
        own = places.xyz[a : a + n]
        taper[i, :n] = _taper(n) * places.there[a : a + n]
        t[i, :n] = places.t[a : a + n] - places.t[a : a + n].mean()
        values[i, :n] = (own - own.mean(axis=0)) * taper[i, :n, None]
    return t, taper, values


def _powers(tapered: Array) -> Array:
    """Return the powers (S, F, 3) of tapered values (S, n, 3)."""
    power = np.empty((len(tapered), tapered.shape[1] // 2 + 1, tapered.shape[2]))
    for rows in _few_rows(np.arange(len(tapered)), tapered[0].size):
        spectrum = np.fft.rfft(tapered[rows], axis=1)
        power[rows] = spectrum.real**2 + spectrum.imag**2
    return power


def _few_rows(rows: Index, size: int) -> Iterator[Index]:
    """Cut rows (S,) of `size` values each into parts that need little memory."""
    count = max(AT_ONCE // size, 1)
    return (rows[first : first + count] for first in range(0, rows.size, count))


def _ratios(power: Array, wider: Array, free: NDArray[np.bool_]) -> Array:
    """Return ratios (S, F, 3) of powers to the mean of `NEIGHBOURS` lines, a line's own apart.

    free: (F,), which lines count among the neighbours.
    """
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    ratio, counted = np.empty_like(power), free[None, :, None].astype(np.float64)
    for width in np.unique(wider):
        all_of, own = (2 * round(width * (n // 2)) + 1 for n in (NEIGHBOURS + OWN, OWN))

        def around(values: Array, all_of: int = all_of, own: int = own) -> Array:
            wide, near = (n * uniform_filter1d(values, n, axis=1) for n in (all_of, own))
            return np.asarray(wide - near)

        number = np.maximum(around(counted), 1.0)
        for rows in _few_rows(np.flatnonzero(wider == width), power[0].size):
            mine = power[rows]
            floor = 1e-6 * mine.mean(axis=1, keepdims=True)
            background = np.maximum(around(mine * counted) / number, floor)
            ratio[rows] = mine / np.maximum(background, 1e-300)
    return ratio
