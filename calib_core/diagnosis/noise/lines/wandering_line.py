"""A line whose frequency wanders, as that of a fan or a motor without a governor does.

It is followed from one brief stretch to the next along the path on which it stands out most (a dynamic
programme, Viterbi's). In longer stretches it is spread over frequencies, and looks fainter than it is, or
looks as if it came and went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import Index, direct_finding, share_of, vector
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.noise.lines.harmonics import MOST as MOST_HARMONICS
from stillcal.calib_core.diagnosis.noise.lines.harmonics import folded
from stillcal.calib_core.diagnosis.noise.lines.line import WANDERS, amplitude_of, middle_hz
from stillcal.calib_core.diagnosis.noise.lines.line_estimate import (
    AS_GIVEN,
    LOUDEST,
    SIGNIFICANT,
    evidence_of,
    narrow,
    never_by_chance,
    powers_about,
    profile,
    told,
)
from stillcal.calib_core.diagnosis.noise.lines.pace import pace_of
from stillcal.calib_core.diagnosis.noise.lines.steady_segments import OWN, Stretches
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT

REACH = 3
"""Frequencies that a line may move from one stretch to the next, half a stretch later: 0.25 Hz a second."""

LEAST_PART = 0.5
"""Part of the stretches, at least, that show the line by themselves."""

LEAST_SHOWN = 10
"""Stretches that do not overlap and show it: of fewer a path is no course."""

NEAR = 3.0
"""Times the usual distance of stretches up to which successive ones are near: rests may be hours apart."""

CHANCES = 3.0
"""Standard deviations by which successive frequencies must be more alike than by chance (von Neumann)."""

MOST_GAP = 1.0 / 3.0
"""Part of its range, at most, in which it is never: what goes from one speed to another is two lines."""

AS_LOUD, LEAST_AS_LOUD = 3.0, 0.85
"""Factor of the median within which its power is in so large a part of the stretches that have it, at least.
Of noise of a narrow band, as of a hand, two thirds are; what else is loud in a rest is not the line."""

EDGES = (0.025, 0.975)
"""Quantiles of its frequency between which it is said to be."""


def wandering_line(
    sensor: str, seen: Stretches | None, above_hz: float, resolved_hz: float
) -> Finding | None:
    """Find the line that wanders; None without one, or where longer stretches hold it.

    seen: brief stretches; above_hz: where lines are looked for; resolved_hz: what longer stretches tell
    apart, within which a line that moves is a plain one.
    """
    if seen is None:
        return None
    track = _track(seen, above_hz)
    if track is None or not track.wanders(resolved_hz):
        return None
    about = profile(seen, track.rows, track.at)
    if not narrow(about, 3 * track.rows.size) or pace_of(seen, track.rows, track.hz / seen.f[1]) is not None:
        return None
    return _stated(sensor, seen, track)


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """A line's course.

    rows, at: (n,) stretches that have it, and its places there; t: (n,) s; hz: (n,); ratio: (n, 3) of its
    power to that of its neighbours; part: of the time that all stretches hold.
    """

    rows: Index
    at: Index
    t: Array
    hz: Array
    ratio: Array
    part: float

    def wanders(self, resolved_hz: float) -> bool:
        """Whether its frequency goes its way slowly, and further than longer stretches tell apart.

        Of independent frequencies the squares of differences are twice the variance (von Neumann 1941).
        """
        low, high = np.quantile(self.hz, EDGES)
        if high - low <= resolved_hz or np.diff(np.sort(self.hz)).max() > MOST_GAP * (high - low):
            return False
        apart = self.hz[::2]
        near = np.diff(self.t[::2]) < NEAR * np.median(np.diff(self.t[::2]))
        if near.sum() < LEAST_SHOWN - 1:
            return False
        alike = float((np.diff(apart)[near] ** 2).mean() / (2.0 * apart.var()))
        return bool(alike < 1.0 - CHANCES / np.sqrt(near.sum()))


def _track(seen: Stretches, above_hz: float) -> _Track | None:
    """Follow what stands out most through all stretches; None where too few of them show it."""
    ratio = seen.ratio()
    open_ones = (seen.f > above_hz) & (seen.f < 0.98 * seen.f[-1]) & seen.free
    nats = told(np.minimum(ratio, LOUDEST)).sum(axis=2)
    path = _path(np.where(open_ones, nats, -np.inf), _reach(seen))
    if path is None:
        return None
    every = np.arange(path.size)
    clearest = ratio[every, path].max(axis=1)
    shown = clearest > never_by_chance(ratio[:, open_ones].size)
    if seen.share[shown].sum() < LEAST_PART * seen.share.sum():
        return None
    rows = np.flatnonzero(clearest > LOUDEST)  # by chance 1 in 1000, at the best of the places in reach
    at = _top(seen, rows, path[rows])
    power = _about(seen, rows, at, 2).sum(axis=1)
    as_loud = np.abs(np.log(power / np.median(power))) < np.log(AS_LOUD)
    if as_loud.mean() < LEAST_AS_LOUD:
        return None
    rows, at = rows[as_loud], at[as_loud]
    part = float(seen.share[rows].sum() / seen.share.sum())
    return _Track(rows, at, seen.span[rows].mean(axis=1), _between(seen, rows, at), ratio[rows, at], part)


def _top(seen: Stretches, rows: Index, at: Index) -> Index:
    """Return the place (n,) of the largest power about the path, on which all that is loud counts alike."""
    reach = OWN // 2
    top = at + np.argmax(_about(seen, rows, at, reach), axis=1) - reach
    return np.asarray(np.clip(top, 0, seen.f.size - 1), dtype=np.int64)


def _about(seen: Stretches, rows: Index, at: Index, reach: int) -> Array:
    """Return the power (n, 2 reach + 1) of all axes about the places of a line."""
    return np.asarray(powers_about(seen, rows, at, np.arange(-reach, reach + 1)).sum(axis=2))


def _reach(seen: Stretches) -> Index:
    """Return how many frequencies (S - 1,) a line may move between successive stretches."""
    middle = seen.span.mean(axis=1)
    usual = 0.5 * float(np.median(seen.span[:, 1] - seen.span[:, 0]))
    halves = np.maximum(np.round(np.diff(middle) / usual), 1.0)
    return np.asarray(np.minimum(REACH * halves, seen.f.size), dtype=np.int64)


def _path(nats: Array, reach: Index) -> Index | None:
    """Return the frequency (S,) in every stretch on the path with the largest sum; nats: (S, F)."""
    if not np.isfinite(nats).any():
        return None
    total, steps = nats[0], []
    for gain, most in zip(nats[1:], reach, strict=True):
        padded = np.pad(total, most, constant_values=-np.inf)
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * most + 1)
        best = np.argmax(windows, axis=1)
        steps.append(best + np.arange(total.size) - most)
        total = windows[np.arange(total.size), best] + gain
    path = [int(np.argmax(total))]
    for step in reversed(steps):
        path.append(int(step[path[-1]]))
    return np.array(path[::-1], dtype=np.int64)


def _between(seen: Stretches, rows: Index, at: Index) -> Array:
    """Return the frequency (n,) of a line between those of the spectrum: a parabola through three logs."""
    a, b, c = np.log(np.maximum(_about(seen, rows, at, 1), 1e-300)).T
    bend = np.minimum(a - 2.0 * b + c, -1e-12)
    return np.asarray((at + np.clip(0.5 * (a - c) / bend, -0.5, 0.5)) * float(seen.f[1]))


def _stated(sensor: str, seen: Stretches, track: _Track) -> Finding | None:
    turn = np.exp(-2j * np.pi * track.hz[:, None] * seen.t[track.rows])
    sums = (turn[:, None] @ seen.tapered[track.rows])[:, 0] * seen.to_amplitude[track.rows, None]
    line = np.abs(sums) ** 2
    noise = line / np.maximum(track.ratio, 1e-300)
    spread = line.std(axis=0) / np.sqrt(len(line) / 2.0)  # stretches overlap by half
    amplitude, error = amplitude_of((line - noise).mean(axis=0), spread)
    error = error + AS_GIVEN * amplitude
    axes = [a for a in range(3) if amplitude[a] > SIGNIFICANT * error[a]] or [int(np.argmax(amplitude))]
    evidence = evidence_of(track.ratio, line, float(seen.f.size))
    choices = len(line) * float(np.log(2 * REACH + 1))
    evidence = replace(evidence, log_bayes_factor=evidence.log_bayes_factor - choices)
    middle, (low, high) = float(np.median(track.hz)), np.quantile(track.hz, EDGES)
    parameters = {
        "frequency": Parameter(middle, [float(low), float(high)], "Hz"),
        "amplitude": vector(amplitude, error, UNIT[sensor]),
        "fraction": share_of(track.part * len(seen.length) / 2.0, len(seen.length) / 2.0).parameter("1"),
    }
    where = Where(*seen.whole, (float(low), float(high)), WANDERS)
    sizes = ", ".join(f"{AXES[a]} {amplitude[a]:.3g}" for a in axes)
    say = (
        f"Vibration in the {NAME[sensor]}'s data whose frequency wanders from {low:.2f} to {high:.2f} Hz,"
        f" amplitude {sizes} {UNIT[sensor]}."
    )
    return direct_finding("unknown", sensor, axes, where, parameters, statement=say, seen=evidence)


def without_its_parts(lines: Sequence[Finding], wandering: Finding, rate: float) -> list[Finding]:
    """Return the lines that are neither a part of one that wanders nor of its harmonics; rate: Hz.

    A harmonic wanders as many times as far. Lines as far beside it again as the first wanders are its skirts.
    """
    low, high = wandering.where.band_hz
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    parts = [(folded(n * middle, rate), (n + 1) * half) for n in range(1, MOST_HARMONICS + 1)]
    return [f for f in lines if all(abs(middle_hz(f) - hz) > reach for hz, reach in parts)]
