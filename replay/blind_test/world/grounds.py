"""What a phone lies on moves: foam and cushions give way, tables sag, people breathe, cars drive.

All of it is true motion, which both sensors see: gravity's direction turns by as much as the gyroscope turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.world.noise import log_uniform
from stillcal.replay.blind_test.world.turning import minimum_jerk, rotated, rotated_each, rows_between, tones

Course = tuple[Array, Array]
"""The angle (n,) rad by which a rest has tilted since its beginning, and its rate (n,) rad/s."""


def _foam(t: Array, rng: np.random.Generator) -> Course:
    """Return a foam's power-law creep, t^n (Findley, Lai and Onaran 1976, Creep and Relaxation, ch. 5)."""
    depth, power = log_uniform(rng, 3e-4, 5e-3), rng.uniform(0.15, 0.4)
    since = (t + 1.0) / 100.0
    return depth * (since**power - 0.01**power), depth * power * since ** (power - 1.0) / 100.0


def _cushion(t: Array, rng: np.random.Generator) -> Course:
    """Return a cushion's creep: two retarded elastic parts, as air leaves it and as its filling settles."""
    parts = [(log_uniform(rng, 1e-3, 1e-2), log_uniform(rng, *taus)) for taus in ((4.0, 20.0), (60.0, 400.0))]
    angle = sum((depth * -np.expm1(-t / tau) for depth, tau in parts), start=np.zeros_like(t))
    speed = sum((depth / tau * np.exp(-t / tau) for depth, tau in parts), start=np.zeros_like(t))
    return angle, speed


def _breathing(t: Array, rng: np.random.Generator) -> Course:
    """Return the tilt of a mattress by a sleeper's breath, 12 to 20 a minute."""
    depth, pitch = log_uniform(rng, 1e-4, 1.5e-3), 2.0 * math.pi * rng.uniform(0.2, 0.33)
    return depth * (1.0 - np.cos(pitch * t)), depth * pitch * np.sin(pitch * t)


SUPPORTS: dict[str, Callable[[Array, np.random.Generator], Course]] = {
    "foam": _foam,
    "cushion": _cushion,
    "breathing": _breathing,
}
"""Supports that tilt a phone anew in each rest, about a level axis."""

GROUNDS = ("firm", *SUPPORTS, "sagging", "vehicle")
"""Everything that a phone without any effect may lie on."""


def stirred(
    ground: str,
    t: Array,
    course: tuple[Array, Array],
    motion: tuple[Array, Array, Array, Array],
    rng: np.random.Generator,
) -> Array:
    """Add the ground's motion to up, north, rate and push, (n, 3) each; return the spans that stay rests.

    ground: one of `GROUNDS`, or `heartbeat`. course: rests and turns as in `World`.
    """
    (rests, turns), (up, north, rate, push) = course, motion
    if ground == "vehicle":
        return _driven(t, rests, rate, push, rng)
    if ground == "heartbeat":
        push += _beats(t, rng)[:, None] * (up + 0.3 * rng.standard_normal(3))
    sag = _sagging(t, rng) if ground == "sagging" else None
    for index, (begin, end) in enumerate(rests if sag is not None or ground in SUPPORTS else []):
        rows = rows_between(t, begin, end)
        here, ahead = up[rows][0], north[rows][0]
        if sag is not None:
            axis = math.cos(sag[2]) * ahead + math.sin(sag[2]) * np.cross(ahead, here)
            angle, speed = sag[0][rows] - sag[0][rows][0], sag[1][rows]
        else:
            axis = np.cross(here, rng.standard_normal(3))
            axis /= np.linalg.norm(axis)
            angle, speed = SUPPORTS[ground](t[rows] - begin, rng)
        _tilt((up, north, rate), rows, np.broadcast_to(axis, (angle.size, 3)), (angle, speed))
        if index < len(turns):
            _tilt_back((up, north, rate), t, turns[index], axis, float(angle[-1]))
    return rests


def _tilt(motion: tuple[Array, Array, Array], rows: slice, axis: Array, course: Course) -> None:
    """Tilt up and north about axes (k, 3) of the body, and add the rate of it."""
    up, north, rate = motion
    up[rows], north[rows] = (rotated_each(v[rows], axis, -course[0]) for v in (up, north))
    rate[rows] += course[1][:, None] * axis


def _tilt_back(motion: tuple[Array, Array, Array], t: Array, turn: Array, axis: Array, angle: float) -> None:
    """Let the hand take the tilt of a rest back during the turn that follows, as smoothly as it turns."""
    rows = rows_between(t, turn[0], turn[1])
    since, length = t[rows] - turn[0], float(turn[1] - turn[0])
    turned, _, _ = minimum_jerk(since, length, float(turn[5]))
    back, speed, _ = minimum_jerk(since, length, angle)
    _tilt(motion, rows, rotated(axis, turn[2:5], -turned), (angle - back, -speed))


def _sagging(t: Array, rng: np.random.Generator) -> tuple[Array, Array, float]:
    """Return the tilt of a table that sags under its load all the while, its rate, and its heading."""
    depth, tau = log_uniform(rng, 3e-4, 4e-3), rng.uniform(0.3, 1.5) * t[-1]
    angle, speed = depth * -np.expm1(-t / tau), depth / tau * np.exp(-t / tau)
    return angle, speed, float(rng.uniform(0.0, 2.0 * math.pi))


def _beats(t: Array, rng: np.random.Generator) -> Array:
    """Return the acceleration of a heart under the phone: a 6 Hz wavelet some 70 times a minute; (n,)."""
    height = log_uniform(rng, 2e-3, 1.5e-2)
    beats = np.cumsum(rng.normal(0.86, 0.04, int(t[-1] / 0.7) + 2))
    since = t - beats[np.clip(np.searchsorted(beats, t, side="right") - 1, 0, None)]
    since = np.where(since < 0.0, 9.0, since)
    return np.asarray(height * np.exp(-since / 0.12) * np.sin(2.0 * math.pi * 6.0 * since))


def _driven(t: Array, rests: Array, rate: Array, push: Array, rng: np.random.Generator) -> Array:
    """Replace the middle third by a drive with road, braking and bends; return the rests outside it."""
    begin, end = t[-1] / 3.0, 2.0 * t[-1] / 3.0
    rows = rows_between(t, begin, end)
    count = rows.stop - rows.start
    road = rng.standard_normal((count, 3)) * rng.uniform(0.05, 0.3)
    push[rows] += road + 0.6 * tones(t[rows], rng, (0.02, 0.2), 5)
    rate[rows] += 0.01 * rng.standard_normal((count, 3))
    outside = (rests[:, 1] < begin) | (rests[:, 0] > end)
    return np.asarray(rests[outside])
