"""Whether a line is there all along, or comes and goes: the course of its power against a steady line's.

The amplitude of the line is read in short pieces, in units of the noise about it, which differs where the
device was touched. A steady line is in every piece, or in every one of its span and in none outside it. One
that comes and goes is in each piece with some probability. Everything else is the same in both models, and is
integrated out: the line's level, how much it scatters by itself, the level of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import blocks
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    HeldOut,
    Index,
    Measured,
    share_of,
    vector,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.noise.lines.line import COMES_AND_GOES, amplitude_of, middle_hz
from stillcal.calib_core.diagnosis.noise.lines.steady_segments import OWN, Stretches
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.maths.rms import rms

SPLITS = (1, 2, 4, 8)
"""Pieces of the middle half of a stretch: of 20 s, pieces of 10 to 1.25 s."""

MOST_ROWS = 200
"""Stretches that are looked at, of all and of those in the line's span, evenly spread, for time."""

SCATTERS = (0.05, 0.15, 0.3)
"""Relative standard deviation of a steady line's amplitude: fans and mains breathe."""

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
SCATTERED = (_NODES, _WEIGHTS / _WEIGHTS.sum())
"""Points and weights that stand for a normal distribution of mean 0 and variance 1 (Gauss and Hermite)."""

FLOORS = (0.5, 0.7, 1.0, 1.4)
"""Amplitude of the noise, in units of that of the line's neighbours, which may hold some of the line."""

LEVELS, PARTS = 20, 9
"""Grid points of the line's level, and of the part of the time in which it is there."""

SHARES = ((np.arange(PARTS) + 0.5) / PARTS)[:, None, None]
"""These parts of the time, (PARTS, 1, 1)."""

SMALL = 1e-9
"""Weight of grid points that tells nothing more."""

STRAY = 0.02
"""Part of the pieces in which anything may happen."""

STRAY_RANGE = float(np.log(1e6))
"""Its amplitudes: any of six decades."""

CELLS = 4096
"""Of the table that the Bessel function is read from: with cubic polynomials between, to 1e-13 of itself."""

BESIDE = 60
"""Frequencies on either side whose median power is the noise: of so many it is known to a tenth."""

LEAST_THERE = 0.9
"""Part of a piece that must have been recorded."""

SILENT = 1e-9
"""Part of a spectrum's largest power that counts as noise at least: simulations may have none."""


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """A line in n pieces. t: (n,) s, their middles; amplitude: (n,) over the noise of all three axes.

    power: (n, 3) squared amplitude of the sine on each axis, without the noise's; noise: (n, 3) its variance.
    """

    t: Array
    amplitude: Array
    power: Array
    noise: Array

    def louder(self) -> Array:
        """Return how far one and the same line stands above each piece's noise (n,), the median as one."""
        line = np.maximum(self.power.mean(axis=0), 0.0)
        above = np.sqrt((line / self.noise).sum(axis=1))
        middle = float(np.median(above))
        return above / middle if middle > 0.0 else np.ones(above.size)


def named_if_steady(line: Finding, seen: Stretches, others: Sequence[float]) -> Finding:
    """Take the name off a line that comes and goes: a steady sine in its place would be no correction.

    seen: the stretches that it was found in; others: Hz, the lines besides it.
    """
    frequency = middle_hz(line)
    within = (seen.span[:, 0] >= line.where.t_start) & (seen.span[:, 1] <= line.where.t_end)
    rows = np.union1d(_spread(np.arange(len(seen.length))), _spread(np.flatnonzero(within)))
    alone = seen.only(rows)
    for other in others:
        alone = alone.without(other, abs(other - frequency) / 2.0)
    edge = float(np.median(seen.span[:, 1] - seen.span[:, 0]))
    told = [_told(of_line, line.where, edge) for of_line in _pieces(alone, frequency) if of_line.t.size]
    if not told:
        return line
    best = max(told, key=lambda one: one.seen.log_bayes_factor)
    # The mean of Bayes factors: the data of one length of the pieces hold those of a longer one.
    nats = float(np.logaddexp.reduce([one.seen.log_bayes_factor for one in told]) - np.log(len(told)))
    if not replace(best.seen, log_bayes_factor=nats).stated:
        return line
    return _unsteady(line, best)


def _spread(rows: Index) -> Index:
    """Return at most `MOST_ROWS` of the rows, evenly spread."""
    few = np.linspace(0, max(rows.size - 1, 0), min(rows.size, MOST_ROWS)).round().astype(np.int64)
    return np.asarray(rows[few])


@dataclass(frozen=True, slots=True, eq=False)
class _Told:
    """What one length of pieces tells.

    seen: the evidence that the line comes and goes; share: part of the pieces in which it is there; span: s,
    the first and the last of these; amplitude, error: (3,) of the sine there.
    """

    seen: DirectEvidence
    share: Measured
    span: tuple[float, float]
    amplitude: Array
    error: Array


def _pieces(seen: Stretches, frequency: float) -> list[Pieces]:
    """Cut the middle half of every stretch into each number of parts and read the line's amplitude there.

    The halves lie end to end, as stretches overlap by half.
    """
    noise = _noise(seen, frequency)
    read: list[list[tuple[Array, ...]]] = [[] for _ in SPLITS]
    for row, n in enumerate(seen.length):
        middle = slice(n // 4, n // 4 + n // 2)
        t, taper = seen.t[row, middle], seen.taper[row, middle]
        there = taper > 0.0
        value = seen.tapered[row, middle] / np.where(there, taper, 1.0)[:, None]
        turned = value * np.exp(-2j * np.pi * frequency * t)[:, None]
        for parts, of_parts in zip(SPLITS, read, strict=True):
            of_parts.append(_parts(t + seen.span[row].mean(), there, turned, noise[row], parts))
    return [Pieces(*map(np.concatenate, zip(*of_parts, strict=True))) for of_parts in read]


def _noise(seen: Stretches, frequency: float) -> Array:
    """Return the noise (S, 3) of a sample, the median of the line's neighbours in its own stretch."""
    away = np.arange(OWN // 2 + 1, BESIDE)
    steps = np.round(seen.wider[:, None] * np.concatenate([-away, away])).astype(np.int64)
    near = round(frequency / float(seen.f[1])) + steps
    beyond = (near < 1) | (near > seen.f.size - 2)  # at low rates a line has fewer neighbours on one side
    of_row = seen.power[np.arange(len(near))[:, None], np.where(beyond, 0, near)]
    power = np.nanmedian(np.where(beyond[:, :, None], np.nan, of_row), axis=1) / np.log(2.0)
    least = SILENT * float(seen.power.max())
    return np.asarray(np.maximum(power, least) / (seen.taper**2).sum(axis=1)[:, None])


def _parts(
    t: Array, there: NDArray[np.bool_], turned: Array, noise: Array, parts: int
) -> tuple[Array, Array, Array, Array]:
    """Return the fields of `Pieces` of one stretch, (parts,) or (parts, 3), where enough was recorded.

    t, there: (n,) s, and whether a sample was recorded; turned: (n, 3) complex, by the line's phase.
    """
    size = t.size // parts
    used = parts * size
    window = np.sin(np.pi * (np.arange(size) + 0.5) / size) * there[:used].reshape(parts, size)
    sums = (window[:, None] @ turned[:used].reshape(parts, size, len(AXES)))[:, 0]
    squared, weight = sums.real**2 + sums.imag**2, (window**2).sum(axis=1)
    power = (squared / noise).sum(axis=1) / np.maximum(weight, 1e-9)
    sine = 4.0 * (squared - noise * weight[:, None]) / np.maximum(window.sum(axis=1), 1e-9)[:, None] ** 2
    whole = weight >= LEAST_THERE * size / 2.0
    middles = t[:used].reshape(parts, size).mean(axis=1)
    return middles[whole], np.sqrt(power[whole]), sine[whole], np.broadcast_to(noise, sine.shape)[whole]


def _told(pieces: Pieces, where: Where, edge: float) -> _Told:
    """Compare both models. edge: s about the ends of the line's span, where it may be there or not."""
    span = (where.t_start, where.t_end)
    near = np.minimum(np.abs(pieces.t - span[0]), np.abs(pieces.t - span[1])) < edge
    inside = (pieces.t > span[0]) & (pieces.t < span[1])
    known = inside | ~near
    t, s, inside, louder = pieces.t[known], pieces.amplitude[known], inside[known], pieces.louder()[known]
    grid = _Grid.of(s, louder)
    steady, changing = grid.of_parts(inside)
    gain = _predicted(changing) - _predicted(steady)
    of_grid = changing.sum(axis=1)
    nats = _evidence(of_grid) - _evidence(steady.sum(axis=1))
    weight = np.exp(of_grid - of_grid.max())
    weight /= weight.sum()
    there = grid.here(weight) > 0.5
    level = float(weight @ np.tile(grid.levels, weight.size // LEVELS))
    line = level * louder
    held_out = HeldOut(gain, rms(s - np.where(inside, line, 0.0)), rms(s - np.where(there, line, 0.0)))
    ends = (float(t[there].min()), float(t[there].max())) if there.any() else span
    power = pieces.power[known][there] if there.any() else pieces.power
    amplitude, error = amplitude_of(power.mean(axis=0), power.std(axis=0) / np.sqrt(len(power)))
    times = max(int(np.count_nonzero(np.diff(there.astype(np.int8)) == 1)) + int(there[0]), 1)
    hits = float(there.sum())
    share = share_of(hits, float(there.size), max(hits / times, 1.0))
    return _Told(DirectEvidence(nats, held_out), share, ends, amplitude, error)


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """What both models are tried with, for n pieces; summed as it is worked out, as it is too much to hold.

    s: (n,) amplitudes over noise; louder: (n,) how far the line stands above each one's; levels: (LEVELS,).
    """

    s: Array
    louder: Array
    levels: Array

    @classmethod
    def of(cls, s: Array, louder: Array) -> _Grid:
        """Take the levels that such amplitudes allow for."""
        alike = s / louder
        top = float(np.quantile(alike, 0.95))
        lowest = max(0.3 * float(np.quantile(alike, 0.5)), 0.05 * top)
        return cls(s, louder, np.geomspace(lowest, 1.5 * top, LEVELS))

    def of_parts(self, inside: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the log densities (G, k) of each model's grid points for every block of pieces left out.

        inside: (n,) whether a piece lies in the steady line's span.
        """
        fold = blocks(self.s.size)
        own = (fold[:, None] == np.unique(fold)).astype(np.float64)
        steady, changing = [], []
        for scatter, floor in product(SCATTERS, FLOORS):
            there, gone, stray, both = self._densities(scatter, floor)
            steady += [np.log(there + stray) @ own, np.log(np.where(inside, there, gone) + stray) @ own]
            changing.append((np.log(both) @ own).reshape(-1, own.shape[1]))
        return np.concatenate(steady), np.concatenate(changing)

    def here(self, weight: Array) -> Array:
        """Return the probability (n,) that a line that comes and goes is there; weight: (G,) of its grid."""
        chance = np.zeros(self.s.size)
        of_each = weight.reshape(-1, PARTS, LEVELS, 1)
        for of_one, (scatter, floor) in zip(of_each, product(SCATTERS, FLOORS), strict=True):
            if of_one.sum() > SMALL:
                there, _, _, both = self._densities(scatter, floor)
                chance += (of_one * SHARES * there / both).sum(axis=(0, 1))
        return chance

    def _densities(self, scatter: float, floor: float) -> tuple[Array, Array, Array, Array]:
        """Return the densities (L, n) of a line that is there, (n,) of none, and (n,) of anything.

        The last ones are those (PARTS, L, n) of a line that comes and goes, for each part of the time.
        """
        there = (1.0 - STRAY) * _there(self.s, self.levels[:, None] * self.louder, scatter, floor)
        stray = STRAY / (np.maximum(self.s, 1e-12) * STRAY_RANGE)
        gone = (1.0 - STRAY) * _gone(self.s, floor)
        return there, gone, stray, SHARES * there + (1.0 - SHARES) * gone + stray


def _there(s: Array, level: Array, scatter: float, floor: float) -> Array:
    """Return the density (L, n) of the amplitude s (n,) where the line is there, its levels (L, n) scattered.

    The power of three axes, line and noise, is a noncentral chi-squared with six degrees of freedom.
    """
    unit, density = s / floor, np.zeros(level.shape)
    for node, weight in zip(*SCATTERED, strict=True):
        line = level / floor * max(1.0 + scatter * node, 0.05)
        near = np.exp(-((unit - line) ** 2)) * scaled_bessel(2.0 * unit * line)
        density += weight * 2.0 * unit * (unit / line) ** 2 * near / floor
    return density


def scaled_bessel(x: Array) -> Array:
    """Return exp(-x) I2(x) of x >= 0, read from a table: scipy's series take more than twice as long.

    Its product with (1 + x)^2.5 / x^2 is smooth in z = 1 / (1 + x), from 1 / sqrt(2 pi) at 0 to 1/8 at 1.
    """
    z = 1.0 / (1.0 + x)
    place = CELLS * z
    cell = np.clip(place.astype(np.int64), 1, CELLS - 2)
    within = place - cell
    c0, c1, c2, c3 = (np.take(of_cells, cell - 1) for of_cells in _bessel_cells())
    smooth = ((c3 * within + c2) * within + c1) * within + c0
    return np.asarray((x * z) ** 2 * np.sqrt(z) * smooth)


@cache
def _bessel_cells() -> Array:
    """Return the polynomials (4, CELLS - 2) through the four points about each inner cell, constant first."""
    from scipy.special import ive  # noqa: PLC0415 - the daemon stays light

    x = CELLS / np.arange(1.0, CELLS) - 1.0
    inner = ive(2, x) * (1.0 + x) ** 2.5 / x**2
    smooth = np.concatenate([[1.0 / np.sqrt(2.0 * np.pi)], inner, [1.0 / 8.0]])
    a, b, c, d = (smooth[k : k + CELLS - 2] for k in range(4))
    return np.stack([b, c - a / 3.0 - b / 2.0 - d / 6.0, (a + c) / 2.0 - b, (d - a) / 6.0 + (b - c) / 2.0])


def _gone(s: Array, floor: float) -> Array:
    """Return the density of the amplitude of noise alone: its square is a sum of three exponentials."""
    unit = s / floor
    return np.asarray(unit**5 * np.exp(-(unit**2)) / floor)


def _evidence(densities: Array) -> float:
    """Return the log evidence of a model; densities: (G,) of its grid points, which are alike beforehand."""
    return float(np.logaddexp.reduce(densities) - np.log(densities.size))


def _predicted(of_blocks: Array) -> float:
    """Return the log probability of every block of pieces, as the others tell it; of_blocks: (G, k)."""
    whole = of_blocks.sum(axis=1)
    return sum(_evidence(whole) - _evidence(whole - one) for one in of_blocks.T)


def _unsteady(line: Finding, told: _Told) -> Finding:
    """State a line that comes and goes: with the amplitude that it has while it is there."""
    parameters = {
        "frequency": line.parameters["frequency"],
        "amplitude": vector(told.amplitude, told.error, line.parameters["amplitude"].unit),
        "fraction": told.share.parameter("1"),
    }
    frequency = middle_hz(line)
    sizes = ", ".join(f"{axis} {told.amplitude[AXES.index(axis)]:.3g}" for axis in line.axes)
    say = (
        f"Vibration at {frequency:.2f} Hz in the {NAME[line.sensor]}'s data that comes and goes: it is there"
        f" in {100.0 * told.share.value:.0f} % of the time at rest, with an amplitude of"
        f" {sizes} {UNIT[line.sensor]}."
    )
    where = Where(*told.span, line.where.band_hz, COMES_AND_GOES)
    return replace(line, effect="unknown", where=where, parameters=parameters, statement=say)
