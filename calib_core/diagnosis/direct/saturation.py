"""Where values stop: a limit that nothing exceeds and on which samples pile up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.repeated_values import LEAST_ENDS, common_extreme
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Measured,
    direct_finding,
    of_chance,
    of_counts,
)
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Where
from stillcal.calib_core.diagnosis.segments.rests.stillness import runs_of
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT, comb_step
from stillcal.calib_core.streams.samples import Samples

AXES = (0, 1, 2)

LEAST_LIMIT = {"accel": 11.3, "gyro": 0.5}
"""m/s^2 and rad/s: below, an axis piles up at rest where gravity or nothing holds it."""

LEVEL = 1.5
"""Times as long within four widths of a value as within one: 1 on a level, 2 where a swing turns back."""

SHORT_OF_RANGE = 0.97
"""Part of the declared range from which a limit is that range."""

LEAST_PILE = 8
"""Samples that must lie on a limit."""

MOST_PILED = 0.5
"""Part of the samples above which what they lie on is no limit, but a width taken from what was no rest."""

LEAST_LEVELS = 5
"""Different values below a limit that samples on it are counted against."""

LEAST_VISITS = 3
"""Times that values must come to a limit."""

SPREAD = 0.02
"""Part of its size by which bias and scale set the ends of the axes apart: 20 mg and 1 to 2 %."""

REACH, WIDTHS = 0.1, 6.0
"""Part of a limit below it in which excursions end elsewhere, and so many widths at least."""


@dataclass(frozen=True, slots=True)
class Limit:
    """A limit of one axis with its standard error, and nats for it."""

    value: float
    error: float
    nats: float


@dataclass(frozen=True, slots=True)
class _Scale:
    """Of one axis its noise and its step (0: none), and the width within which a value is the largest one."""

    noise: float
    step: float
    width: float


_Judge = Callable[[Array, NDArray[np.bool_], _Scale], float | None]
"""Takes values (n,) and which of them (n,) are the largest one; returns nats for a limit there, or None."""


def saturation(samples: Samples, sensor: str, noise: Array, declared: float | None) -> Finding | None:
    """Find a value short of the declared range that nothing exceeds and on which samples pile up.

    noise: (3,) standard deviation at rest.
    """
    limits = {
        a: limit
        for a in AXES
        if (limit := _limit(samples.xyz[:, a], float(noise[a]), LEAST_LIMIT[sensor])) is not None
        and (not declared or limit.value < SHORT_OF_RANGE * declared)
    }
    for a, limit in _common(samples.xyz, declared).items():
        # A top that looks flat is no evidence by itself where its axis was there once or twice.
        if a not in limits or limits[a].nats < limit.nats:
            limits[a] = limit
    if not limits:
        return None
    axes = list(limits)
    value = float(np.median([one.value for one in limits.values()]))
    error = max([1e-4 * value, *(one.error for one in limits.values())])
    width = 4.0 * error + 4.0 * noise[axes]
    rows = np.flatnonzero((np.abs(samples.xyz[:, axes]) > value - width).any(axis=1))
    where = Where(float(samples.t[rows[0]]), float(samples.t[rows[-1]]), (0.0, 0.0), "own input")
    faster = "larger acceleration" if sensor == "accel" else "faster rotation"
    say = (
        f"The {NAME[sensor]} saturates at {value:.4g} {UNIT[sensor]} ({rows.size} samples,"
        f" {rows.size / len(samples):.2%}); {faster} is clipped."
    )
    return direct_finding(
        f"{sensor}_saturation",
        sensor,
        axes,
        where,
        {"limit": Measured(value, error).parameter(UNIT[sensor])},
        statement=say,
        seen=DirectEvidence(sum(one.nats for one in limits.values())),
    )


def _common(xyz: Array, declared: float | None) -> dict[int, Limit]:
    """Return the limit at which most ends of the axes stop, whatever lies there most of the time.

    A phone that rests there clips gravity. Without a limit the ends, which are gravity's or the motion's,
    differ by bias and scale: evenly over `SPREAD` of their size.
    """
    value, count, within = common_extreme(xyz)
    if count < LEAST_ENDS or (declared and value >= SHORT_OF_RANGE * declared):
        return {}
    nats = of_chance((count - 1) * float(np.log(min(within / (SPREAD * value), 1.0))), 6.0)
    axes = [a for a in AXES if np.abs(xyz[:, a]).max() >= value - within]
    return {a: Limit(value, within / float(np.sqrt(12.0)), nats / len(axes)) for a in axes}


def _limit(values: Array, noise: float, least: float) -> Limit | None:
    """Return the limit of one axis, of values clipped after their noise or before it."""
    step = comb_step(values) or 0.0
    # Values of few levels end on their highest by themselves, evenly spaced or not.
    hard = [] if step > noise or np.unique(values).size <= LEAST_LEVELS else [_hard_stop, _stays]
    stops = [stop for of in hard if (stop := _on_largest(values, noise, step, of)) is not None]
    return max(stops, key=lambda stop: stop.nats, default=None) or _flat_top(values, noise, least)


def _on_largest(values: Array, noise: float, step: float, nats_of: _Judge) -> Limit | None:
    """Return a limit that values end on, of either sign, where the samples on the very largest one tell it.

    Clipped after its noise, a sensor returns one value. Only where steps are finer than the noise, so that no
    rest ends on the largest value by itself. step: of the values, 0 for none; nats_of: what tells.
    """
    found, nats = [], 0.0
    for signed in (values, -values):
        top = float(signed.max())
        width = max(1e-6 * abs(top), 0.1 * step)
        of_limit = nats_of(signed, signed >= top - width, _Scale(noise, step, width))
        if of_limit is not None:
            found.append(abs(top))
            nats += of_limit
    if not found:
        return None
    return Limit(max(found), max(step / np.sqrt(12.0), 1e-6 * max(found)), nats)


def _hard_stop(signed: Array, on: NDArray[np.bool_], scale: _Scale) -> float | None:
    """Return nats for values that lie on the very largest one time and again; None where they do not.

    Noise would have spread over the steps below it. Evidence is the number of visits to that value, binomial
    among those and the samples just below. Where hardly any lie there, as below the top of a blow, those on
    the next `LEAST_LEVELS` values below count, of which the top would be one.
    """
    noise, step = scale.noise, scale.step
    below = signed[~on]
    under = below[below > float(signed.max()) - 3.0 * noise]
    visits = int((on[1:] & ~on[:-1]).sum())
    if on.sum() < LEAST_PILE or visits < LEAST_VISITS:
        return None
    # By chance on the top step, or, where there are no steps, within `width` of the top of a sine.
    share = step / (3.0 * noise) if step else float(np.sqrt(scale.width / (3.0 * noise)))
    if np.unique(under).size < LEAST_LEVELS:
        under = below[below >= np.unique(below)[-LEAST_LEVELS:].min(initial=np.inf)]
        share = max(share, 1.0 / LEAST_LEVELS)
    if on.sum() < 5.0 * (under.size * share + 1.0):
        return None
    return of_counts(float(visits), float(visits + under.size), min(share, 0.5))


def _stays(signed: Array, on: NDArray[np.bool_], scale: _Scale) -> float | None:
    """Return nats for values that stay on the very largest one in every visit, as nowhere else.

    However fast they come there and go, so that few lie just below it. Each sample that stays has the chance
    with which values repeat the one before elsewhere, or with which noise at rest takes its likeliest step.
    Six limits, of three axes and two signs, were tried. None where they do not stay, or came there once: a
    single stay may be a sample that was held.
    """
    stays = int((on[1:] & on[:-1]).sum())
    visits = int(on.sum()) - stays
    if visits < 2 or stays < visits:
        return None
    elsewhere = ~on[1:]
    repeats = int((np.diff(signed)[elsewhere] == 0.0).sum())
    by_noise = scale.step / (float(np.sqrt(2.0 * np.pi)) * scale.noise)
    chance = max((repeats + 1.0) / (elsewhere.sum() + 2.0), by_noise)
    nats = of_chance(stays * float(np.log(chance)), 6.0)
    return nats if DirectEvidence(nats).stated else None


def _flat_top(values: Array, noise: float, least: float) -> Limit | None:
    """Return where the largest values pile up as no motion would make them."""
    size = np.abs(values)
    top = float(size.max())
    width = max(4.0 * noise, 1e-4 * top)
    if top < least:
        return None
    pile = size > top - 2.0 * width
    below = int(((size > top - 6.0 * width) & ~pile).sum())
    runs = int((pile[1:] & pile[:-1]).sum())
    few = pile.sum() < LEAST_PILE or runs < LEAST_VISITS or pile.sum() < 3.0 * (below + 1)
    if few or pile.mean() > MOST_PILED:
        return None
    on = size[pile]
    if _stands_below(size, pile, least, width):
        return None
    nats = sum(_by_excursions(signed, top, width) for signed in (values, -values))
    return Limit(float(np.median(on)), float(on.std() / np.sqrt(on.size)), nats)


def _stands_below(size: Array, pile: NDArray[np.bool_], least: float, width: float) -> bool:
    """Whether values stand still below the largest ones as often as there, and as long.

    Then what moves the axis stops at a speed of its own, as a motor does. A limit is the only value at which
    clipped motion stands still.
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # noqa: PLC0415 - the daemon stays light

    lasts = [b - a for a, b in runs_of(pile)]
    n = int(np.median([samples for samples in lasts if samples > 1]))
    span = maximum_filter1d(size, n) - minimum_filter1d(size, n)
    still = (span < 2.0 * width) & (size > least) & (size < float(size.max()) - 6.0 * width)
    return sum(_is_level(size, a - n // 2, b + n // 2, width) for a, b in runs_of(still)) >= len(lasts)


def _is_level(size: Array, a: int, b: int, width: float) -> bool:
    """Whether samples a to b lie on one value that was come to and left at once.

    A swing is for a moment still where it turns back, too: it is within four widths of that value for twice
    as long as within one, and a slow change for four times as long.
    """
    around = size[max(a - (b - a), 0) : b + (b - a)]
    away = np.abs(around - np.median(size[max(a, 0) : b]))
    return bool((away < 4.0 * width).sum() < LEVEL * (away < width).sum())


def _by_excursions(signed: Array, limit: float, width: float) -> float:
    """Return nats for a limit of one sign: of the excursions near it too many end at one value.

    Without a limit their largest values lie anywhere within reach of it, evenly. An excursion is one trial
    however long it stays there. Six limits, of three axes and two signs, were tried.
    """
    reach = max(REACH * limit, WIDTHS * width)
    above = signed > limit - reach
    starts = np.flatnonzero(above & ~np.concatenate([[False], above[:-1]]))
    if starts.size < 2:
        return 0.0
    peaks = np.maximum.reduceat(np.where(above, signed, -np.inf), starts)
    at = int((peaks > peaks.max() - width).sum())
    chance = (at - 1) * float(np.log(width / reach)) + _log_choose(peaks.size - 1, at - 1)
    return max(of_chance(min(chance, 0.0), 6.0), 0.0)


def _log_choose(n: int, k: int) -> float:
    from scipy.special import gammaln  # noqa: PLC0415 - the daemon stays light

    return float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))
