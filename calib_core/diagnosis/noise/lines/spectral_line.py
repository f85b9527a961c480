"""Lines in the spectrum of steady stretches, all along the recording or for a while.

A line stands in the same place in several stretches and above its own neighbourhood, which a hand's tremor,
typing or a road do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import Index
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.coherent_line import CoherentSpectrum
from stillcal.calib_core.diagnosis.noise.lines.harmonics import with_harmonics
from stillcal.calib_core.diagnosis.noise.lines.intermittent_line import named_if_steady
from stillcal.calib_core.diagnosis.noise.lines.line import COMES_AND_GOES, middle_hz, reach_hz
from stillcal.calib_core.diagnosis.noise.lines.line_estimate import (
    LOUDEST,
    narrow,
    never_by_chance,
    profile,
    stated,
    told,
)
from stillcal.calib_core.diagnosis.noise.lines.pace import pace_of
from stillcal.calib_core.diagnosis.noise.lines.steady_segments import (
    NEIGHBOURS,
    OWN,
    Places,
    Stretches,
    stretches,
)
from stillcal.calib_core.diagnosis.noise.lines.wandering_line import wandering_line, without_its_parts
from stillcal.calib_core.maths.chi_squared import exceeded
from stillcal.calib_core.streams.samples import Samples

MOMENT, BRIEF, SHORT, LONG = 5.0, 8.0, 20.0, 60.0
"""s of a stretch: short ones tell when a line comes and goes, long ones, or as long as a rest and no shorter
than short ones, show faint lines, brief ones are for rests that hold no others, and those of a moment for
what single short ones show."""

PLAIN = 46.0
"""Nats for a line from which short stretches show it well enough (a chance of 1e-20)."""

MOST_LINES = 3
"""Lines of one sensor that are stated: a vibration with its overtones, or two sidebands of one."""

MOST_TRIED = 12
"""Frequencies that are looked at for these, for time: what is no line is passed over."""

NEAR = OWN // 2 + 1
"""Frequencies about a line, told apart by the shortest stretch, in which nothing else is one."""

APART_HZ = NEAR / SHORT
"""Difference of two lines' frequencies below which they are one."""

LEAST_LINE_HZ = 4.0
BODY_HZ, SURE = 6.0, 69.0
"""Below this frequency a line must be as sure, in nats: overtones of hearts and hands reach so far. None is
told there whose frequency wanders, as a hand's tremor does, mostly below."""

FEW_RESTS, ONE_REST, WAITING = 5, 0.1, 0.02
"""Of so many rests one may be on something that shakes, for so much of the time at rest at most. People are
in vehicles for an hour a day (Metz 2008, Transport Reviews 28, 321), and wait there for a part of it: a
vibration of so little of all rests may be of many waits."""

STACK_P = 1e-3
"""Chance of what stands out, anywhere, in many stretches together; `stated` judges it."""

LEAST_STRETCHES = 4.5
"""Stretches' lengths that a line must last: nine that overlap by half make five."""
LEAST_STACK = 10
USUAL = 0.98
"""Quantile of all lines that tells how much larger than a flat spectrum's they come out here."""
LEAST_HALF, QUIET = 3.3, 2.83
"""QUIET: mean of the largest of nine powers with no line (1 + 1/2 + ... + 1/9)."""


@dataclass(frozen=True, eq=False)
class AtRest:
    """A sensor's rests. short: their stretches of `SHORT`, None for too few; so are the others here."""

    sensor: str
    places: Places | None
    short: Stretches | None

    @classmethod
    def of(cls, samples: Samples, sensor: str) -> AtRest:
        """Lay out the rests of these samples."""
        places = Places.of(samples)
        return cls(sensor, places, stretches(places, sensor, SHORT))

    @cached_property
    def brief(self) -> Stretches | None:
        """Their short stretches, or those of `BRIEF` where none are as long."""
        return self.short or stretches(self.places, self.sensor, BRIEF)

    @cached_property
    def coherent(self) -> CoherentSpectrum | None:
        """Their spectrum as one series; None for too few brief stretches."""
        if self.places is None or self.brief is None:
            return None
        return CoherentSpectrum.of(self.places, self.brief)

    def is_passing(self, line: Finding) -> bool:
        """Whether a line is of what the device lay on for a while, of many rests.

        It fills one rest and no part of another, as when a vehicle waits, or is there for hardly any of them.
        """
        if self.short is None:
            return False
        first, last = self.short.rests()
        if first.size < FEW_RESTS:
            return False
        start, end = line.where.t_start, line.where.t_end
        again = self._shown(line) & ((self.short.span[:, 1] <= start) | (self.short.span[:, 0] >= end))
        touched = (first < end) & (last > start)
        own, margin = last[touched] - first[touched], SHORT / 4.0
        whole = own.size == 1 and abs(own[0] - (end - start)) < margin and not again.any()
        share = float(np.asarray(line.parameters["fraction"].value))
        share += float(self.short.share[again].sum() / self.short.share.sum())
        return bool(share <= WAITING or (whole and own[0] <= ONE_REST * (last - first).sum()))

    @cached_property
    def _ratio(self) -> Array:
        """Power of the short stretches over that of their neighbourhood, (S, F, 3)."""
        assert self.short is not None, "stretches that may show a line"
        return self.short.ratio()

    def _shown(self, line: Finding) -> NDArray[np.bool_]:
        """Return which short stretches (S,) show a line by themselves: of several spells one run is told."""
        assert self.short is not None, "a line of short stretches"
        reach = reach_hz(line) + APART_HZ / NEAR
        near = np.abs(self.short.f - middle_hz(line)) <= reach
        ratio = self._ratio[:, near]
        return np.asarray(ratio.max(axis=(1, 2)) > never_by_chance(ratio.size))

    @cached_property
    def moments(self) -> Stretches | None:
        """Their stretches of `MOMENT`, None for too few."""
        return stretches(self.places, self.sensor, MOMENT)


def tones(
    samples: Samples, sensor: str, rests: AtRest | None = None, most: int = MOST_LINES
) -> list[Finding]:
    """Find the lines of one sensor above `LEAST_LINE_HZ`, the surest first, so many at most.

    rests: of these samples, where they are laid out already.
    """
    rests = rests or AtRest.of(samples, sensor)
    places = rests.places
    if places is None:
        return []
    found, more = _of_any_length(rests, most)
    steady = _above_least(_coherent(places, sensor, rests.coherent, found, most))
    clear = [f for f in _above_least(found) if f.where.band_hz[0] > BODY_HZ or _nats(f) > SURE]
    lines = [f for f in clear if not any(_same(f, one) for one in steady)] + steady
    rate = 1.0 / places.period
    if lines or more:
        lines = _with_wandering(lines, rests.moments, sensor, rate)
    return with_harmonics(sorted(lines, key=lambda f: -_nats(f))[:most], rate)


def _above_least(lines: Sequence[Finding]) -> list[Finding]:
    """Return those above `LEAST_LINE_HZ`: a line that stands out there may lie below."""
    return [f for f in lines if middle_hz(f) > LEAST_LINE_HZ]


def _with_wandering(lines: list[Finding], seen: Stretches | None, sensor: str, rate: float) -> list[Finding]:
    """Return the lines with one that wanders, if there is one, in the place of those it was taken for.

    One of a body is not told, and neither are its parts; another one may wander above it.
    """
    body: Finding | None = None
    for above_hz in (LEAST_LINE_HZ, BODY_HZ):
        wandering = wandering_line(sensor, seen, above_hz, 1.0 / SHORT)
        if wandering is None or (body is not None and not without_its_parts([wandering], body, rate)):
            continue
        lines = without_its_parts(lines, wandering, rate)
        if middle_hz(wandering) > BODY_HZ:
            return [wandering, *lines]
        body = wandering
    return lines


def _same(one: Finding, other: Finding) -> bool:
    """Whether two lines are one."""
    return abs(middle_hz(one) - middle_hz(other)) < APART_HZ


def _gain(found: Finding) -> float:
    """Return by how much a line foretells what was left out, nats."""
    return found.evidence.heldout_log_score_gain or 0.0


def _nats(found: Finding) -> float:
    return found.evidence.log_bayes_factor or 0.0


def _coherent(
    places: Places, sensor: str, spectrum: CoherentSpectrum | None, found: Sequence[Finding], most: int
) -> list[Finding]:
    """Return lines that keep their phase through the recording, and foretell more than those `found` do.

    A line that lasts for a part of the recording is foretold better by its power there, and one that wanders
    a little would have too small an amplitude. Overtones of a body are none.
    """
    if spectrum is None:
        return []
    seen, left = spectrum.seen, spectrum
    steady: list[Finding] = []
    tried: list[float] = []
    while len(steady) < most and len(tried) < MOST_TRIED:
        one = left.clearest(sensor, (LEAST_LINE_HZ, np.inf), tried)
        if one is None:
            break
        tried.append(middle_hz(one))
        same = [f for f in found if _same(one, f)]
        better = not same or (left.in_step(one) and all(_gain(one) > _gain(f) for f in same))
        left = CoherentSpectrum.of(places, left.seen.without(middle_hz(one), APART_HZ))
        whole = np.arange(len(seen.length), dtype=np.int64)
        body = pace_of(seen, whole, round(middle_hz(one) / float(seen.f[1]))) is not None
        if better and not body:
            steady.append(one)
    every = [*steady, *(f for f in found if not any(_same(f, one) for one in steady))]
    return _named(steady, seen, every)


def _named(lines: Sequence[Finding], seen: Stretches, every: Sequence[Finding]) -> list[Finding]:
    """Take the name off what comes and goes, and leave out its skirts. every: the lines there are."""
    named = [named_if_steady(one, seen, [middle_hz(f) for f in every if f is not one]) for one in lines]
    others = [*named, *(f for f in every if all(f is not one for one in lines))]
    length = float(np.median(seen.span[:, 1] - seen.span[:, 0]))
    return [f for f, one in zip(named, lines, strict=True) if not any(_skirt(one, x, length) for x in others)]


def _skirt(line: Finding, other: Finding, length: float) -> bool:
    """Whether a line is no more than what the spells of another one, as they begin and end, spread so far.

    A sine fitted to a stretch does not take it off. An end in the middle of a stretch of a `length`, s, under
    half a sine, leaves 1 / (4 length apart) of the amplitude at a frequency `apart`; a spell has two ends.
    """
    if other.where.driver != COMES_AND_GOES or _same(line, other):
        return False
    spread = 1.0 / (2.0 * length * abs(middle_hz(line) - middle_hz(other)))
    return _size(line) <= spread * _size(other)


def _size(line: Finding) -> float:
    """Return the amplitude of a line, of its axes together, m/s^2 or rad/s."""
    return float(np.linalg.norm(line.parameters["amplitude"].value))


def _of_any_length(rests: AtRest, most: int) -> tuple[list[Finding], bool]:
    """Return lines of long, short and brief stretches, and whether short ones show more."""
    places, sensor, short = rests.places, rests.sensor, rests.short
    found, more = _lines(sensor, short, (), most)
    plain = [f for f in found if _nats(f) > PLAIN]
    if len(plain) == most:
        return plain, more
    faint, _ = _lines(sensor, stretches(places, sensor, LONG, SHORT), plain, most)
    lines = [*plain, *faint]
    lines += [f for f in found if all(abs(middle_hz(f) - middle_hz(other)) > APART_HZ for other in lines)]
    if not lines and (short is None or float(short.share.sum()) < LEAST_STACK):
        return _lines(sensor, stretches(places, sensor, BRIEF), (), most)
    if short is not None and more and len(lines) < most:
        brief, _ = _lines(sensor, rests.moments, lines, most)
        lines += [f for f in brief if _narrow(short, f)]
    return lines, more


def _narrow(seen: Stretches, line: Finding) -> bool:
    """Whether a line is narrow in these stretches too, those that hold a part of it; not where none does."""
    rows = np.flatnonzero((seen.span[:, 1] > line.where.t_start) & (seen.span[:, 0] < line.where.t_end))
    at = round(middle_hz(line) / float(seen.f[1]))
    return rows.size > 0 and narrow(profile(seen, rows, at), 3 * rows.size)


def _lines(
    sensor: str, seen: Stretches | None, known: Sequence[Finding], most: int
) -> tuple[list[Finding], bool]:
    """Return the lines of some stretches, one after the other, each without those before; not `known` ones.

    Where the strongest that stands out is none, as it is brief, broad or of a body, it is passed over. One
    that comes and goes has no name. Also returned is whether single stretches show more.
    """
    if seen is None:
        return [], False
    apart = NEAR * float(seen.wider.max() * seen.f[1])
    left = seen
    for one in known:
        left = left.without(middle_hz(one), max(apart, APART_HZ))
    passed = (seen.f <= LEAST_LINE_HZ) | (seen.f >= 0.49 * seen.rate)
    found: list[Finding] = []
    ratio = left.ratio()
    for _ in range(MOST_TRIED):
        open_ones = np.flatnonzero(left.free & ~passed)
        k = _line(ratio[:, open_ones], left.share) if open_ones.size else None
        if k is None:
            break
        middle = int(open_ones[k])
        lasting = _lasting(
            ratio[:, middle - 1 : middle + 2], left.share, never_by_chance(ratio[:, open_ones].size)
        )
        pace = pace_of(seen, lasting, middle)
        line = _judged(sensor, left, lasting, middle) if pace is None else None
        if line is None:
            passed |= _of_one_cause(seen, middle, pace)
            continue
        found.append(line)
        if len(found) + len(known) == most:
            break
        left = left.without(middle_hz(line), apart)
        ratio = left.ratio()
    every = [*known, *found]
    above = left.free & (seen.f > LEAST_LINE_HZ)
    return _named(found, seen, every), bool((ratio[:, above] > never_by_chance(ratio.size)).any())


def _judged(sensor: str, seen: Stretches, lasting: Index, middle: int) -> Finding | None:
    """State a line that lasts and is narrow; None where it is not."""
    brief = float(seen.share[lasting].sum()) < LEAST_STRETCHES
    if brief or not narrow(profile(seen, lasting, middle), 3 * lasting.size):
        return None
    return stated(sensor, seen, lasting, middle)


def _of_one_cause(seen: Stretches, middle: int, pace: float | None) -> NDArray[np.bool_]:
    """Return where (F,) what was passed over stands: its neighbourhood, a body's other overtones."""
    k = np.arange(seen.f.size)
    about = np.abs(k - middle) <= (NEIGHBOURS + OWN) // 2 * seen.wider.max()
    if pace is None:
        return np.asarray(about)
    return np.asarray(about | (np.abs(k - pace * np.rint(k / pace)) <= OWN // 2))


def _line(ratio: Array, share: Array) -> int | None:
    """Return the frequency that stands out in `LEAST_STRETCHES` stretches, or in the mean of all."""
    best = ratio.max(axis=2)
    near = np.maximum(best, np.maximum(np.roll(best, 1, axis=1), np.roll(best, -1, axis=1)))
    hits = share @ (near > never_by_chance(ratio.size))
    if hits.max() >= LEAST_STRETCHES:
        clear = hits > hits.max() - 1.5
        return int(np.argmax(np.where(clear, best.sum(axis=0), 0.0)))
    return _stacked(ratio)


def _stacked(ratio: Array) -> int | None:
    """Return where all, half or a quarter of the stretches together stand out, or None.

    On one axis, or on the three together (Fisher's method).
    """
    nats = 2.0 * told(np.minimum(ratio, LOUDEST))
    total = np.concatenate([np.zeros((1, *ratio.shape[1:])), np.cumsum(nats, axis=0)])
    best: tuple[float, int] | None = None
    for part in (1, 2, 4):
        count = len(ratio) // part
        if count < LEAST_STACK:
            break
        first = np.arange(0, len(ratio) - count + 1, max(count // 2, 1))
        stack = total[first + count] - total[first]
        for values, freedom in ((stack.max(axis=2), 2 * count), (stack.sum(axis=2), 6 * count)):
            usual = float(np.quantile(values, USUAL)) / exceeded(1.0 - USUAL, freedom)
            limit = exceeded(STACK_P / stack.size, freedom) * max(usual, 1.0)
            top = float(values.max()) / limit
            if top > 1.0 and (best is None or top > best[0]):
                best = top, int(np.argmax(values.max(axis=0)))
    return None if best is None else best[1]


def _lasting(ratio: Array, share: Array, plain: float) -> Index:
    """Return the stretches that have a line: a run of them, or all where this is as likely.

    ratio: (S, 3, 3) of the line and of the frequency on either side, by axis; share: (S,) of these stretches;
    plain: the ratio from which one shows the line by itself. Where they hardly do, the run may be one of
    chance. Of short spells that come again and again a run is only one: these last from first to last.
    """
    near, line = ratio.max(axis=(1, 2)), ratio[:, 1]
    every, shown = np.arange(len(ratio), dtype=np.int64), np.flatnonzero(near > plain)
    run = _run(near, float(near.mean()))
    run = _run(near, float(near[run].mean())) if run.size else run
    if share[run].sum() < LEAST_STRETCHES <= share[shown].sum():
        return every[shown[0] : shown[-1] + 1]
    if run.size and float(near[run].mean()) > LOUDEST:
        return run
    choices = 2.0 * float(np.log(len(ratio)))
    return run if run.size and _steady(line[run]) - choices > _steady(line) else every


def _steady(ratio: Array) -> float:
    """Return nats for a steady line on each axis, against none (Rice's law); ratio: (S, 3)."""
    from scipy.special import i0e  # noqa: PLC0415 - the daemon stays light

    line = np.maximum(ratio.mean(axis=0) - 1.0, 0.0)
    twice = 2.0 * np.sqrt(ratio * line)
    return float((np.log(i0e(twice)) + twice - line).sum())


def _run(near: Array, mean: float) -> Index:
    """Return the run of stretches that gains most over half way from no line to a mean; near: (S,)."""
    half = max(0.5 * (QUIET + mean), LEAST_HALF)
    gain = np.concatenate([[0.0], np.cumsum(np.minimum(near, 4.0 * half) - half)])
    lowest = np.minimum.accumulate(gain)
    last = int(np.argmax(gain - lowest))
    first = int(np.argmin(gain[: last + 1]))
    return np.arange(first, last, dtype=np.int64)
