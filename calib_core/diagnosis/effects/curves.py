"""What structure outside the catalogue may follow: drivers of smooth curves, and dictionaries over time.

They name no physics. Over time a smooth curve is noise, so there it is pulses, periods, sawteeth, what begins
at a moment and what begins with each rest, tried in large numbers. A Gaussian process over time scored 1 for
a bias that snapped between two levels, where two levels score 18.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.temperature import known
from stillcal.calib_core.diagnosis.model.effect import Dictionary, centred
from stillcal.calib_core.diagnosis.model.moments import Moments, first_order, moves
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import Index
from stillcal.calib_core.streams.time_series import TimeSeries

MOST_BORDERS = 250
CYCLES = 40.0
CYCLE_STEP, CYCLE_PARTS = 0.35, 7
"""Cycles in the recording from one period that is tried to the next, and how finely it is divided later."""

SAW_CYCLES = np.arange(1.5, 20.0, 0.15)
SAW_PHASES = 10
REST_TAUS = (15.0, 40.0, 100.0, 250.0, 600.0)
LAGS = (0.0, 200.0, 1000.0)
"""s by which a sensor's temperature may follow the thermometer's."""

BETWEEN = (20.0, 40.0, 80.0, 160.0, 320.0)
"""s of further lags of a straight line. In a chamber that swings, what is late by another lag is told by that
of a grid with steps of two; by a coarser one, a period in time fits better."""

HEATS = (60.0, 150.0, 400.0, 1000.0, 2500.0)
"""s within which a charger's heat builds up."""

NEAR = 0.1
"""Part of the width's square that the weighted times about a moment must spread by for a slope between them:
a line through bins on both sides, a width away, has all of it."""

Driver = Callable[[Moments, float], Array | None]
"""What a bias may follow (n,), None where it was not recorded or does not change, by a lag in s."""


def pulses(moments: Moments) -> Dictionary | None:
    """One between two borders of bins and nothing outside."""
    n = len(moments)
    if n < 6:
        return None
    borders = np.unique(np.linspace(2, n - 2, MOST_BORDERS).round().astype(int))
    first, last = np.triu_indices(borders.size, 1)
    times = [moments.border(int(i)) for i in borders]
    grids = [{"t_start": times[a], "t_end": times[b]} for a, b in zip(first, last, strict=True)]
    curves = (np.arange(n) >= borders[:, None]).astype(float)[:, None]
    return Dictionary(grids, curves, first.size // 3, np.stack([first, last], axis=1))


def switches(moments: Moments) -> Dictionary | None:
    """Return courses to and fro between two levels, changing between any two bins."""
    made = pulses(moments)
    return None if made is None else replace(made, switching=True)


def _shortest(moments: Moments) -> tuple[Array, float, float]:
    """Return the age (n,), the recording's length and the shortest period that bins can show, s."""
    start, end = moments.history.span
    return moments.age, end - start, 3.0 * float(np.median(moments.duration))


def cycle(moments: Moments, period: float) -> Array:
    """Return sine and cosine (2, n) of a period, s, as means over each moment."""
    phase = 2.0 * np.pi * moments.age / period
    return np.asarray(np.stack([np.sin(phase), np.cos(phase)]) * np.sinc(moments.duration / period))


def periods(moments: Moments) -> Dictionary | None:
    """Sine and cosine of a period, from 1.5 to `CYCLES` cycles in the recording, as bins can show."""
    _, span, shortest = _shortest(moments)
    cycles = np.arange(1.5, max(min(CYCLES, span / shortest), 1.6), CYCLE_STEP)
    curves = np.array([cycle(moments, span / c) for c in cycles])
    return Dictionary([{"period_s": float(span / c)} for c in cycles], curves, max(1, cycles.size // 2))


def periods_near(moments: Moments, period: float) -> list[float]:
    """Return periods within a step of one, s, by twentieths of a cycle in the recording."""
    start, end = moments.history.span
    away = np.arange(-CYCLE_PARTS, CYCLE_PARTS + 1) * CYCLE_STEP / CYCLE_PARTS
    return [float((end - start) / c) for c in (end - start) / period + away if c > 1.0]


def sawteeth(moments: Moments) -> Dictionary | None:
    """Ramps that fall back to their start, period by period."""
    t, span, shortest = _shortest(moments)
    cycles = [float(c) for c in SAW_CYCLES if c < span / shortest]
    made = list(product(cycles, np.arange(SAW_PHASES) / SAW_PHASES))
    if not made:
        return None
    curves = np.array([(t * c / span + phase) % 1.0 for c, phase in made])[:, None]
    return Dictionary([{"period_s": span / c} for c, _ in made], centred(curves), len(made) // 4)


def onsets(moments: Moments) -> Dictionary | None:
    """Return what settles, or ramps, from a moment on."""
    start, end = moments.history.span
    at = np.linspace(start, end, 26)[1:-1]
    taus = (60.0, 200.0, 600.0, 1e9)
    made = list(product(at, taus))
    t = moments.t
    curves = [np.where(t > a, -np.expm1(-np.maximum(t - a, 0.0) / tau), 0.0) for a, tau in made]
    grids = [{"t_start": float(a)} for a, _ in made]
    return Dictionary(grids, centred(np.array(curves)[:, None]), len(made) // 3)


def _rests(moments: Moments) -> tuple[Index, Array]:
    """Return the first bin of each rest (r,), and the time (r, n) since it began, s, negative before."""
    assert moments.rest is not None, "bins have rests"
    first = np.flatnonzero(np.diff(moments.rest, prepend=-1) != 0)
    began = moments.t[first] - moments.duration[first] / 2.0
    return first, np.asarray(moments.t[None, :] - began[:, None])


def since_moves(moments: Moments) -> Dictionary | None:
    """Return what begins anew with each rest and settles, or grows as long as the rest lasts."""
    if moments.rest is None or len(np.unique(moments.rest)) < 4:
        return None
    _, since = _rests(moments)
    age = np.where(since > 0.0, since, np.inf).min(axis=0)
    curves = [np.exp(-age / tau)[None] for tau in REST_TAUS] + [age[None]]
    return Dictionary([{} for _ in curves], centred(np.array(curves)), len(curves))


def strains(moments: Moments) -> Dictionary | None:
    """Return what a change of attitude leaves and what then settles, one curve a component of the change."""
    up = moments.up
    if up is None or moments.rest is None or len(np.unique(moments.rest)) < 6:
        return None
    first, since = _rests(moments)
    change = np.diff(up[first], axis=0, prepend=up[first[:1]])
    curves = []
    for tau in REST_TAUS[1:]:
        decay = np.where(since > 0.0, np.exp(-np.maximum(since, 0.0) / tau), 0.0)
        curves.append(change.T @ decay)
    return Dictionary([{"tau_s": tau} for tau in REST_TAUS[1:]], centred(np.array(curves)), len(curves))


def warmth(moments: Moments, lag: float) -> Array | None:
    """Return the temperature that a first-order system of this lag has, in balance at first."""
    now = moments.temperature
    if now is None or not known(moments) or lag == 0.0:
        return now if known(moments) else None
    return first_order(TimeSeries(moments.t, now), lag).at(moments.t)


def heating(moments: Moments, width: float) -> Array | None:
    """Return by how much the temperature rises, K/s. width: s, over which it is averaged; 0: between bins.

    A thermometer's noise and steps, divided by the time between two bins, are a good part of any rate. So
    the rate is the slope of a straight line through the temperatures about a moment, by Gaussian weights of
    this deviation. Where no other bin is as near it is that between bins.
    """
    now, t = warmth(moments, 0.0), moments.t
    if now is None:
        return None
    between = np.asarray(np.gradient(now, t))
    if width == 0.0:
        return between
    weight = np.exp(-0.5 * ((t[:, None] - t) / width) ** 2)
    weight /= weight.sum(axis=1, keepdims=True)
    away = t - (weight @ t)[:, None]
    spread = (weight * away**2).sum(axis=1)
    seen = spread > NEAR * width**2
    return np.where(seen, ((weight * away) @ now) / np.where(seen, spread, 1.0), between)


def plugged(moments: Moments, lag: float) -> Array | None:
    """Return what a first-order system of this lag makes of being on the charger."""
    if not moments.history.charger_moved:
        return None
    curve = moments.history.heat(moments.t, moments.duration, lag, 1.0, 0.0, 0.0)
    return curve if moves(curve, 1e-3) else None


def shaking(moments: Moments, lag: float) -> Array | None:
    """Return the logarithm of the power of vibration, where it changed by more than it commonly is."""
    power = moments.vibration
    if power is None or not power.size:
        return None
    usual = max(float(np.median(power)), 1e-12)
    return np.log1p(power / usual) if moves(power / usual, 1.0) else None
