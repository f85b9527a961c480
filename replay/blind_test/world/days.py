"""The examiner's own motion: a phone that is put down, picked up and put down in another attitude.

The sensors depend only on the directions of up and north, so these are propagated in body axes. Rotations
are about one body-fixed axis with the minimum-jerk profile 10 s^3 - 15 s^4 + 6 s^5 (Flash and Hogan 1985),
so rates and their derivatives are exact. Hands, roads and hearts add accelerations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.world.day import EARTH, World, lagged
from stillcal.replay.blind_test.world.grounds import stirred
from stillcal.replay.blind_test.world.noise import log_uniform
from stillcal.replay.blind_test.world.turning import minimum_jerk, rotated, rows_between, tones

LEAST_REST_S = 14.0
"""Shortest rest, s: one bin of 10 s and the margins at both ends, with some to spare."""


@dataclass(frozen=True, slots=True)
class Day:
    """Settings of one recording's motion.

    rest_s: s, range of a rest's length. attitudes: number of different ones. ground: what the phone lies on,
    one of `GROUNDS`, or a chest whose heartbeat it feels. vivid: whether it is shaken and spun between rests.
    pivot: whether it is rotated about a fixed point, as on a hinge. plugs: how often the charger is plugged
    in. gravity: m/s^2. earth_rotation: whether the gyroscope measures the Earth's rotation.
    """

    duration: float
    rate_hz: float
    rest_s: tuple[float, float] = (20.0, 80.0)
    attitudes: int = 12
    ground: str = "firm"
    vivid: bool = False
    pivot: bool = False
    plugs: int = 3
    heat_k: float = 6.0
    wandering_k: float = 0.0
    gravity: float = 9.80665
    earth_rotation: bool = True


def play(day: Day, rng: np.random.Generator) -> World:
    """Return the true motion and surroundings that follow from the settings."""
    t = np.arange(int(day.duration * day.rate_hz)) / day.rate_hz
    rests, turns = _course(day, rng)
    up, north, rate, rate_dot = _turned(day, t, rests, turns, rng)
    push = np.zeros_like(up)
    for begin, end in zip(rests[:-1, 1], rests[1:, 0], strict=True):
        rows = rows_between(t, begin, end)
        push[rows] += _hand(t[rows], day, rng)
        if day.vivid:
            push[rows] += _shake(t[rows], rng)
    rests = stirred(day.ground, t, (rests, turns), (up, north, rate, push), rng)
    earth = day.earth_rotation * _earth(up, north, rng)
    drive = _drive(day, rng)
    return World(
        t,
        day.gravity * up + push,
        rate + earth,
        rate_dot,
        north,
        _warmth(day, t, drive, rng),
        _charging_at(drive, t),
        drive,
        rests,
        turns,
    )


def _earth(up: Array, north: Array, rng: np.random.Generator) -> Array:
    """Return the Earth's rate (n, 3) in the body, somewhere between 65 degrees south and north."""
    latitude = math.radians(rng.uniform(-65.0, 65.0))
    return EARTH * (math.sin(latitude) * up + math.cos(latitude) * north)


def _course(day: Day, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw the spans of rests (r, 2) and of the rotations between; axis and angle are filled in later."""
    rests, now = [], 0.0
    while True:
        end = now + max(log_uniform(rng, *day.rest_s), LEAST_REST_S)
        if end > day.duration - LEAST_REST_S:
            rests.append((now, day.duration))
            break
        rests.append((now, end))
        now = end + (rng.uniform(0.8, 1.6) if day.vivid else rng.uniform(1.2, 3.0))
    spans = np.array(rests)
    return spans, np.column_stack([spans[:-1, 1], spans[1:, 0], np.zeros((len(spans) - 1, 4))])


def _attitudes(day: Day, rng: np.random.Generator) -> Array:
    """Draw up directions: half of them near a face of the phone, half anywhere on the sphere."""
    faces = np.concatenate([np.eye(3), -np.eye(3)])[rng.permutation(6)]
    anywhere = rng.standard_normal((day.attitudes, 3))
    near = faces[np.arange(day.attitudes) % 6] + 0.06 * rng.standard_normal((day.attitudes, 3))
    directions = np.where((np.arange(day.attitudes) % 2 == 0)[:, None], near, anywhere)
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


def _turned(
    day: Day, t: Array, rests: Array, turns: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Return up, north, rate and its derivative at t; writes each turn's axis and angle into `turns`."""
    up, rate, rate_dot = np.empty((t.size, 3)), np.zeros((t.size, 3)), np.zeros((t.size, 3))
    north = np.empty_like(up)
    known = _attitudes(day, rng)
    here = known[0]
    ahead = np.cross(here, rng.standard_normal(3))
    ahead /= np.linalg.norm(ahead)
    first = rows_between(t, 0.0, rests[0, 1])
    up[first], north[first] = here, ahead
    for turn, (begin, end) in zip(turns, rests[1:], strict=True):
        there = known[rng.integers(len(known))] if len(known) > 1 else _nearby(here, rng)
        axis, angle = _way(here, there, rng)
        angle += math.copysign(2.0 * math.pi, angle) * day.vivid  # a whole spin more ends where it would
        turn[2:5], turn[5] = axis, angle
        rows, then = rows_between(t, turn[0], turn[1]), rows_between(t, begin, end + 1.0)
        turned, speed, jerk = minimum_jerk(t[rows] - turn[0], turn[1] - turn[0], angle)
        up[rows], north[rows] = rotated(here, axis, -turned), rotated(ahead, axis, -turned)
        rate[rows], rate_dot[rows] = speed[:, None] * axis, jerk[:, None] * axis
        here, ahead = (rotated(v, axis, np.array([-angle]))[0] for v in (here, ahead))
        up[then], north[then] = here, ahead
    return up, north, rate, rate_dot


def _nearby(up: Array, rng: np.random.Generator) -> Array:
    other = up + 0.05 * rng.standard_normal(3)
    return np.asarray(other / np.linalg.norm(other))


def _way(here: Array, there: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """Return an axis and angle whose turn of the body brings up from `here` to `there` in body axes.

    Any axis in the plane of the normal and the bisector does; which one is drawn.
    """
    normal, middle = np.cross(there, here), here + there
    if np.linalg.norm(normal) < 1e-6 or np.linalg.norm(middle) < 1e-6:
        helper = np.eye(3)[int(np.argmin(np.abs(here)))]
        normal = np.cross(here, helper)
        middle = here
    lean = rng.uniform(-1.0, 1.0)
    axis = math.cos(lean) * normal / np.linalg.norm(normal) + math.sin(lean) * middle / np.linalg.norm(middle)
    a, b = here - axis * (axis @ here), there - axis * (axis @ there)
    return axis, math.atan2(float(axis @ np.cross(b, a)), float(a @ b))


def _hand(t: Array, day: Day, rng: np.random.Generator) -> Array:
    """Return the acceleration (n, 3) that a hand adds while it turns the phone."""
    if t.size < 2:
        return np.zeros((t.size, 3))
    size = 0.01 if day.pivot else log_uniform(rng, 0.05, 0.3)
    window = np.sin(math.pi * (t - t[0]) / (t[-1] - t[0])) ** 2
    return np.asarray(size * window[:, None] * tones(t, rng, (0.5, 4.0), 4))


def _shake(t: Array, rng: np.random.Generator) -> Array:
    """Return a hard shake (n, 3) along one axis, 8 to 25 m/s^2 at 3 Hz."""
    if t.size < 4:
        return np.zeros((t.size, 3))
    window = np.sin(math.pi * (t - t[0]) / (t[-1] - t[0]))
    axis = rng.standard_normal(3)
    wave = rng.uniform(8.0, 25.0) * window * np.sin(6.0 * math.pi * t)
    return np.asarray(wave[:, None] * axis / np.linalg.norm(axis))


def _drive(day: Day, rng: np.random.Generator) -> Array:
    """Draw when the charger is plugged in: (k, 2), times in s and 0 or 1 from then on."""
    if day.plugs == 0:
        return np.zeros((1, 2))
    cuts = (np.arange(2 * day.plugs) + rng.uniform(0.2, 0.8, 2 * day.plugs)) * day.duration / (2 * day.plugs)
    values = (np.arange(2 * day.plugs) + 1) % 2
    return np.concatenate([[[0.0, 0.0]], np.column_stack([cuts, values])])


def _charging_at(drive: Array, t: Array) -> Array:
    return np.asarray(drive[np.searchsorted(drive[:, 0], t, side="right") - 1, 1])


def _warmth(day: Day, t: Array, drive: Array, rng: np.random.Generator) -> Array:
    """Return the temperature: room, charger's heat through a lag, and wandering air."""
    warm = day.heat_k * lagged(drive, rng.uniform(150.0, 500.0), t)
    period = rng.uniform(0.6, 1.6) * day.duration
    room = rng.uniform(18.0, 26.0) + rng.uniform(0.5, 1.5) * np.sin(2 * math.pi * (t / period + rng.random()))
    if day.wandering_k > 0.0:
        coarse = np.linspace(0.0, day.duration, 30)
        knots = np.cumsum(rng.standard_normal(30)) / 3.0
        room += day.wandering_k * np.interp(t, coarse, knots)
    return np.asarray(room + warm)
