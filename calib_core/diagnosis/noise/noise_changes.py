"""Noise that is not always of one level: one sensor's own, white at every level or low-passed at one.

Its level by piece of rest is held against a stretch of time, temperature and charging. What moves or shakes
the phone differs from rest to rest and has a spectrum of its own, so a change counts only where the pieces
are as even about it as noise makes them, and where all bands change alike or as a low-pass changes them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import (
    FOLDS,
    DirectEvidence,
    HeldOut,
    Index,
    direct_finding,
    of_chance,
    of_fit,
    sized,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.noise.low_pass import SHARED, Spectra
from stillcal.calib_core.diagnosis.noise.noise_level import Levels
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.maths.f_distribution import log_tail
from stillcal.calib_core.maths.rms import rms

LEAST_PIECES = 5
LEAST_CHANGE = 0.22
EVEN = 2.0
NINE_IN_TEN = 1.645
WHITE = 0.25
BANDS = 6
KNOTS = 4
"""Places between which the level is straight over temperature, evenly spaced in rank or in kelvin."""

LEAST_RESTS = 10
"""Rests whose level by force is looked at: three numbers are fitted."""

LEAST_BY_FORCE = 0.12
"""Natural logarithm of two levels by which noise must follow the force."""

EITHER_SIDE = 0.5
"""Part of its bend that may be the slope of a curve that falls to both sides: by a half of its
bend to one, by three halves to the other."""

MOST_LEVERAGE = 0.5
"""Leverage of a rest above which its own level makes most of what the curve says there."""

LEAST_RANGE = 1.0
"""Kelvin that a temperature must go through for noise to follow it."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelModel:
    """What the level may follow. driver: its name; design: (n, k); span: s, its change; tries: paid."""

    driver: str
    design: Array
    span: tuple[float, float]
    tries: float


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    course: LevelModel
    fitted: Array
    high: NDArray[np.bool_]
    change: float
    seen: DirectEvidence


def changing(spectrum: Spectra, measured: Levels, sensor: str, bins: Bins) -> Finding | None:
    """Find what the level of the noise follows, the best of what is even and of a sensor's own spectrum."""
    level = np.log(measured.pieces).mean(axis=1)
    if level.size < 3 * LEAST_PIECES:
        return None
    own = _bins_of(spectrum, bins)
    fits = [
        fit
        for course in _courses(level, spectrum.t, bins, own)
        if (fit := _fitted(level, course, spectrum, bins.rest[own])) is not None
        and _of_sensor(spectrum, fit.high)
    ]
    if not fits:
        return None
    best = max(fits, key=lambda fit: fit.seen.log_bayes_factor)
    return _stated(best, measured, sensor, spectrum.rate)


def by_force(spectrum: Spectra, measured: Levels, sensor: str, bins: Bins) -> Finding | None:
    """Find noise of single axes that follows the force along them, as of a reference that makes it by ratio.

    The level of a rest is the mean of its pieces, a parabola of the force against a constant; what shakes the
    phone differs from rest to rest, and makes the variance that F's law holds the parabola against. What
    tilts it to and fro, as a hand does, moves gravity on the axes across it only: no reference does. A rest
    of few pieces counts for less. A place where it always lies alike shakes it by more, so pieces must
    scatter about the parabola as noise does.
    """
    own = _bins_of(spectrum, bins)
    rests, which = np.unique(bins.rest[own], return_inverse=True)
    if rests.size < LEAST_RESTS:
        return None
    count = np.bincount(which)[:, None]
    pieces, along = np.log(measured.pieces), bins.force[own] / STANDARD
    level, force = _summed(which, pieces) / count, _summed(which, along) / count
    of_piece = float(np.sqrt(3.0)) * _chance(spectrum, np.ones(own.size, dtype=np.bool_))
    by_chance = EVEN * of_piece + 0.03
    fits = [parabola_of_force(level[:, a], force[:, a], of_piece**2 / count[:, 0]) for a in range(3)]
    clear = [
        a
        for a in range(3)
        if fits[a].nats > 0.0
        and fits[a].change >= LEAST_BY_FORCE
        and not _of_tilts(fits[a].curve)
        and _scatter(pieces[:, a] - _parabola(along[:, a]) @ fits[a].curve) < by_chance
    ]
    if not clear:
        return None
    best = max(clear, key=lambda a: fits[a].nats)
    ratio = float(np.exp(fits[best].change))
    say = (
        f"The {NAME[sensor]}'s noise follows the force along its own axis: {ratio:.2f} times from the least"
        f" to the most on {AXES[best]}."
    )
    where = Where(float(spectrum.t[0]), float(spectrum.t[-1]), (0.0, spectrum.rate / 2.0), "own force")
    seen = DirectEvidence(fits[best].nats - float(np.log(3.0)), fits[best].held_out)
    return direct_finding(
        "unknown", sensor, clear, where, sized({"ratio": (ratio, "1")}), statement=say, seen=seen
    )


def _of_tilts(curve: Array) -> bool:
    """Whether a parabola (3,) of the force, in units of gravity, falls from none to either side of it.

    A tilt by an angle changes an axis by that times the force across it, so not one along gravity.
    """
    _, slope, bend = curve
    return bool(abs(slope) < -EITHER_SIDE * bend)


def _bins_of(spectrum: Spectra, bins: Bins) -> Index:
    """Return the bin (P,) in which each piece of rest begins."""
    begun = np.searchsorted(bins.t - bins.duration / 2, spectrum.t[:-1] + 1e-6, side="right")
    return np.maximum(begun - 1, 0)


def _summed(which: Index, values: Array) -> Array:
    """Return sums of values (n, k) by group (n,)."""
    return np.stack([np.bincount(which, weights=column) for column in values.T], axis=1)


def _parabola(force: Array) -> Array:
    """Return the design (n, 3) of a parabola of a force (n,)."""
    return np.stack([np.ones(force.size), force, force**2], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class ByForce:
    """A parabola of the force, curve (3,), by which levels change by so much; nats for it."""

    nats: float
    change: float
    held_out: HeldOut
    curve: Array


def parabola_of_force(level: Array, force: Array, by_chance: Array) -> ByForce:
    """Return the parabola of levels (n,) over a force (n,), and how it foretells rests left out.

    A rest in which the curve goes where that rest has it says nothing of the others: it may be the one that
    is shaken. by_chance: the variance (n,) that the level of each rest has by chance alone.
    """
    design, free = _parabola(force), level.size - 3
    left = level - design @ _least_squares(design, level)
    between = max(float((left**2).sum()) / free - float(by_chance.mean()), 0.0)
    weight = 1.0 / np.sqrt(between + by_chance)
    curve = _least_squares(design * weight[:, None], level * weight)
    sole = _leverage(design * weight[:, None]) > MOST_LEVERAGE
    if sole.any():
        if (~sole).sum() < LEAST_RESTS:
            return ByForce(0.0, 0.0, HeldOut(0.0, 0.0, 0.0), curve)
        return parabola_of_force(level[~sole], force[~sole], by_chance[~sole])
    fitted, mean = design @ curve, np.average(level, weights=weight**2)
    without, within = (float((((level - said) * weight) ** 2).sum()) for said in (mean, fitted))
    chance = log_tail(0.5 * (without - within) * free / max(within, 1e-300), 2, free)
    held_out = _left_out(level, LevelModel("own force", design, (0.0, 0.0), 3.0), np.arange(level.size))
    return ByForce(of_chance(chance), float(np.ptp(fitted)), held_out, curve)


def _courses(level: Array, t: Array, bins: Bins, own: Index) -> list[LevelModel]:
    n, whole = level.size, (float(t[0]), float(t[-1]))
    first, last = _run(level)
    inside = np.zeros(n, dtype=bool)
    inside[first:last] = True
    span = (float(t[first]), float(t[last]))
    made = [LevelModel("time", np.stack([np.ones(n), inside], axis=1), span, 0.5 * n * n)]
    if bins.temperature is not None and np.ptp(bins.temperature[own]) > LEAST_RANGE:
        warm, places = bins.temperature[own], np.linspace(0.0, 1.0, KNOTS)
        for knots in (np.quantile(warm, places), warm.min() + np.ptp(warm) * places):
            made.append(LevelModel("temperature", _hats(warm, np.unique(knots)), whole, 6.0))
    if bins.charging is not None:
        made.append(LevelModel("charging", np.stack([np.ones(n), bins.charging[own]], axis=1), whole, 3.0))
    return made


def _hats(x: Array, knots: Array) -> Array:
    """Return the design (n, k) of a curve over x (n,) that is straight between knots (k,)."""
    return np.stack([np.interp(x, knots, row) for row in np.eye(knots.size)], axis=1)


def _fitted(level: Array, course: LevelModel, spectrum: Spectra, rest: Index) -> _Fit | None:
    """Fit a course to the level (n,); None where the change is small, by chance, or uneven."""
    fitted = course.design @ _least_squares(course.design, level)
    high = fitted > 0.5 * (fitted.max() + fitted.min())
    if min(high.sum(), (~high).sum()) < LEAST_PIECES:
        return None
    change = float(np.ptp(fitted))
    left, groups = level - fitted, (high, ~high)
    spreads = [(_scatter(left[rows]), _chance(spectrum, rows)) for rows in groups]
    if change < LEAST_CHANGE or any(seen > EVEN * chance + 0.03 for seen, chance in spreads):
        return None
    spread = max(max(pair) for pair in spreads)
    gained = 0.5 * float(((level - level.mean()) ** 2).sum() - (left**2).sum()) / spread**2
    held_out = _left_out(level, course, rest)
    seen = DirectEvidence(of_fit(gained, course.design.shape[1], level.size, course.tries), held_out)
    if not seen.stated or held_out.gain < np.log(course.tries):
        return None
    return _Fit(course, fitted, high, change, seen)


def _chance(spectrum: Spectra, rows: NDArray[np.bool_]) -> float:
    """Return the standard deviation that the level (a logarithm) of some pieces has by chance.

    A density averaged over powers p has as many independent ones as (sum p)^2 / sum p^2.
    """
    flat = np.median(spectrum.power[rows], axis=0) / spectrum.shape()
    power = flat[spectrum.band]
    count = float((power.sum(axis=0) ** 2 / np.maximum((power**2).sum(axis=0), 1e-300)).sum())
    return 0.5 * float(np.sqrt(SHARED / (np.median(spectrum.averages[rows]) * max(count, 1.0))))


def _leverage(design: Array) -> Array:
    """Return the part (n,) of each observation in what is fitted there."""
    return np.asarray((np.linalg.qr(design)[0] ** 2).sum(axis=1))


def _least_squares(design: Array, level: Array) -> Array:
    return np.asarray(np.linalg.lstsq(design, level, rcond=None)[0])


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
    """Return the standard deviation by what nine in ten keep to: a knocked rest may be off, not a third."""
    return float(np.quantile(np.abs(values - np.median(values)), 0.9)) / NINE_IN_TEN


def _of_sensor(spectrum: Spectra, high: NDArray[np.bool_]) -> bool:
    """Whether white noise was multiplied or added, or a low-pass took noise away.

    Neither roads nor steps in the house nor a charger that hums do so: what shakes has a spectrum of its own.
    """
    loud, faint = (_by_band(spectrum, rows) for rows in (high, ~high))
    ratio = np.log(faint / loud)
    if _alike(ratio) or ((loud > faint).all() and _alike(np.log(loud - faint))):
        return True
    return _rise(np.log(loud)) < WHITE and _rise(ratio) < WHITE and ratio[0] > 0.5 * ratio.min()


def _by_band(spectrum: Spectra, rows: NDArray[np.bool_]) -> Array:
    """Return the median power of some pieces in each of six bands, (6,), all axes together."""
    power = np.maximum(np.median(spectrum.power[rows], axis=0)[spectrum.band], 1e-300)
    return np.array([np.exp(np.log(part).mean()) for part in np.array_split(power, BANDS)])


def _alike(course: Array) -> bool:
    """Whether a logarithm of power is the same in all bands."""
    return float(np.ptp(course)) < WHITE


def _rise(course: Array) -> float:
    """Return the most by which a band is above one at lower frequency."""
    return float((course - np.minimum.accumulate(course)).max())


def _stated(fit: _Fit, measured: Levels, sensor: str, rate: float) -> Finding | None:
    ratio, (start, end) = float(np.exp(fit.change)), fit.course.span
    by_axis = np.log(measured.pieces)
    changes = np.median(by_axis[fit.high], axis=0) - np.median(by_axis[~fit.high], axis=0)
    axes = [a for a in range(3) if abs(changes[a]) > 0.5 * np.abs(changes).max()]
    if fit.course.driver == "time":
        inside = fit.course.design[:, 1] > 0.5
        ratio = ratio if (inside == fit.high).all() else 1.0 / ratio
        span = f"From {start:.0f} to {end:.0f} s"
        say = f"{span} the {NAME[sensor]}'s noise is {ratio:.2f} times its usual level."
    else:
        change = f"{ratio:.2f} times between low and high"
        say = f"The {NAME[sensor]}'s noise changes with {fit.course.driver}: {change}."
    where = Where(start, end, (0.0, rate / 2.0), fit.course.driver)
    sizes = sized({"ratio": (ratio, "1")})
    return direct_finding("unknown", sensor, axes, where, sizes, statement=say, seen=fit.seen)


def _left_out(level: Array, course: LevelModel, rest: Index) -> HeldOut:
    """Predict the level of pieces left out by the course fitted to the others, and by their mean.

    Rests are left out whole, but of a stretch of time every fifth piece: a rest may hold all of it.
    """
    fold = (np.arange(level.size) if course.driver == "time" else rest) % FOLDS
    gain, before, after = 0.0, np.zeros(level.size), np.zeros(level.size)
    for k in np.unique(fold):
        train, test = fold != k, fold == k
        if not train.any():
            return HeldOut(0.0, rms(level - level.mean()), 0.0)
        before[test] = level[test] - level[train].mean()
        parameters = _least_squares(course.design[train], level[train])
        after[test] = level[test] - course.design[test] @ parameters
        s0 = max(rms(level[train] - level[train].mean()), 1e-12)
        s1 = max(rms(level[train] - course.design[train] @ parameters), 1e-12)
        gain += float(
            (np.log(s0 / s1) + 0.5 * (before[test] / s0) ** 2 - 0.5 * (after[test] / s1) ** 2).sum()
        )
    return HeldOut(gain, rms(before), rms(after))
