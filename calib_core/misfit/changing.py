"""Noise that is of another level for a while: one sensor's own, white at either level."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.misfit.left_out import blocks, rms
from stillcal.calib_core.misfit.noise import Levels
from stillcal.calib_core.misfit.quick import Seen, unknown
from stillcal.calib_core.misfit.records import Finding, Where
from stillcal.calib_core.misfit.spectrum import SHARED, Spectra
from stillcal.calib_core.samples import Array

LEAST_PIECES = 5
LEAST_CHANGE = 0.22
LEAST_SIGMAS = 8.0
EVEN = 2.0
WHITE = 0.25
BANDS = 6


def changing(spectrum: Spectra, measured: Levels, sensor: str) -> Finding | None:
    """Find a run of rests whose noise is of another level, as even within itself as the others'."""
    course = np.log(measured.pieces).mean(axis=1)
    n = course.size
    if n < 3 * LEAST_PIECES:
        return None
    first, last = _run(course)
    inside = np.zeros(n, dtype=bool)
    inside[first:last] = True
    if min(inside.sum(), (~inside).sum()) < LEAST_PIECES:
        return None
    chance = 0.5 * np.sqrt(SHARED / (3.0 * spectrum.averages.mean() * spectrum.band.sum()))
    high, low = course[inside], course[~inside]
    change = float(np.median(high) - np.median(low))
    even = max(_scatter(high), _scatter(low)) < EVEN * chance + 0.03
    sigmas = abs(change) / (float(chance) * np.sqrt(1.0 / high.size + 1.0 / low.size))
    if abs(change) < LEAST_CHANGE or sigmas < LEAST_SIGMAS or not even or not _white(spectrum, inside):
        return None
    t_start, t_end = float(spectrum.t[first]), float(spectrum.t[last])
    ratio = float(np.exp(change))
    say = f"From {t_start:.0f} to {t_end:.0f} s the {sensor} sensor's noise is {ratio:.2f} times its usual."
    where = Where(t_start, t_end, (0.0, spectrum.rate / 2.0), "time")
    axes = [a for a in range(3) if abs(_of_axis(measured, inside, a)) > 0.5 * abs(change)]
    return unknown(
        sensor, axes, where, {"ratio": (ratio, "1")}, statement=say, seen=_left_out(course, inside, sigmas)
    )


def _run(course: Array) -> tuple[int, int]:
    """Return first and one past last of the run that differs most from the rest.

    In sum of squares explained.
    """
    n = course.size
    total = np.concatenate([[0.0], np.cumsum(course - course.mean())])
    size = np.arange(1, n)
    best = (0.0, 0, n)
    for length in size[LEAST_PIECES - 1 : n - LEAST_PIECES]:
        gap = total[length:] - total[:-length]
        k = int(np.argmax(np.abs(gap)))
        score = float(gap[k] ** 2 * n / (length * (n - length)))
        if score > best[0]:
            best = score, k, k + int(length)
    return best[1], best[2]


def _scatter(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _of_axis(measured: Levels, inside: NDArray[np.bool_], axis: int) -> float:
    course = np.log(measured.pieces[:, axis])
    return float(np.median(course[inside]) - np.median(course[~inside]))


def _white(spectrum: Spectra, inside: NDArray[np.bool_]) -> bool:
    """Whether the spectrum changes alike in all bands: not a road, nor steps in the house."""
    within, without = (np.median(spectrum.power[rows], axis=0) for rows in (inside, ~inside))
    ratio = np.log(np.maximum(within, 1e-300) / np.maximum(without, 1e-300))
    course = [float(part.mean()) for part in np.array_split(ratio[spectrum.band], BANDS)]
    return float(np.ptp(course)) < max(WHITE, 0.35 * abs(float(np.mean(course))))


def _left_out(course: Array, inside: NDArray[np.bool_], sigmas: float) -> Seen:
    """Predict the level of pieces left out by the others': of their own kind, or of all."""
    fold = blocks(course.size)
    # Every fifth piece, not blocks: a block may hold the whole change.
    fold = np.arange(course.size) % (fold.max() + 1)
    gain, before, after = 0.0, np.zeros(course.size), np.zeros(course.size)
    for k in np.unique(fold):
        train, test = fold != k, fold == k
        one = float(course[train].mean())
        means = np.where(inside, course[train & inside].mean(), course[train & ~inside].mean())
        s0, s1 = rms(course[train] - one), rms((course - means)[train])
        before[test], after[test] = course[test] - one, (course - means)[test]
        gain += float(
            (np.log(s0 / s1) + 0.5 * (before[test] / s0) ** 2 - 0.5 * (after[test] / s1) ** 2).sum()
        )
    return Seen(sigmas, gain, rms(before), rms(after))
