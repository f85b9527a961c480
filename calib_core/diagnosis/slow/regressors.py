"""Curves that a slow effect may follow, at the middles of still bins: temperature, plug, age, heat."""

from __future__ import annotations

from itertools import product

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.hypothesis import Bank, Scene, moves
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.windows import WINDOW

Driver = tuple[dict[str, float], Array]
TAUS = (60.0, 120.0, 240.0, 480.0, 960.0, 1920.0)
STEPS = 250
PARTS = 6

LATENT_TAUS = (90.0, 200.0, 450.0, 900.0, 1800.0)
LEAST_SPAN = 0.3


def temperature(scene: Scene) -> list[Driver]:
    """Temperature about its mean, K; needs 0.3 K of span."""
    t = scene.bins.temperature
    return [] if t is None or not moves(t, LEAST_SPAN) else [({}, t - t.mean())]


def age(bins: Bins) -> Array:
    """Time since the recording began, s."""
    return np.asarray(bins.t - bins.span[0])


def warmup(scene: Scene) -> list[Driver]:
    """1 - exp(-age / tau), for tau up to half the recording."""
    half = (scene.bins.span[1] - scene.bins.span[0]) / 2.0
    return [({"tau_s": tau}, relaxation(scene.bins, tau)) for tau in TAUS if tau <= half]


def relaxation(bins: Bins, tau: float) -> Array:
    """1 - exp(-age / tau), (n,)."""
    return np.asarray(-np.expm1(-age(bins) / tau))


def drift(scene: Scene) -> list[Driver]:
    """Time since the beginning, s."""
    return [({}, age(scene.bins))]


def steps(scene: Scene) -> Bank | None:
    """One at and after a time, which may be within a bin: two bins from either end.

    A nudged phone steps across gravity too, so the tangent view is left out.
    """
    n = scene.bins.t.size
    if n < 6:
        return None
    inside = np.unique(np.linspace(2, n - 3, STEPS).round().astype(int))
    made = [_step_at(scene.bins, int(i), part) for i in inside for part in np.arange(PARTS) / PARTS]
    return Bank([g for g, _ in made], np.array([c for _, c in made])[:, None], 3 * inside.size)


def steps_near(scene: Scene, t_start: float) -> list[Driver]:
    """Return steps within three bins of `t_start`, s, more finely."""
    n = scene.bins.t.size
    middle = int(np.searchsorted(scene.bins.t, t_start))
    fine = np.arange(4 * PARTS) / (4 * PARTS)
    around = range(max(1, middle - 3), min(n - 1, middle + 3))
    return [_step_at(scene.bins, i, float(part)) for i in around for part in fine]


def _step_at(bins: Bins, i: int, part: float) -> Driver:
    """Step after a part of bin i, which keeps what is left of it; at its very start for a part of zero."""
    t_start = border(bins, i) if part == 0.0 else float(bins.t[i] + (part - 0.5) * bins.duration[i])
    index = np.arange(bins.t.size)
    return {"t_start": t_start}, np.where(index == i, 1.0 - part, (index > i).astype(float))


def border(bins: Bins, i: int) -> float:
    """Time between bins i - 1 and i, s."""
    return float((bins.t[i - 1] + bins.duration[i - 1] / 2 + bins.t[i] - bins.duration[i] / 2) / 2)


def charging(scene: Scene) -> list[Driver]:
    """One while on the charger."""
    c = scene.bins.charging
    return [] if c is None or not moves(c, 0.5) else [({}, c)]


def latent_heat(scene: Scene) -> list[Driver]:
    """First-order temperatures (arbitrary unit) that charging, use and a cool or warm start would give.

    Only where no thermometer was recorded. All sources share one time constant; their shares are gridded.
    """
    bins = scene.bins
    if bins.temperature is not None:
        return []
    sources = [(1.0, 0.0, 0.0), (1.0, 0.0, -0.7), (1.0, 0.0, 0.7), (1.0, 0.5, 0.0)]
    plugged = bins.charging_switches is not None and moves(bins.charging_switches[:, 1])
    if not plugged:
        sources = [(0.0, 1.0, 0.0), (0.0, 1.0, -0.7), (0.0, 1.0, 0.7)]
    found = []
    for tau, (plug, use, start) in product(LATENT_TAUS, sources):
        curve = heat(bins, tau, plug, use, start)
        if moves(curve, 0.05):
            found.append(({"tau_s": tau, "plug": plug, "use": use, "start": start}, curve / np.ptp(curve)))
    return found


def other_lags(bins: Bins) -> list[Array]:
    """Return the slow and fast parts that heat from the same sources, and a start off balance, may have."""
    plugged = bins.charging_switches is not None and moves(bins.charging_switches[:, 1])
    found = [heat(bins, tau, 1.0, 0.0, 0.0) for tau in (100.0, 600.0, 2400.0) if plugged]
    found += [heat(bins, tau, 0.0, 1.0, 0.0) for tau in (100.0, 600.0, 2400.0)]
    found += [relaxation(bins, tau) for tau in (150.0, 900.0, 2400.0)]
    return [curve / np.ptp(curve) for curve in found if moves(curve, 1e-3)]


def heat(bins: Bins, tau: float, plug: float, use: float, start: float) -> Array:
    """Solution (n,) of tau z' = plug on(t) + use active(t) - z, z(0) = start, at the bins."""
    t, active = bins.activity[:, 0], bins.activity[:, 1]
    on = np.zeros_like(t)
    if bins.charging_switches is not None:
        times, states = bins.charging_switches.T
        on = states[np.maximum(np.searchsorted(times, t, side="right") - 1, 0)]
    decay = np.exp(-WINDOW / tau)
    z = filtered(plug * on + use * active, decay)
    return np.asarray(np.interp(bins.t, t, z + start * np.exp(-(t - t[0]) / tau)))


def filtered(source: Array, decay: float) -> Array:
    """First-order response to a source at each of its samples, from nothing."""
    from scipy.signal import lfilter  # noqa: PLC0415 - the daemon stays light

    return np.asarray(lfilter([1.0 - decay], [1.0, -decay], source))
