"""Names that the stamps alone suggest, held against what the samples and the count of them say.

A gap in the stamps is a lost sample only where motion went on meanwhile. Stamps scatter only where each is
off by itself: not where one pattern comes with every batch, nor where few are late and all others in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import sized
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter
from stillcal.calib_core.diagnosis.noise.lines.line_spectrum import lines
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.sequence.neighbours import spread
from stillcal.calib_core.diagnosis.sequence.places import batch
from stillcal.calib_core.diagnosis.stamps.timestamps import Grid
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.streams.samples import Samples

LEAP, PATTERN, FEW = "stamps that leap", "count of the samples", "few late stamps"

SURE = 8.0
"""Times what a change differs from its neighbours' by, as a rule, that a lost sample must have changed."""

NEARBY = 17
"""Changes, the middle one apart, that tell what is the rule."""

NOTHING, ALL = 0.25, 0.5
"""Part of the change over a gap up to which motion did not go on, and from which it did."""

WRONG = 0.1
"""Chance that motion speaks for the wrong one: it bends within a gap."""

FEWEST = 10
"""Gaps that motion must show: one knock beside a gap is enough for a few."""

DOUBT = float(np.log(20.0))
"""Nats from which a name does not fit, twenty to one: that there is something the stamps show in any case."""

MOST = 0.5
"""Part of the intervals' variance that a pattern must make to be what they scatter by."""

TAILED = 0.4
"""Robust over plain standard deviation, below which most stamps scatter by far less.

Normal ones have 1, those of an exponential delay 0.7."""


def judged(found: Sequence[Finding], samples: Samples, sensors: Sequence[Samples]) -> list[Finding]:
    """Return findings of stamps, without a name where it does not fit.

    samples: the stream that they are of; sensors: all, whose motion may tell.
    """
    return [_judged(f, samples, sensors) for f in found]


def _judged(found: Finding, samples: Samples, sensors: Sequence[Samples]) -> Finding:
    if found.effect == "dropped_samples":
        return _leaping(found, sensors)
    if found.effect == "timestamp_jitter":
        grid = Grid.of(samples.t, sample_period(samples.t))
        return _patterned(found, grid) or _few(found, grid) or found
    return found


def _leaping(found: Finding, sensors: Sequence[Samples]) -> Finding:
    """Return lost samples, or stamps that leap where motion shows that nothing is lost."""
    shares = np.concatenate([gone_on(s) for s in sensors])
    against, both = int((shares < NOTHING).sum()), int(((shares < NOTHING) | (shares > ALL)).sum())
    nats = (2 * against - both) * float(np.log((1.0 - WRONG) / WRONG))
    # Where motion often speaks for either, as a shaking does that is quicker than a gap, it tells neither.
    if nats < DOUBT or both < FEWEST or both - against > 2.0 * WRONG * both:
        return found
    say = (
        f"The time stamps leap, but no sample is missing: in {against} of {both} gaps that motion shows it"
        " went on as from one sample to the next."
    )
    sizes = sized({"gaps": (float(both), "1"), "without_loss": (float(against), "1")})
    return _nameless(found, LEAP, say, sizes)


def gone_on(samples: Samples) -> Array:
    """Return how far motion went on over each gap that shows it (k,): 0 none, 1 as long as the gap.

    Values change by as much from sample to sample before and after it.
    """
    xyz, n = samples.xyz, len(samples)
    if n < 2 * NEARBY:
        return np.zeros(0)
    lost = Grid.of(samples.t, sample_period(samples.t)).dropped()
    change = np.diff(xyz, axis=0)
    around = 0.5 * (change[:-2] + change[2:])
    beyond = change[1:-1] - around
    unit = spread(beyond)
    around, beyond, count = around / unit, beyond / unit, lost[1:-1]
    gaps = np.flatnonzero((count > 0.0) & (lost[:-2] == 0.0) & (lost[2:] == 0.0))
    if not gaps.size:
        return np.zeros(0)
    near = np.clip(
        gaps[:, None] + np.delete(np.arange(NEARBY) - NEARBY // 2, NEARBY // 2), 0, len(beyond) - 1
    )
    rule = np.sqrt(np.median((beyond[near] ** 2).sum(axis=2), axis=1))
    due = count[gaps, None] * around[gaps]
    power = (due**2).sum(axis=1)
    shown = np.sqrt(power) > SURE * np.maximum(rule, np.sqrt(xyz.shape[1]))
    return np.asarray((due * beyond[gaps]).sum(axis=1)[shown] / power[shown])


def _patterned(found: Finding, grid: Grid) -> Finding | None:
    """Return stamps that are off by the same in every batch; None where each is off by itself."""
    off = np.where(grid.multiples == 1.0, np.clip(np.diff(grid.t) / grid.period - 1.0, -1.0, 1.0), 0.0)
    off = off - off.mean()
    period, nats = batch([lines(off)])
    folded = off[: off.size // period * period].reshape(-1, period)
    share = float(folded.mean(axis=0).var() / max(off.var(), 1e-300))
    if share < MOST or nats < DOUBT:
        return None
    say = f"The time stamps are off by one pattern in every {period} samples, {share:.0%} of their scatter."
    sizes = sized({"period_samples": (float(period), "samples"), "share": (share, "1")})
    return _nameless(found, PATTERN, say, {**found.parameters, **sizes})


def _few(found: Finding, grid: Grid) -> Finding | None:
    """Return few stamps that are late among others in time; None where all scatter."""
    most = MAD_TO_SD * float(np.median(np.abs(grid.apart)))
    every = rms(grid.apart)
    if max(most, grid.step / 2.0) > TAILED * every:
        return None
    say = "A few time stamps are late by much; the others keep to an even rate."
    return _nameless(found, FEW, say, found.parameters)


def _nameless(found: Finding, driver: str, say: str, sizes: dict[str, Parameter]) -> Finding:
    """Return a finding without its name, as sure as it was."""
    where = replace(found.where, driver=driver)
    evidence = Evidence(found.evidence.log_bayes_factor)
    return replace(
        found,
        effect="unknown",
        where=where,
        evidence=evidence,
        parameters=sizes,
        alternatives=[],
        statement=say,
    )
