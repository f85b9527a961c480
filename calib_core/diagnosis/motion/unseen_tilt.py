"""Gravity's direction that jumps while the gyroscope sees no turn: one of the two sensors is at fault.

Across gravity a bias that jumps and a nudge of the phone look alike to the accelerometer, and the norm of
gravity shows neither. A nudge is a turn. So gravity's direction, second by second at rest, is compared with
where the gyroscope takes it: what is left is a line in time, for the gyroscope's bias, and noise. At every
second, and over short gaps between rests, a step in it is estimated. What lies on something that gives way
turns, and both sensors see it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import (
    NORMAL_95,
    DirectEvidence,
    Index,
    direct_finding,
    of_chance,
    sized,
)
from stillcal.calib_core.diagnosis.model.records import Finding, Parameter, Where
from stillcal.calib_core.diagnosis.model.settings import JUMP
from stillcal.calib_core.diagnosis.motion.turning_windows import Span
from stillcal.calib_core.diagnosis.segments.leaning import ACROSS, FASTEST, OFTEN, PUSH
from stillcal.calib_core.diagnosis.segments.orientation import GRAVITY, LONGEST_GAP, MOST_OF_BIAS
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import rest_edges
from stillcal.calib_core.diagnosis.segments.turns import LEAST_ANGLE
from stillcal.calib_core.diagnosis.segments.value_grid import ROUNDED
from stillcal.calib_core.diagnosis.segments.windows import WINDOW, Windows, without_gaps, without_spikes

DRIVER = "jumps of gravity's direction that the gyroscope does not see (either may be at fault)"
MISSED = "turns that the gyroscope does not show"

REACH, FEWEST = 8, 3
"""Windows on either side of a moment that tell a step, at most and at least."""

LEAST_RATE = 20.0
"""Samples of the gyroscope in a window, at least: two in a nudge of a tenth of a second."""

WHOLE = 0.8
"""Part of the usual samples, without which the gyroscope may have missed a nudge."""

HELD = 0.01
"""Part of the usual noise of the rate, by variance, below which values are held and no turn is seen."""

UNSURE = 0.1
"""Part of how far the phone was moved meanwhile that the gyroscope may have missed, uncalibrated."""

TOGETHER = 20_000
"""Moments that are judged together, to bound memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Windows of a recording.

    up: (n, 3) gravity's direction; left: (n, 3) the same, the gyroscope's turns taken off; path: (n,) rad,
    how far each window moved beyond the gyroscope's noise.
    """

    up: Array
    left: Array
    path: Array

    @classmethod
    def of(cls, force: Windows, rate: Windows, runs: Sequence[tuple[int, int]]) -> Series:
        """Carry gravity's direction along by the rates. runs: [first, last) windows at rest."""
        still = np.concatenate([np.arange(a, b) for a, b in runs])
        up = force.mean / np.maximum(np.linalg.norm(force.mean, axis=1, keepdims=True), 1e-9)
        spin = rate.mean - np.median(rate.mean[still], axis=0)
        turned = WINDOW * np.cross(up, spin)
        noise = 3.0 * float(np.median(rate.variance[still].sum(axis=1)))
        power = (spin**2).sum(axis=1) + rate.variance.sum(axis=1) - noise
        path = WINDOW * np.sqrt(np.maximum(power, 0.0))
        return cls(up, up - np.cumsum(turned, axis=0) + turned / 2.0, path)


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Steps of gravity's direction. at: (m,) windows from the first to the middle of each; step: (m, 3) rad.

    variance: (m,) of a component of `step` with unit noise; noise: (m,) variance of a window's component;
    freedom: (m,) of that. seen: (m,) rad, by how much the direction changes with the gyroscope's turns in it;
    gap: (m,) windows between.
    """

    at: Array
    step: Array
    variance: Array
    noise: Array
    freedom: Array
    seen: Array
    gap: Array

    @classmethod
    def of(cls, series: Series, places: Index) -> Steps:
        """Estimate the step at places (m, 4): [first, last) before it, [first, last) after it."""
        before, after = places[:, 1] - places[:, 0], places[:, 3] - places[:, 2]
        gap = places[:, 2] - places[:, 1]
        shape = np.stack([before, gap, after], axis=1)
        kinds, which = np.unique(shape, axis=0, return_inverse=True)
        out = np.zeros((len(places), 7))
        for k, (n, between, m) in enumerate(kinds):
            for rows in _batches(np.flatnonzero(which.ravel() == k)):
                out[rows] = _steps(series, places[rows, 0], n, between, m)
        variance, noise, freedom, seen = out[:, 3:].T
        middle = (places[:, 1] + places[:, 2]) / 2.0
        return cls(middle, out[:, :3], variance, noise, freedom, seen, gap.astype(np.float64))

    @property
    def angle(self) -> Array:
        """Size (m,) of each step, rad."""
        return np.asarray(np.linalg.norm(self.step, axis=1))


def _batches(rows: Index) -> list[Index]:
    return [rows[i : i + TOGETHER] for i in range(0, rows.size, TOGETHER)]


def _steps(series: Series, first: Index, n: int, gap: int, m: int) -> Array:
    """Return rows (k, 7) of places alike: step, variance with unit noise, noise, freedom, angle seen.

    first: (k,) the first window; n, gap, m: windows before, between and after.
    """
    lag = np.concatenate([np.arange(n), np.arange(m) + n + gap]).astype(np.float64)
    later = lag >= n + gap
    design = np.column_stack([later, np.ones(lag.size), lag - lag.mean()])
    solve = np.linalg.pinv(design)
    rows = first[:, None] + lag.astype(np.int64)
    left, up = series.left[rows], series.up[rows]
    middle = up.mean(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    left = left - np.einsum("kli,ki->kl", left, middle)[:, :, None] * middle[:, None, :]
    step = np.einsum("l,kli->ki", solve[0], left)
    rest = left - np.einsum("lj,jn,kni->kli", design, solve, left)
    freedom = 2 * (n + m - 3)
    noise = (rest**2).sum(axis=(1, 2)) / freedom
    seen = up[:, later].mean(axis=1) - up[:, ~later].mean(axis=1)
    known = np.broadcast_to([float(solve[0] @ solve[0])], first.shape)
    free = np.broadcast_to([float(freedom)], first.shape)
    return np.column_stack([step, known, noise, free, np.linalg.norm(seen, axis=1)])


def unseen_tilt(
    overview: Overview,
    rounding: tuple[Array | None, Array | None],
    gravity: float,
    spoiled: Sequence[Span] = (),
) -> Finding | None:
    """Find jumps of gravity's direction that the gyroscope does not see.

    rounding: (3,) of force and rate, sd of what coarse steps leave in a mean at rest; spoiled: when not to
    look, s.
    """
    if overview.rate is None or float(np.median(overview.rate.count)) < LEAST_RATE:
        return None
    runs = rest_edges(overview.force, overview.rate, overview.span).runs
    force = without_gaps(without_spikes(overview.force, overview.rate))
    rate = without_gaps(without_spikes(overview.rate, overview.force))
    places = _places(runs)
    if not len(places):
        return None
    series = Series.of(force, rate, runs)
    places, moved = _judged_places(places, series, rate, spoiled)
    if not len(places):
        return None
    steps = Steps.of(series, places)
    error = _errors(steps, moved, rounding, gravity)
    # F of two components over the noise about the line, whose tail is in closed form.
    log_chance = -0.5 * steps.freedom * np.log1p(steps.angle**2 / error**2 / steps.freedom)
    # What turns while gravity stays where it was is the gyroscope's; where it turned half as far in whatever
    # direction, its axes may be at fault.
    log_chance[(steps.seen < 0.5 * steps.angle) | (moved > 0.5 * steps.angle)] = 0.0
    found = _sure(steps, log_chance)
    pushes = _across(force, steps)[found] & _brief(steps, found, runs)
    if np.count_nonzero(pushes) >= OFTEN:
        found = [i for i, push in zip(found, pushes, strict=True) if not push]
    return _finding(steps, error, log_chance, found, overview.span[0]) if found else None


def _across(force: Windows, steps: Steps) -> NDArray[np.bool_]:
    """Whether steps (m,) are as far as pushes of what carries the phone are, and across gravity alone."""
    length, at = np.linalg.norm(force.mean, axis=1), steps.at.astype(np.int64)
    sums = np.concatenate([[0.0], np.cumsum(length)])
    before, after = at - (steps.gap / 2.0).astype(np.int64), at + np.ceil(steps.gap / 2.0).astype(np.int64)
    change = (sums[np.minimum(after + FEWEST, length.size)] - sums[after]) / FEWEST
    change = change - (sums[before] - sums[before - FEWEST]) / FEWEST
    far = (steps.angle > PUSH) & (steps.angle * GRAVITY < MOST_OF_BIAS)
    return np.asarray(far & (np.abs(change) < ACROSS * GRAVITY * steps.angle))


def _places(runs: Sequence[tuple[int, int]]) -> Index:
    """Return [first, last) before and after every moment (m, 4) in rests, and between rests not far apart."""
    found = [np.zeros((0, 4), dtype=np.int64)]
    for i, (a, b) in enumerate(runs):
        k = np.arange(a + FEWEST, b - FEWEST + 1)
        found.append(np.stack([np.maximum(k - REACH, a), k, k, np.minimum(k + REACH, b)], axis=1))
        if i and a - runs[i - 1][1] <= LONGEST_GAP and b - a >= FEWEST:
            first, last = runs[i - 1]
            if last - first >= FEWEST:
                found.append(np.array([[max(last - REACH, first), last, a, min(a + REACH, b)]]))
    return np.concatenate(found)


def _judged_places(
    places: Index, series: Series, rate: Windows, spoiled: Sequence[Span]
) -> tuple[Index, Array]:
    """Return the places that the gyroscope watched all along, and how far (m,) the phone moved there, rad."""
    power = rate.variance.sum(axis=1)
    held = power < HELD * float(np.median(power))
    lost = ((rate.count < WHOLE * float(np.median(rate.count))) | held).astype(np.float64)
    for start, end in spoiled:
        lost[(rate.t > start - WINDOW) & (rate.t < end + WINDOW)] = 1.0
    unwatched, path = (np.concatenate([[0.0], np.cumsum(x)]) for x in (lost, series.path))
    watched = unwatched[places[:, 3]] - unwatched[places[:, 0]] == 0.0
    moved = path[places[:, 2] + 1] - path[places[:, 1] - 1]
    kept = watched & (moved < LEAST_ANGLE)
    return places[kept], moved[kept]


def _errors(steps: Steps, moved: Array, rounding: tuple[Array | None, Array | None], gravity: float) -> Array:
    """Return the standard errors (m,) of a component of each step, rad.

    Noise is that about the line, and no less than what most steps show: neighbouring seconds may be alike.
    """
    inside = steps.gap == 0.0
    usual = steps.angle[inside] ** 2 / steps.variance[inside] if inside.any() else np.zeros(1)
    # The median of two squared components is 2 ln 2 times their variance.
    noise = np.maximum(float(np.median(usual)) / (2.0 * np.log(2.0)), steps.noise)
    coarse = [0.0 if r is None else ROUNDED * float(r.max()) for r in rounding]
    missed = UNSURE * moved
    blurred = coarse[0] / gravity + coarse[1] * WINDOW * (1.0 + steps.gap)
    settled = JUMP["accel"] / gravity
    variance = noise * steps.variance * (1.0 + steps.gap) + missed**2 + blurred**2 + settled**2
    return np.asarray(np.sqrt(variance))


def _brief(steps: Steps, found: list[int], runs: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Whether jumps found may start or end a push: one for longer, before and after, is too fast.

    runs: [first, last) windows at rest, in which the phone keeps its attitude.
    """
    at, (begins, ends) = steps.at[found], np.array(runs, dtype=np.float64).T
    others = np.sort(at)
    before = at - np.maximum(
        begins[np.searchsorted(begins, at) - 1], np.append(-np.inf, others)[np.searchsorted(others, at)]
    )
    after = -at + np.minimum(
        ends[np.searchsorted(ends, at, side="right")],
        np.append(others, np.inf)[np.searchsorted(others, at, side="right")],
    )
    lasts = WINDOW * np.minimum(before, after)
    return np.asarray(GRAVITY * steps.angle[found] * lasts < FASTEST)


def _sure(steps: Steps, log_chance: Array) -> list[int]:
    """Return the jumps that are sure, each once, the surest first."""
    tries = float(log_chance.size)
    found: list[int] = []
    for i in np.argsort(log_chance):
        if not DirectEvidence(of_chance(float(log_chance[i]), tries)).stated:
            break
        if all(abs(steps.at[i] - steps.at[j]) > REACH for j in found):
            found.append(int(i))
    return found


def _finding(
    steps: Steps, error: Array, log_chance: Array, found: Sequence[int], start: float
) -> Finding | None:
    """State the jumps found, the surest first. start: s, of the first window."""
    tries = float(log_chance.size)
    surest = found[0]
    times = [start + WINDOW * float(steps.at[i]) for i in found]
    angle, half = float(steps.angle[surest]), NORMAL_95 * float(error[surest])
    turned = angle * GRAVITY > MOST_OF_BIAS
    many = "" if len(found) == 1 else f" It does so {len(found)} times; this is the surest."
    say = (
        f"At {times[0]:.0f} s gravity's direction jumps by {np.degrees(angle):.2g} degrees in the"
        f" accelerometer, and the gyroscope sees no such turn.{many}"
    )
    say += " No bias steps so far: the gyroscope missed a turn." if turned else " Either may be at fault."
    sizes = {"angle": Parameter(angle, [angle - half, angle + half], "rad")}
    if len(found) > 1:
        sizes |= sized({"jumps": (float(len(found)), "1")})
    size = np.abs(steps.step[surest])
    axes = [] if turned else [int(a) for a in np.flatnonzero(size > 0.5 * size.max())]
    where = Where(min(times), max(times), (0.0, 1.0 / WINDOW), MISSED if turned else DRIVER)
    seen, sensor = DirectEvidence(of_chance(float(log_chance[surest]), tries)), "gyro" if turned else "accel"
    return direct_finding("unknown", sensor, axes, where, sizes, statement=say, seen=seen)
