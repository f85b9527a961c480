"""Whether rests may have, or would show, lines of another recording: they are put in and looked for.

Rests that are fewer, shorter or louder do not show every line that others do, and no more than the surest are
stated of any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.even_stamps import evened
from stillcal.calib_core.diagnosis.noise.lines.harmonics import folded
from stillcal.calib_core.diagnosis.noise.lines.line import COMES_AND_GOES, WANDERS, middle_hz, reach_hz
from stillcal.calib_core.diagnosis.noise.lines.line_estimate import most_power
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import (
    APART_HZ,
    LEAST_LINE_HZ,
    MOST_LINES,
    MOST_TRIED,
    tones,
)
from stillcal.calib_core.diagnosis.noise.lines.steady_segments import Stretches
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.streams.samples import Samples

PART = 0.7
"""Part of the amplitude that is put in, so that a line which is there and was missed is not called absent."""

ASIDE_HZ = (1.0, 2.0, 3.0, 0.0)
"""It is put in so far aside, first of these where no other line is: on top of one it would add to that."""

CLOCKS = 1e-3
"""Part of a frequency by which two clocks may put one line apart, beside `APART_HZ`."""


def every_line(samples: Samples, sensor: str, stated: Sequence[Finding]) -> list[Finding]:
    """Return the lines of one sensor's rests, also those that are not stated, as enough others are surer."""
    if len(stated) < MOST_LINES:
        return list(stated)
    rate = 1.0 / sample_period(samples.t)
    found = tones(samples, sensor, most=MOST_TRIED)
    known = [middle_hz(line) for line in stated]
    return [*stated, *(f for f in found if not any(same_line(middle_hz(f), hz, rate) for hz in known))]


def would_show(
    samples: Samples, sensor: str, lines: Sequence[Finding], others: Sequence[Finding] = ()
) -> list[bool]:
    """Return which lines, found in another recording, the rests of one sensor would show."""
    return [seen is not None for seen in as_shown(samples, sensor, lines, others)]


def as_shown(
    samples: Samples, sensor: str, lines: Sequence[Finding], others: Sequence[Finding] = ()
) -> list[Finding | None]:
    """Return how the rests of one sensor show lines of another recording, all put in at once; None if not.

    others: `every_line` of these rests.
    """
    rate = 1.0 / sample_period(samples.t)
    t = evened(samples.t).t
    there = [folded(middle_hz(one), rate) for one in others]
    louder = samples.xyz
    placed: list[float] = []
    for line in lines:
        size = np.asarray(line.parameters["amplitude"].value, dtype=np.float64)
        placed.append(_aside(folded(middle_hz(line), rate), [*there, *placed], rate))
        louder = louder + PART * np.outer(_wave(line, placed[-1], t - t[0]), size)
    found = tones(replace(samples, xyz=frozen(louder)), sensor, most=MOST_TRIED)
    again = (
        (one for one in found if same_line(aside, middle_hz(one), rate, reach_hz(line)))
        for line, aside in zip(lines, placed, strict=True)
    )
    return [next(seen, None) for seen in again]


def may_have(seen: Stretches | None, line: Finding) -> bool:
    """Whether rests have so much power at a line's frequency that it may be there, unseen.

    Real lines wander and come and go otherwise than those that are put in. Of one that wanders far no single
    frequency has much. seen: the short or brief stretches of one sensor's rests, None for too few.
    """
    if seen is None or line.where.driver == WANDERS:
        return False
    amplitude = np.asarray(line.parameters["amplitude"].value, dtype=np.float64)
    errors = np.ptp(np.asarray(line.parameters["amplitude"].ci95, dtype=np.float64), axis=-1)
    clearest = int(np.argmax(amplitude / np.maximum(errors, 1e-300)))
    share = float(np.asarray(line.parameters["fraction"].value))
    own = folded(middle_hz(line), seen.rate)
    about = apart_hz(middle_hz(line))
    most = most_power(seen, own - about, own + about, share)
    there = share if line.where.driver == COMES_AND_GOES else 1.0
    return bool(most[clearest] >= there * (PART * amplitude[clearest]) ** 2)


def _wave(line: Finding, frequency: float, t: Array) -> Array:
    """Return a vibration (n,) of a frequency, Hz, at times t (n,) s, there for as much of them as a line is.

    One that comes and goes does so as often, and does not keep its phase: a steady one of the same power
    shows far better.
    """
    share = float(np.asarray(line.parameters["fraction"].value))
    turned = _phase(t, frequency, reach_hz(line))
    if line.where.driver != COMES_AND_GOES:
        return np.asarray(np.sqrt(share) * np.sin(turned))
    period = max(line.where.t_end - line.where.t_start, 1.0) / _spells(line)
    spell = (t / period).astype(np.int64)
    phases = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, int(spell.max()) + 1)
    return np.asarray(np.where(t / period - spell < share, np.sin(turned + phases[spell]), 0.0))


def _spells(line: Finding) -> float:
    """Return how often a line comes, as the interval of its share tells: so many spells are independent."""
    share = np.asarray(line.parameters["fraction"].value, dtype=np.float64)
    error = float(np.ptp(np.asarray(line.parameters["fraction"].ci95))) / (2.0 * NORMAL_95)
    return max(float(share**2 * (1.0 - share)) / max(error, 1e-6) ** 2, 1.0)


def _phase(t: Array, frequency: float, reach: float) -> Array:
    """Return the phase (n,), rad, of a line from t = 0 s; one that wanders goes once there and back."""
    once = 2.0 * np.pi / max(float(t[-1]), 1e-9)
    return np.asarray(2.0 * np.pi * (frequency * t + reach / once * (1.0 - np.cos(once * t))))


def _aside(own: float, others: Sequence[float], rate: float) -> float:
    """Return a frequency, Hz, near a line's own at which nothing else is."""
    inward = 1.0 if own < rate / 4.0 else -1.0
    tried = [own + way * inward * away for away in ASIDE_HZ for way in (1.0, -1.0)]
    within = [f for f in tried if LEAST_LINE_HZ < f < 0.49 * rate]
    free = (f for f in within if all(abs(f - other) > 2.0 * APART_HZ for other in others))
    return next(free, own + inward * ASIDE_HZ[0])


def same_line(one: float, other: float, rate: float, wanders: float = 0.0) -> bool:
    """Whether two frequencies, Hz, are one where samples are taken at a rate, Hz: higher ones fold back.

    wanders: Hz, how far on either side one of them does.
    """
    return abs(folded(one, rate) - folded(other, rate)) < apart_hz(max(one, other)) + wanders


def apart_hz(frequency: float) -> float:
    """Return by how much, Hz, one line of a frequency may be apart in two recordings."""
    return APART_HZ + CLOCKS * frequency
