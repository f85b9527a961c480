"""What a line in steady stretches is: how narrow, of which frequency and amplitude, and from when to when.

Frequency and amplitude come from the stamps themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import blocks
from stillcal.calib_core.diagnosis.model.measurement import (
    NORMAL_95,
    DirectEvidence,
    HeldOut,
    Index,
    direct_finding,
    of_chance,
    vector,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.noise.lines.line import amplitude_of
from stillcal.calib_core.diagnosis.noise.lines.steady_segments import INDEPENDENT, NEIGHBOURS, OWN, Stretches
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.maths.chi_squared import log_tail
from stillcal.calib_core.maths.rms import rms

LOUDEST = 10.0
"""Ratio to the neighbours that counts at most, so that no few stretches make a line."""

LINE_P = 1e-5
"""Chance of what stands out anywhere in single stretches; `stated` judges it."""

FLANK, FLANK_SIGMAS = 0.15, 2.0
FINE = 0.05
MOST_REFINED = 60
CLOCK = 2e-5
EITHER_END = float(np.sqrt(2.0 / 12.0))
"""Standard deviation of the sum of two numbers, each uniform between 0 and 1."""

BESIDE: Index = np.arange(OWN // 2 + 1, (OWN + NEIGHBOURS) // 2 + 1)
"""Steps from a line, on either side, at which its neighbours are."""

OVERLAPPING = 0.2
"""Part by which the variance of a sum of powers is more where stretches overlap by half: under half a sine
two of them correlate by 0.1."""

STUDENT = 1.42
"""Of a standard error from five parts: 97.5 % quantile with four degrees of freedom, over 1.96."""

AS_GIVEN = 1e-3
"""Part of an amplitude by which it is not known, however loud it is."""

REACH = 4.0
"""Standard errors of a line's frequency within which it is looked for by phase."""

MOST_TURNED = 2_000_000
"""Phases that are tried: so many frequencies times stretches. Rests of a day, hours apart, allow for so many
frequencies that the phase tells none; they took 11 GB."""

IN_STEP = 0.9
"""Part of a line's power, at least, that its phase foretells: what is off by a twentieth of a cycle (rms) has
exp(-(2 pi / 20)^2). What wanders by more stands out as well of the spectrum of the whole recording."""

SIGMAS = 2.0
"""Standard errors by which a power may be larger than it is measured."""

LEAST_TOGETHER = 3
"""Stretches whose mean tells how far it may be off."""

SIGNIFICANT = 3.0
"""Standard errors from which an axis has a line: by chance one in 700."""


def told(ratio: Array) -> Array:
    """Return nats of ratios to the mean of n independent neighbours: without a line they have F(2, 2n)."""
    return np.asarray(INDEPENDENT * np.log1p(ratio / INDEPENDENT))


def never_by_chance(count: int) -> float:
    """Return the ratio that no stretch has by chance, of so many."""
    return float(np.log(count / LINE_P))


def of_axes(nats: Array, alike: float = 1.0, axes_alike: float = 1.0) -> Array:
    """Return nats (k,) of lines on the clearest axis, or on the three together (Fisher).

    nats: (n, k, 3) of n independent powers of k lines; alike: how many of the n count as one; axes_alike: how
    many axes do.
    """
    total, freedom = 2.0 * nats.sum(axis=0) / alike, 2.0 * len(nats) / alike
    single = log_tail(total.max(axis=-1), freedom)
    together = log_tail(total.sum(axis=-1) / axes_alike, 3.0 * freedom / axes_alike)
    return np.asarray(-np.minimum(single, together))


def axes_alike(nats: Array) -> float:
    """Return how many axes count as one: 1 where their noise is independent, 3 where it is the same.

    nats: (n, 3) of frequencies without a line. What shakes the phone is on all axes, and where one has much
    by chance, so have the others.
    """
    apart = nats - nats.mean(axis=0)
    apart = apart / np.maximum(np.linalg.norm(apart, axis=0), 1e-300)
    return 1.0 + 2.0 / 3.0 * float(np.maximum((apart.T @ apart)[np.triu_indices(3, 1)], 0.0).sum())


def profile(seen: Stretches, rows: Index, middle: Index | int) -> Array:
    """Return the power (41,) about a line, summed over stretches, in steps of what each one tells apart."""
    return np.asarray(powers_about(seen, rows, middle, np.arange(-20, 21)).sum(axis=(0, 2)))


def powers_about(seen: Stretches, rows: Index, middle: Index | int, steps: Index) -> Array:
    """Return the powers (rows, n, 3) so many steps (n,) from a line, in what each stretch tells apart.

    middle: the line's place in all of these stretches, or (rows,) in each.
    """
    at = np.asarray(middle)[..., None] + np.round(np.outer(seen.wider[rows], steps)).astype(np.int64)
    return np.asarray(seen.power[rows[:, None], np.clip(at, 0, seen.f.size - 1)])


def _noise(seen: Stretches, rows: Index, middle: int) -> Array:
    """Return the power of the noise (rows, 3) in a line's place: the mean of its neighbours.

    Of the two sides the one counts that is louder in all stretches together: at the edge of a band in which
    something shakes, or where a line that wanders turns, the mean of both is half of what is on one.
    """
    sides = np.stack([powers_about(seen, rows, middle, sign * BESIDE).mean(axis=1) for sign in (-1, 1)])
    total = sides.sum(axis=1)
    return np.asarray(sides.mean(axis=0) * (total.max(axis=0) / np.maximum(total.mean(axis=0), 1e-300)))


def _beside(seen: Stretches, rows: Index, middle: int) -> Array:
    """Return the powers (n, 3) of a line's neighbours, each over their mean in its stretch, as nats."""
    power = powers_about(seen, rows, middle, np.concatenate([-BESIDE, BESIDE]))
    return told(power / np.maximum(power.mean(axis=1, keepdims=True), 1e-300)).reshape(-1, 3)


def narrow(profile: Array, count: int) -> bool:
    """Whether the power (41,), a sum of `count` powers, falls off within three bins, as a taper's."""
    middle = profile.size // 2
    away = np.abs(np.arange(profile.size) - middle)
    floor = float(np.median(profile[away > 12]))
    flank = profile[(away >= 4) & (away <= 6)]
    chance = FLANK_SIGMAS * floor * float(np.sqrt(NEIGHBOURS / INDEPENDENT / count / flank.size))
    return float(flank.mean()) - floor - chance < FLANK * (float(profile[away <= 1].mean()) - floor)


def _amplitudes(seen: Stretches, rows: Index, first: float, step: float = 0.0, count: int = 1) -> Array:
    """Return complex amplitudes (rows, count, 3) of sines by the stamps, tapered.

    first, step: Hz, the frequencies, evenly spaced, so that one turns into the next by the same factors.
    """
    out = np.empty((rows.size, count, 3), dtype=np.complex128)
    for i, row in enumerate(rows):
        turned = np.empty((count, seen.t.shape[1]), dtype=np.complex128)
        turned[0] = np.exp(-2j * np.pi * first * seen.t[row])
        turned[1:] = np.exp(-2j * np.pi * step * seen.t[row])
        out[i] = np.multiply.accumulate(turned, axis=0) @ seen.tapered[row]
    return np.asarray(out * seen.to_amplitude[rows, None, None])


def _frequency(seen: Stretches, rows: Index, middle: int) -> tuple[float, float]:
    """Return frequency and standard error from the power about a bin, the error from fifths left out."""
    few = rows[np.linspace(0, rows.size - 1, min(rows.size, MOST_REFINED)).astype(int)]
    step = float(seen.f[1])
    grid = seen.f[middle] + np.arange(-1.5, 1.5 + FINE, FINE) * step
    power = (np.abs(_amplitudes(seen, few, float(grid[0]), FINE * step, grid.size)) ** 2).sum(axis=2)
    fold = blocks(len(power))
    best = peak(grid, power.sum(axis=0))
    error = _left_out([peak(grid, power[fold != k].sum(axis=0)) for k in np.unique(fold)])
    return best, float(np.hypot(error, max(CLOCK * best, 2e-3 * step)))


def _left_out(values: Sequence[float]) -> float:
    """Return the standard error of a number from its values without each of some parts (jackknife)."""
    parts, n = np.array(values), len(values)
    return STUDENT * float(np.sqrt((n - 1) / n * ((parts - parts.mean()) ** 2).sum()))


def _in_step(seen: Stretches, rows: Index, near: float, error: float) -> tuple[float, float]:
    """Return frequency and standard error of a line, by its phase from stretch to stretch where it keeps one.

    near, error: Hz, as single stretches tell it, and as it stays for a line that loses its phase, and where
    too many frequencies would have to be tried.
    """
    line, middle = _amplitudes(seen, rows, near)[:, 0], seen.span[rows].mean(axis=1)
    step = 1.0 / float(seen.span[rows[-1], 1] - seen.span[rows[0], 0])
    reach = min(max(REACH * error, step), 0.5 / float(np.diff(middle).min()))
    if 2.0 * reach / (FINE * step) * rows.size > MOST_TURNED:
        return near, error
    grid = np.arange(-reach, reach + FINE * step, FINE * step)
    turned = np.exp(-2j * np.pi * np.outer(near + grid, middle - middle.mean()))

    def together(some: NDArray[np.bool_]) -> Array:
        return np.asarray((np.abs(turned[:, some] @ line[some]) ** 2).sum(axis=1))

    power, fold = together(np.ones(rows.size, dtype=np.bool_)), blocks(rows.size)
    if power.max() < IN_STEP * rows.size * (np.abs(line) ** 2).sum():
        return near, error
    off = peak(grid, power)
    parts = [peak(grid, together(fold != k)) for k in np.unique(fold)]
    return near + off, float(np.hypot(_left_out(parts), CLOCK * near))


def peak(grid: Array, power: Array) -> float:
    """Return where power (k,) on an even grid (k,) is largest, by a parabola through three points."""
    k = int(np.clip(np.argmax(power), 1, grid.size - 2))
    a, b, c = power[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    return float(
        grid[k] + (0.0 if bend >= 0.0 else np.clip(0.5 * (a - c) / bend, -1, 1)) * (grid[1] - grid[0])
    )


def stated(sensor: str, seen: Stretches, rows: Index, middle: int) -> Finding | None:
    """State the line at a frequency (its index) that some stretches show; None where it is not sure.

    Nor where parts of them have it further apart than a stretch tells apart: a band in which something
    shakes has its largest power elsewhere in each.
    """
    frequency, error = _in_step(seen, rows, *_frequency(seen, rows, middle))
    if NORMAL_95 * error > float(seen.f[1]):
        return None
    line = np.abs(_amplitudes(seen, rows, frequency)[:, 0]) ** 2
    noise = seen.to_amplitude[rows, None] ** 2 * _noise(seen, rows, middle)
    power, spread = _mean_power(line - noise, noise)
    amplitude, error_of_size = amplitude_of(power, spread)
    scatter = error_of_size + AS_GIVEN * amplitude
    axes = [a for a in range(3) if power[a] > SIGNIFICANT * spread[a]] or [int(np.argmax(amplitude))]
    runs = 1.0 if rows.size == len(seen.length) else len(seen.length) ** 2 / 2.0
    overlapping = 1.0 + OVERLAPPING * 2.0 * (1.0 - float(seen.share[rows].mean()))
    alike = overlapping, axes_alike(_beside(seen, rows, middle))
    evidence = evidence_of(line / np.maximum(noise, 1e-300), line, float(seen.f.size) * runs, alike)
    pitch, size, span = (frequency, error), (amplitude, scatter), _lasts(seen, rows)
    return vibration(sensor, seen, axes, pitch=pitch, size=size, span=span, evidence=evidence)


def _mean_power(power: Array, noise: Array) -> tuple[Array, Array]:
    """Return the mean (3,) of a line's power (n, 3), and its standard error, where noise (n, 3) is.

    Stretches count by their precision: a faint line is not lost in those in which a car drives, and one that
    is above the noise of all counts in each alike.
    """
    weight = np.maximum(noise + np.maximum(power.mean(axis=0), 0.0), 1e-30) ** -2.0
    weight /= weight.sum(axis=0)
    mean = (weight * power).sum(axis=0)
    return mean, np.sqrt((weight**2 * (power - mean) ** 2).sum(axis=0))


def most_power(seen: Stretches, lowest: float, highest: float, share: float) -> Array:
    """Return the largest squared amplitude (3,), by axis, that a line between two frequencies, Hz, may have.

    Of any so large a share of the stretches, one after the other: its mean above the neighbours, with two
    standard errors.
    """
    count = min(max(int(np.ceil(share * len(seen.length))), LEAST_TOGETHER), len(seen.length))
    begins = np.arange(0, len(seen.length) - count + 1, max(count // 4, 1))
    first, last = np.clip(np.rint(np.array([lowest, highest]) / float(seen.f[1])), 0, seen.f.size - 1)
    most = np.zeros(3)
    for begin, place in product(begins, range(int(first), int(last) + 1)):
        rows = np.arange(begin, begin + count)
        scale = seen.to_amplitude[rows, None] ** 2
        noise = scale * _noise(seen, rows, place)
        mean, error = _mean_power(scale * seen.power[rows, place] - noise, noise)
        most = np.maximum(most, mean + SIGMAS * error)
    return most


def vibration(
    sensor: str,
    seen: Stretches,
    axes: Sequence[int],
    *,
    pitch: tuple[float, float],
    size: tuple[Array, Array],
    span: tuple[float, float],
    evidence: DirectEvidence,
) -> Finding | None:
    """State a vibration; None where the evidence does not carry it.

    seen: the stretches it was found in; pitch: Hz, and its standard error; size: (3,) amplitudes and their
    standard errors, in the sensor's unit; span: s, its first and last moment.
    """
    (frequency, error), (amplitude, scatter), (start, end) = pitch, size, span
    half = NORMAL_95 * error
    parameters = {
        "frequency": Parameter(frequency, [frequency - half, frequency + half], "Hz"),
        "amplitude": vector(amplitude, scatter, UNIT[sensor]),
        "fraction": _fraction(seen, start, end),
    }
    where = Where(start, end, (frequency - half, frequency + half), "time")
    vibration = "Vibration" if (start, end) == seen.whole else f"From {start:.0f} to {end:.0f} s: vibration"
    sizes = ", ".join(f"{AXES[a]} {amplitude[a]:.3g}" for a in axes)
    say = f"{vibration} at {frequency:.2f} Hz in the {NAME[sensor]}'s data, amplitude {sizes} {UNIT[sensor]}."
    found = direct_finding("vibration_tone", sensor, axes, where, parameters, statement=say, seen=evidence)
    alias = f"It may be an alias of one at {seen.rate - frequency:.1f} or {seen.rate + frequency:.1f} Hz."
    return found and replace(found, remark=alias)


def _lasts(seen: Stretches, rows: Index) -> tuple[float, float]:
    """Return when a line begins and ends, s: with the recording where no stretch is without it there."""
    first, last = int(rows[0]), int(rows[-1])
    start = seen.whole[0] if first == 0 else float(seen.span[first, 0])
    end = seen.whole[1] if last == len(seen.span) - 1 else float(seen.span[last, 1])
    return start, end


def _fraction(seen: Stretches, start: float, end: float) -> Parameter:
    """Return the part of the recording from `start` to `end`, s: either moment lies anywhere in a stretch."""
    whole = max(seen.whole[1] - seen.whole[0], end - start)
    part = (end - start) / whole
    error = EITHER_END * float(np.median(seen.span[:, 1] - seen.span[:, 0])) / whole
    return Parameter(part, [part - NORMAL_95 * error, min(part + NORMAL_95 * error, 1.0)], "1")


def evidence_of(
    ratio: Array, line: Array, places: float, alike: tuple[float, float] = (1.0, 1.0)
) -> DirectEvidence:
    """Return what powers (S, 3) say of a line, on the clearest axis or on the three together (Fisher).

    ratio: to the noise, by chance of an F law; alike: stretches, and axes, that count as one; places: how
    many frequencies, and runs of stretches, were looked at. Powers of stretches left out are predicted by the
    others, by exponential laws.
    """
    fold, gain = blocks(len(ratio)), 0.0
    before, after = [], []
    for k in np.unique(fold):
        test, more = ratio[fold == k], np.maximum(ratio[fold != k].mean(axis=0), 1.0)
        gain += float((test - test / more - np.log(more)).sum())
        seen = np.sqrt(line[fold == k])
        before.append(rms(seen))
        after.append(rms(seen - np.sqrt(line[fold != k].mean(axis=0))))
    nats = float(of_axes(told(ratio)[:, None], *alike)[0])
    held_out = HeldOut(gain, rms(np.array(before)), rms(np.array(after)))
    return DirectEvidence(of_chance(-nats, 4.0 * places), held_out)
