"""Which seconds of a recording are still: quiet for this recording, with a force and a rate that stay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.windows import (
    KNOCK,
    Windows,
    merged,
)

FEWEST_TO_TELL, HELD = 3, 4
"""Samples in a window without which its spread does not tell whether the phone moves; how many a window of a
slow log holds on average: some have one less, because stamps jitter."""

LOUDEST_FORCE, LOUDEST_RATE = 0.5, 0.1
"""m/s^2 and rad/s, spread within a second on three axes beyond which nothing lies: a phone that is carried
nearly all day is shaken by more, a phone in a car or on a washing machine by less."""

STILL_FORCE, STILL_RATE = 0.08, 0.03
"""m/s^2 and rad/s above what the recording's quietest windows have up to which a window is still."""

STEADY_FORCE, TOLD = 0.03, 2.0
"""m/s^2 by which the mean force of a still window may differ from the next one's, noise aside; times that
from which on a turn must show: on the axis that shows it best it does so by 1 / sqrt(3) at the least."""

CIRCLING = 1.2
"""Times gravity: a force that leans by 45 degrees and more, in a bend or a centrifuge, is 1.41 times it."""

RARE = 0.1
"""Part of a rest's windows that may be knocked: where it is more, coarse steps or a steady shake do it."""

SHORTEST_REST = 5
"""Windows of a rest, at the least."""


def still_windows(force: Windows, rate: Windows | None) -> NDArray[np.bool_]:
    """Return which windows (n,) are still: quiet for this recording, and mean force and rate that stay."""
    enough = force.count >= max(FEWEST_TO_TELL, 0.5 * float(np.median(force.count)))
    spread = np.sqrt(force.variance.sum(axis=1))
    floor = min(float(np.quantile(spread[enough], 0.1)), LOUDEST_FORCE) if enough.any() else 0.0
    still = enough & (spread < 3.0 * floor + STILL_FORCE)
    jump = np.abs(np.diff(force.mean, axis=0)).max(axis=1)
    steady = jump < STEADY_FORCE + 6.0 * np.sqrt(
        np.minimum(spread[1:], spread[:-1]) ** 2 / np.maximum(force.count[1:], 1)
    )
    still[1:] &= steady
    still[:-1] &= steady
    if rate is not None and still.any():
        still &= _not_turning(rate, force, still)
    return np.asarray(still)


def without_knocks(still: NDArray[np.bool_], force: Windows, rate: Windows | None) -> NDArray[np.bool_]:
    """Return the still windows (n,) that are not far louder than their rest is as a rule: it ends there."""
    kept = still.copy()
    for sensor in (force, rate):
        spread = np.zeros(still.size) if sensor is None else np.sqrt(sensor.variance.sum(axis=1))
        for first, last in rest_runs(still):
            loud = spread[first:last] > KNOCK * float(np.median(spread[first:last]))
            kept[first:last] &= ~loud | (loud.mean() > RARE)
    return np.asarray(kept)


def _not_turning(rate: Windows, force: Windows, still: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the windows (n,) in which the phone does not turn; still (n,): in which the force stays.

    A rate unlike the others' is a bias that changed where its larger part is across the force, for a turn
    would move that. About the force a phone may turn: on a turntable, in a vehicle. So it may about gravity
    if the force leans on a circle, but by less than 45 degrees, or the force is longer than gravity.
    """
    turn = np.sqrt(rate.variance.sum(axis=1))
    floor = min(float(np.quantile(turn[still], 0.1)), LOUDEST_RATE)
    away = rate.mean - np.median(rate.mean[still], axis=0)
    noise = 4.0 * floor / np.sqrt(np.maximum(rate.count, 1.0))
    slow = np.abs(away).max(axis=1) < STILL_RATE + noise
    length = np.linalg.norm(force.mean, axis=1)
    along = np.abs((away * force.mean).sum(axis=1)) / np.maximum(length, 1e-9)
    across = np.sqrt(np.maximum((away**2).sum(axis=1) - along**2, 0.0))
    width = float(np.median(np.diff(force.t))) if force.t.size > 1 else 0.0
    told = length * across * width > TOLD * _most_of_a_jump(force)
    circles = length > CIRCLING * float(np.median(length[still]))
    same = slow | (told & (across > along) & ~circles)
    return np.asarray(same & (turn < 3.0 * floor + 2.0 * STILL_RATE) & (rate.count >= 3))


def _most_of_a_jump(force: Windows) -> Array:
    """Return by how much the mean force (n,) may change to the next window, m/s^2, at the most, at rest."""
    spread = np.sqrt(force.variance.sum(axis=1))
    return np.asarray(STEADY_FORCE + 6.0 * spread / np.sqrt(np.maximum(force.count, 1.0)))


def still_seconds(force: Windows, rate: Windows | None) -> NDArray[np.bool_]:
    """Return which windows (n,) are still; of a slow log, several together have the samples to tell."""
    there = force.count[force.count > 0.0]
    slow = there.size > 0 and float(np.median(there)) < FEWEST_TO_TELL
    size = int(np.ceil(HELD / float(force.count.mean()))) if slow else 1
    if size == 1 or force.t.size < size:
        return without_knocks(still_windows(force, rate), force, rate)
    wide = merged(force, size)
    turning = None if rate is None else merged(rate, size)
    found = without_knocks(still_windows(wide, turning), wide, turning)
    still = np.zeros(force.t.size, dtype=np.bool_)
    still[: found.size * size] = np.repeat(found, size)
    return still


def rest_runs(still: NDArray[np.bool_], shortest: int = SHORTEST_REST) -> list[tuple[int, int]]:
    """Return [first, last) windows of runs of stillness, one window trimmed at either end."""
    runs = [(a + 1, b - 1) for a, b in runs_of(still)]
    return [(a, b) for a, b in runs if b - a >= shortest]


def runs_of(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return [first, last) of every run of flags (n,) that are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
