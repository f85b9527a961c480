"""Dictionaries of generic curves: what structure outside the catalogue may look like, tried in large numbers.

They name no physics. Pulses, periods, sawteeth, what begins at a moment, what begins with each rest, and
what a driver's past does.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.temperature import known
from stillcal.calib_core.diagnosis.model.effect import Dictionary, centred
from stillcal.calib_core.diagnosis.model.moments import Moments, filtered, moves
from stillcal.calib_core.diagnosis.segments.static_bins import Index
from stillcal.calib_core.diagnosis.segments.windows import WINDOW

MOST_BORDERS = 250
CYCLES = 40.0
SAW_CYCLES = np.arange(1.5, 20.0, 0.15)
SAW_PHASES = 10
REST_TAUS = (15.0, 40.0, 100.0, 250.0, 600.0)
LAGS = (60.0, 150.0, 400.0, 1000.0, 2500.0)
PLAYS = (0.1, 0.2, 0.3, 0.45, 0.6, 0.75)


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


def periods(moments: Moments) -> Dictionary | None:
    """Sine and cosine of a period, from 1.5 to `CYCLES` cycles in the recording, as bins can show."""
    t, span, shortest = _shortest(moments)
    cycles = np.arange(1.5, max(min(CYCLES, span / shortest), 1.6), 0.35)
    phase = 2.0 * np.pi * cycles[:, None] * t / span
    curves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    return Dictionary([{"period_s": float(span / c)} for c in cycles], curves, max(1, cycles.size // 2))


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


def thermal_past(moments: Moments) -> Dictionary | None:
    """Return what follows temperature, but not at once, not in proportion, or not on the way back."""
    now = moments.temperature
    if now is None or not known(moments):
        return None
    lagged = [_lagged(moments.t, now, tau) for tau in LAGS]
    span = float(np.ptp(now))
    curves = [*lagged, *(now - past for past in lagged)]
    curves += [np.gradient(now, moments.t), np.maximum(now, 0.0)]
    plays = [_play(now, share * span) for share in PLAYS]
    curves += [*plays, *(_bent(play, now) for play in plays)]
    for share in PLAYS[1:4]:
        curves.append(np.maximum(now - now.min() - share * span, 0.0))
    return Dictionary([{} for _ in curves], centred(np.array(curves)[:, None]), len(curves))


def other_pasts(moments: Moments) -> Dictionary | None:
    """Return what follows charging or use with a lag, where a thermometer would have told heat."""
    if moments.temperature is None:
        return None
    sources = [(0.0, 1.0)]
    if moments.history.charger_moved:
        sources.append((1.0, 0.0))
    curves = [moments.history.heat(moments.t, tau, plug, use, 0.0) for tau in LAGS for plug, use in sources]
    kept = [c for c in curves if moves(c, 1e-3)]
    return Dictionary([{} for _ in kept], centred(np.array(kept)[:, None]), len(kept)) if kept else None


def _bent(x: Array, now: Array) -> Array:
    """Take off a curve (n,) what is in proportion to temperature: that part has a name."""
    return np.asarray(x - x.mean() - now * (now @ (x - x.mean())) / max(float(now @ now), 1e-12))


def _lagged(t: Array, x: Array, tau: float) -> Array:
    """First-order response to `x` (n,) at times `t`, beginning in balance."""
    grid = np.arange(t[0], t[-1] + WINDOW, WINDOW)
    fine = np.interp(grid, t, x)
    return np.asarray(np.interp(t, grid, x[0] + filtered(fine - x[0], float(np.exp(-WINDOW / tau)))))


def _play(x: Array, width: float) -> Array:
    """Return what a hysteresis of `width` makes of `x` (n,): it follows only once the play is used up."""
    out, state = np.empty_like(x), float(x[0])
    for i, value in enumerate(x):
        state = min(max(state, value - width / 2.0), value + width / 2.0)
        out[i] = state
    return out
