"""Effects to be put into the simple phones of `nulls`: the catalogue's slow ones and some that are not in it.

Written apart from the estimator: the catalogue's effects are played by the examiner of the blind test, the
others here. Each gives the error (n, 3) of one sensor, second by second, on a size of one; `sized` scales it
to a d' under the noise that was really drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.replay.blind_test.world.day import World
from stillcal.replay.blind_test.world.forward_model import played
from tests.support.diagnosis import nulls

Array = np.ndarray
Curve = Callable[[np.random.Generator, nulls.Day, Array], Array]
LARGEST = {"accel": 0.6, "gyro": 0.05}
CATALOGUE = (
    "bias_temperature", "warmup", "thermal_latent", "bias_step", "bias_drift", "charging_bias",
    "scale_temperature", "nonlinearity", "g_sensitivity",
)  # fmt: skip
OFF_CATALOGUE = (
    "hysteresis", "cycle", "sawtooth", "telegraph", "zeroing", "strain", "pulses", "lagged_temperature",
    "flipped", "slow_sine",
)  # fmt: skip


@dataclass
class Put:
    """An effect put in. error: (n, 3); name: the catalogue's, or None; value: what scales its parameter."""

    sensor: str
    kind: str
    name: str | None
    error: Array
    value: Array
    grid: dict[str, float]


def axes_of(rng: np.random.Generator) -> Array:
    """Draw a vector on one, two or three axes, unit length."""
    v = rng.uniform(0.5, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    v[rng.permutation(3)[: rng.choice([0, 1, 2], p=[0.3, 0.3, 0.4])]] = 0.0
    return v / np.linalg.norm(v)


def drawn(rng: np.random.Generator, day: nulls.Day, kind: str, sensor: str) -> Put:
    """Draw an effect of a kind on a sensor. The catalogue's are played by the examiner's equations."""
    v = axes_of(rng)
    last = np.maximum.accumulate(np.where(day.rest < 0, day.t, 0.0))
    prefix = "" if kind == "thermal_latent" else sensor + "_"
    name = prefix + kind if kind in CATALOGUE else None
    if kind in CURVES:
        return Put(sensor, kind, name, np.outer(CURVES[kind](rng, day, last), v), v, {})
    parameters, value, grid = _parameters(rng, day, kind, v)
    assert name is not None
    return Put(sensor, kind, name, played(_world(day), name, parameters), value, grid)


def _parameters(
    rng: np.random.Generator, day: nulls.Day, kind: str, v: Array
) -> tuple[dict[str, object], Array, dict[str, float]]:
    """Draw a catalogue effect's parameters: as the examiner takes them, what scales them, and the others."""
    if kind == "warmup":
        grid = {"tau_s": float(np.exp(rng.uniform(np.log(120), np.log(1200))))}
        return {"amplitude": v, **grid}, v, grid
    if kind == "bias_step":
        grid = {"t_start": float(rng.uniform(0.15, 0.85) * day.t[-1])}
        return {"step": v, "at_s": grid["t_start"]}, v, grid
    if kind == "nonlinearity":
        if rng.random() < 0.4:
            return {"cubic": v / 10.0}, np.concatenate([0 * v, v / 10.0]), {}
        return {"quadratic": v / 10.0}, v / 10.0, {}
    if kind == "g_sensitivity":
        matrix = np.zeros((3, 3))
        matrix[rng.integers(0, 3)] = axes_of(rng)
        if rng.random() < 0.5:
            matrix[rng.integers(0, 3)] += axes_of(rng)
        return {"matrix": matrix}, matrix.ravel(), {}
    if kind == "bias_drift":
        return {"rate": v / 3600.0}, v, {}
    return {"step" if kind == "charging_bias" else "slope": v}, v, {}


def _world(day: nulls.Day) -> World:
    """Return a day as the examiner sees one: it lies still, so nothing turns."""
    still, none = np.zeros((day.t.size, 3)), np.zeros((0, 2))
    force = nulls.G * day.up
    return World(
        day.t, force, still, still, still, day.temperature, day.charging, none, none, np.zeros((0, 6))
    )


def _play(rng: np.random.Generator, day: nulls.Day, _last: Array) -> Array:
    width = rng.uniform(0.2, 0.6) * np.ptp(day.temperature)
    out, state = np.empty(day.t.size), float(day.temperature[0])
    for i, x in enumerate(day.temperature):
        state = min(max(state, x - width / 2), x + width / 2)
        out[i] = state
    away = np.stack([np.ones_like(out), day.temperature], axis=1)
    return np.asarray(out - away @ np.linalg.lstsq(away, out, rcond=None)[0])


def _telegraph(rng: np.random.Generator, day: nulls.Day, _last: Array) -> Array:
    n = day.t.size
    times = np.cumsum(rng.exponential(rng.uniform(200, 600), 200))
    return np.searchsorted(times, np.arange(n)) % 2.0


def _pulses(rng: np.random.Generator, day: nulls.Day, _last: Array) -> Array:
    out = np.zeros(day.t.size)
    for start in rng.uniform(0, day.t.size, rng.integers(2, 8)):
        out[int(start) : int(start + rng.uniform(20, 90))] = 1.0
    return out


def _strain(rng: np.random.Generator, day: nulls.Day, last: Array) -> Array:
    kicks = np.where(np.diff(day.rest, prepend=0) > 0, rng.normal(size=day.t.size), 0.0)
    a = np.exp(-1.0 / rng.uniform(60, 400))
    return np.asarray(lfilter([1.0], [1.0, -a], kicks))


def _lagged(rng: np.random.Generator, day: nulls.Day, _last: Array) -> Array:
    a = np.exp(-1.0 / rng.uniform(150, 600))
    x = day.temperature - day.temperature[0]
    return np.asarray(x - lfilter([1 - a], [1, -a], x))


def _cycle(low: float, high: float) -> Curve:
    def wave(rng: np.random.Generator, day: nulls.Day, _last: Array) -> Array:
        period = np.exp(rng.uniform(np.log(low), np.log(high)))
        return np.asarray(np.sin(2 * np.pi * day.t / period + rng.uniform(0, 6.3)))

    return wave


def _saw(rng: np.random.Generator, day: nulls.Day, _last: Array) -> Array:
    return np.asarray((day.t / np.exp(rng.uniform(np.log(200), np.log(1200))) + rng.random()) % 1.0)


def _stretch(rng: np.random.Generator, day: nulls.Day, _last: Array) -> Array:
    start = rng.uniform(600, 2000)
    return ((day.t > start) & (day.t < start + rng.uniform(200, 1200))).astype(float)


CURVES: dict[str, Curve] = {
    "thermal_latent": lambda _r, d, _l: (d.temperature - d.temperature.mean()) / np.ptp(d.temperature),
    "hysteresis": _play,
    "cycle": _cycle(90, 900),
    "slow_sine": _cycle(1200, 3000),
    "sawtooth": _saw,
    "telegraph": _telegraph,
    "zeroing": lambda r, d, last: np.exp(-(d.t - last) / r.uniform(30, 120)),
    "strain": _strain,
    "pulses": _pulses,
    "lagged_temperature": _lagged,
    "flipped": _stretch,
}


def possible(kind: str, sensor: str, day: nulls.Day) -> bool:
    """Whether this day can show an effect of this kind at all."""
    attitudes = len({tuple(np.round(u, 0)) for u in day.up[day.rest >= 0][::30]})
    if kind in ("strain", "zeroing"):
        return bool(day.rest.max() >= 8)
    if kind in ("nonlinearity", "scale_temperature") and sensor == "gyro":
        return False
    if kind in ("nonlinearity", "scale_temperature"):
        return bool(day.rest.max() >= 12 and attitudes >= 8)
    if kind == "g_sensitivity":
        return bool(sensor == "gyro" and day.rest.max() >= 8 and attitudes >= 4)
    if kind in ("charging_bias", "thermal_latent"):
        return bool(np.abs(np.diff(day.charging)).sum() >= 2)
    return True


def d_prime(residuals: SensorResiduals, average: Array, error: Array, wander: nulls.Wander) -> float:
    """Return d' of an error (seconds, 3) over a sensor's views, baseline projected out, true covariance."""
    means, bias = average @ error, wander.covariance(average)
    total = 0.0
    for view in residuals.views:
        slow = bias[np.ix_(view.bins, view.bins)]
        for b in range(len(view.y)):
            across = view.project[b]
            factor = np.linalg.cholesky(np.diag(view.variance) + slow * (across @ across.T))
            signal = np.linalg.solve(factor, np.einsum("na,na->n", across, means[view.bins]))
            known = np.linalg.solve(factor, view.baseline[b])
            left = signal - known @ np.linalg.lstsq(known, signal, rcond=None)[0]
            total += float(left @ left)
    return float(np.sqrt(total))
