"""The time from one sample to the next: of even stamps, of stamps with gaps, of stamps in bursts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, once_per_array
from stillcal.calib_core.maths.rms import rms

HEELS = 0.5
"""Part of the mean interval below which a sample comes on the heels of the one before."""

LEAST_HEELS = 0.4
"""Part of the samples that come on the heels of another at least in bursts: one in two does of pairs."""

ON_GRID = 0.15
"""Periods by which the intervals of stamps with gaps may be off a multiple of the period, rms."""

PAIRS, IN_PART = 10, 5
"""Pairs of parts, of some gaps each on average, that are enough to tell whether these come evenly."""

CHANCE = 0.01
"""Chance by which losses may seem to come more evenly than they do: nothing is said of them then."""

PAUSE_S, PAUSE_PERIODS = 1.0, 50.0
"""An interval of at least 1 s and 50 usual ones is a pause: nothing was sampled, or nothing of it is held."""


def intervals(t: Array) -> Array:
    """Return the intervals (m,) s of stamps t (n,) s, pauses left out."""
    steps = np.diff(t)
    if steps.size == 0:
        return steps
    return np.asarray(steps[steps < max(PAUSE_S, PAUSE_PERIODS * float(np.median(steps)))])


@once_per_array
def bunched(t: Array) -> bool:
    """Whether stamps t (n,) come in bursts, so that the usual interval says nothing of the rate.

    Half of the samples and more then come on the heels of another, and the waits between bursts are no
    multiples of that interval, or equal numbers of samples take equal times. Where samples are missing
    neither holds.
    """
    steps = intervals(t)
    if steps.size == 0:
        return False
    heel = float(np.quantile(steps, LEAST_HEELS))
    if heel >= HEELS * float(steps.mean()):
        return False
    waits = steps[steps > 1.5 * heel] / max(heel, 1e-12)
    off = waits - np.rint(waits)
    return heel <= 0.0 or waits.size == 0 or rms(off) > ON_GRID or _in_equal_times(steps, waits.size)


def _in_equal_times(steps: Array, waits: int) -> bool:
    """Whether as many samples take as much time: sums of intervals (n,) s scatter less than chance has it.

    So it is where samples wait and come together, and not where as many as that are missing. Stamps that are
    rounded, or computed, have waits that are multiples of the shorter intervals by themselves.
    """
    from scipy.special import chdtr  # noqa: PLC0415 - the daemon stays light

    pairs = waits // (2 * IN_PART)
    if pairs < PAIRS:
        return False
    sums = np.add.reduceat(steps, np.arange(2 * pairs) * steps.size // (2 * pairs))
    variance = steps.size / (2.0 * pairs) * float(steps.var())
    return float(chdtr(pairs, ((sums[1::2] - sums[::2]) ** 2).sum() / (2.0 * variance))) < CHANCE


ON_STEPS = 1e-3
"""Usual intervals by which each interval may be off a multiple of it, where stamps are rounded to as much."""


def more_even_than_chance(lost: Array) -> bool:
    """Whether the samples lost (n,) after each sample come more evenly than any that are lost by chance.

    The rounding of stamps, or a wrong period, makes such gaps, and nothing is lost in them. Losses by chance
    have binomial counts, or more uneven ones where they gather. Each part is held against the next one, so
    that losses may become more or fewer. Few gaps are judged by the distance from one to the next.
    """
    from scipy.special import chdtr  # noqa: PLC0415 - the daemon stays light

    gaps = np.sign(lost)
    share, pairs = abs(float(gaps.mean())), int(abs(gaps.sum())) // (2 * IN_PART)
    if pairs < PAIRS:
        return _evenly_apart(lost)
    if share >= 1.0:
        return False
    counts = np.add.reduceat(gaps, np.arange(2 * pairs) * gaps.size // (2 * pairs))
    variance = gaps.size / (2.0 * pairs) * share * (1.0 - share)
    return float(chdtr(pairs, ((counts[1::2] - counts[::2]) ** 2).sum() / (2.0 * variance))) < CHANCE


def _evenly_apart(lost: Array) -> bool:
    """Whether distances from gap to gap are more alike than chance makes them, two by two (Fisher's method).

    By chance the first of two is anything from 1 to their sum less 1.
    """
    from scipy.special import chdtrc  # noqa: PLC0415 - the daemon stays light

    apart = np.diff(_gaps(lost)[0])
    pairs = apart[: apart.size // 2 * 2].reshape(-1, 2)
    alike = np.maximum(np.abs(pairs[:, 0] - pairs[:, 1]), 0.5) / (pairs.sum(axis=1) - 1.0)
    return bool(pairs.size) and float(chdtrc(pairs.size, -2.0 * np.log(alike).sum())) < CHANCE


def _gaps(lost: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where the gaps (m,) are among the samples, and among these and the lost ones.

    Jitter beside a step's edge makes a gap that is taken back at once; the first time counts that so many
    samples are missing.
    """
    missing = np.cumsum(lost) * np.sign(lost.sum())
    most = np.maximum.accumulate(np.concatenate([[0.0], missing]))
    places = np.flatnonzero(np.diff(most))
    return places, places + most[places].astype(np.int64)


@once_per_array
def rounded_to_intervals(t: Array) -> bool:
    """Whether stamps t (n,) are rounded to steps as long as the usual interval, as 833 Hz in ms.

    Some intervals are then twice as long (or nothing, where the rate is higher than the steps'), more evenly
    than losses by chance. Their distances differ by one. Where they are the same, every so-many-th sample is
    lost, unless the interval is a step to which times are written (10 ms, 1 ms): then it may be either.
    """
    usual, longer = _in_intervals(t)
    if longer is None or not more_even_than_chance(longer):
        return False
    return not _equally_far_apart(longer) or abs(np.log10(usual) - np.rint(np.log10(usual))) < ON_STEPS


def rounded_or_lost(t: Array) -> bool:
    """Whether stamps that are `rounded_to_intervals`, as it seems, may have lost samples instead."""
    _, longer = _in_intervals(t)
    return longer is not None and _equally_far_apart(longer)


def _in_intervals(t: Array) -> tuple[float, Array | None]:
    """Return the usual interval, s, and by how many of it each is longer, if all are multiples."""
    steps = intervals(t)
    usual = float(np.median(steps)) if steps.size else 0.0
    if usual <= 0.0:
        return usual, None
    longer = np.rint(steps / usual) - 1.0
    return usual, longer if np.abs(steps / usual - 1.0 - longer).max() <= ON_STEPS else None


def _equally_far_apart(lost: Array) -> bool:
    """Whether most gaps, of three and more, lie at every so-many-th place, and the others anywhere.

    lost: (n,) samples after each one. Gaps that rounding makes come to be one place off, and stay so.
    """
    if lost.sum() <= 0.0:
        return False
    _, places = _gaps(lost)
    every = int(np.bincount(np.diff(places)).argmax())
    at = places % every
    off = np.abs(at - np.bincount(at).argmax())
    off = np.minimum(off, every - off)
    others = off[off > 0]
    return bool(2 * others.size < off.size and 2 * np.count_nonzero(others == 1) <= others.size)


@once_per_array
def sample_period(t: Array) -> float:
    """Return the interval of stamps t (n,), s; 0 with fewer than two.

    It is the mean of the intervals near the median, which rounding and missing samples do not move; of
    stamps in bursts, or rounded to steps as long as that, it is the mean of all.
    """
    steps = intervals(t)
    if not (steps > 0.0).any():
        return 0.0
    if bunched(t) or rounded_to_intervals(t):
        return float(steps.mean())
    middle = float(np.median(steps[steps > 0.0]))
    near = steps[np.abs(steps - middle) <= 0.5 * middle]
    return float(near.mean()) if near.size else middle
