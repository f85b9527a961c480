"""Banks of generic curves: what structure outside the catalogue may look like, tried in large numbers.

They name no physics. Pulses, periods, sawteeth, what begins at a moment, what begins with each rest, and
what a driver's past does.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.hypothesis import Bank, Scene, moves
from stillcal.calib_core.diagnosis.segments.static_bins import Bins, Index
from stillcal.calib_core.diagnosis.segments.windows import WINDOW
from stillcal.calib_core.diagnosis.slow import regressors as drivers

CYCLES = 40.0
SAW_CYCLES = np.arange(1.5, 20.0, 0.15)
SAW_PHASES = 10
REST_TAUS = (15.0, 40.0, 100.0, 250.0, 600.0)
LAGS = (60.0, 150.0, 400.0, 1000.0, 2500.0)
PLAYS = (0.1, 0.2, 0.3, 0.45, 0.6, 0.75)


def _centred(curves: Array) -> Array:
    """Take means off curves (K, q, N) and scale each to a range of one."""
    away = curves - curves.mean(axis=2, keepdims=True)
    return np.asarray(away / np.maximum(np.ptp(away, axis=2, keepdims=True), 1e-9))


def pulses(scene: Scene) -> Bank | None:
    """One between two borders of bins and nothing outside."""
    n = len(scene.bins)
    if n < 6:
        return None
    borders = np.unique(np.linspace(2, n - 2, drivers.STEPS).round().astype(int))
    first, last = np.triu_indices(borders.size, 1)
    times = [drivers.border(scene.bins, int(i)) for i in borders]
    grids = [{"t_start": times[a], "t_end": times[b]} for a, b in zip(first, last, strict=True)]
    curves = (np.arange(n) >= borders[:, None]).astype(float)[:, None]
    return Bank(grids, curves, first.size // 3, np.stack([first, last], axis=1))


def switches(scene: Scene) -> Bank | None:
    """Return courses to and fro between two levels, changing between any two bins."""
    bank = pulses(scene)
    return None if bank is None else replace(bank, switching=True)


def periods(scene: Scene) -> Bank | None:
    """Sine and cosine of a period, from 1.5 to `CYCLES` cycles in the recording, as bins can show."""
    t, span = scene.bins.t - scene.bins.span[0], scene.bins.span[1] - scene.bins.span[0]
    shortest = 3.0 * float(np.median(scene.bins.duration))
    cycles = np.arange(1.5, max(min(CYCLES, span / shortest), 1.6), 0.35)
    phase = 2.0 * np.pi * cycles[:, None] * t / span
    curves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    return Bank([{"period_s": float(span / c)} for c in cycles], curves, max(1, cycles.size // 2))


def sawteeth(scene: Scene) -> Bank | None:
    """Ramps that fall back to their start, period by period."""
    t, span = scene.bins.t - scene.bins.span[0], scene.bins.span[1] - scene.bins.span[0]
    shortest = 3.0 * float(np.median(scene.bins.duration))
    cycles = [float(c) for c in SAW_CYCLES if c < span / shortest]
    made = list(product(cycles, np.arange(SAW_PHASES) / SAW_PHASES))
    if not made:
        return None
    curves = np.array([(t * c / span + phase) % 1.0 for c, phase in made])[:, None]
    return Bank([{"period_s": span / c} for c, _ in made], _centred(curves), len(made) // 4)


def moments(scene: Scene) -> Bank | None:
    """Return what settles, or ramps, from a moment on."""
    start, end = scene.bins.span
    t = scene.bins.t
    at = np.linspace(start, end, 26)[1:-1]
    taus = (60.0, 200.0, 600.0, 1e9)
    made = list(product(at, taus))
    curves = [np.where(t > a, -np.expm1(-np.maximum(t - a, 0.0) / tau), 0.0) for a, tau in made]
    grids = [{"t_start": float(a)} for a, _ in made]
    return Bank(grids, _centred(np.array(curves)[:, None]), len(made) // 3)


def _rests(bins: Bins) -> tuple[Index, Array]:
    """Return the first bin of each rest (r,), and the time (r, N) since it began, s, negative before."""
    first = np.flatnonzero(np.diff(bins.rest, prepend=-1) != 0)
    began = bins.t[first] - bins.duration[first] / 2.0
    return first, np.asarray(bins.t[None, :] - began[:, None])


def since_moves(scene: Scene) -> Bank | None:
    """Return what begins anew with each rest and settles, or grows as long as the rest lasts."""
    bins = scene.bins
    if len(np.unique(bins.rest)) < 4:
        return None
    _, since = _rests(bins)
    age = np.where(since > 0.0, since, np.inf).min(axis=0)
    curves = [np.exp(-age / tau)[None] for tau in REST_TAUS] + [age[None]]
    return Bank([{} for _ in curves], _centred(np.array(curves)), len(curves))


def strains(scene: Scene) -> Bank | None:
    """Return what a change of attitude leaves and what then settles, one curve a component of the change."""
    bins = scene.bins
    if scene.up is None or len(np.unique(bins.rest)) < 6:
        return None
    first, since = _rests(bins)
    change = np.diff(scene.up[first], axis=0, prepend=scene.up[first[:1]])
    curves = []
    for tau in REST_TAUS[1:]:
        decay = np.where(since > 0.0, np.exp(-np.maximum(since, 0.0) / tau), 0.0)
        curves.append(change.T @ decay)
    return Bank([{"tau_s": tau} for tau in REST_TAUS[1:]], _centred(np.array(curves)), len(curves))


def thermal_past(scene: Scene) -> Bank | None:
    """Return what follows temperature, but not at once, not in proportion, or not on the way back."""
    bins = scene.bins
    known = drivers.temperature(scene)
    if not known:
        return None
    now = known[0][1]
    lagged = [_lagged(bins.t, now, tau) for tau in LAGS]
    span = float(np.ptp(now))
    curves = [*lagged, *(now - past for past in lagged)]
    curves += [now**2, now**3, np.gradient(now, bins.t), np.maximum(now, 0.0)]
    plays = [_play(now, share * span) for share in PLAYS]
    curves += [*plays, *(_bent(play, now) for play in plays), _bent(now**2, now), _bent(now**3, now)]
    for share in PLAYS[1:4]:
        curves.append(np.maximum(now - now.min() - share * span, 0.0))
    return Bank([{} for _ in curves], _centred(np.array(curves)[:, None]), len(curves))


def other_pasts(scene: Scene) -> Bank | None:
    """Return what follows charging or use with a lag, where a thermometer would have told heat."""
    bins = scene.bins
    if bins.temperature is None:
        return None
    sources = [(0.0, 1.0)]
    if bins.charging_switches is not None and moves(bins.charging_switches[:, 1]):
        sources.append((1.0, 0.0))
    curves = [drivers.heat(bins, tau, plug, use, 0.0) for tau in LAGS for plug, use in sources]
    kept = [c for c in curves if moves(c, 1e-3)]
    return Bank([{} for _ in kept], _centred(np.array(kept)[:, None]), len(kept)) if kept else None


def _bent(x: Array, now: Array) -> Array:
    """Take off a curve (N,) what is in proportion to temperature: that part has a name."""
    return np.asarray(x - x.mean() - now * (now @ (x - x.mean())) / max(float(now @ now), 1e-12))


def _lagged(t: Array, x: Array, tau: float) -> Array:
    """First-order response to `x` (N,) at times `t`, beginning in balance."""
    grid = np.arange(t[0], t[-1] + WINDOW, WINDOW)
    fine = np.interp(grid, t, x)
    return np.asarray(np.interp(t, grid, x[0] + drivers.filtered(fine - x[0], float(np.exp(-WINDOW / tau)))))


def _play(x: Array, width: float) -> Array:
    """Return what a hysteresis of `width` makes of `x` (N,): it follows only once the play is used up."""
    out, state = np.empty_like(x), float(x[0])
    for i, value in enumerate(x):
        state = min(max(state, value - width / 2.0), value + width / 2.0)
        out[i] = state
    return out
