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
from stillcal.replay.blind_test.world.noise import log_uniform

LEAST_REST_S = 14.0
"""Shortest rest, s: one bin of 10 s and the margins at both ends, with some to spare."""


@dataclass(frozen=True, slots=True)
class Day:
    """Settings of one recording's motion.

    rest_s: s, range of a rest's length. attitudes: number of different ones. stirred: what moves the phone at
    rest: None, breathing, heartbeat, creep or vehicle. vivid: whether it is shaken and spun between rests.
    pivot: whether it is rotated about a fixed point, as on a hinge. plugs: how often the charger is plugged
    in. gravity: m/s^2. earth_rotation: whether the gyroscope measures the Earth's rotation.
    """

    duration: float
    rate_hz: float
    rest_s: tuple[float, float] = (20.0, 80.0)
    attitudes: int = 12
    stirred: str | None = None
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
    earth = day.earth_rotation * _earth(up, north, rng)
    push = np.zeros_like(up)
    for begin, end in zip(rests[:-1, 1], rests[1:, 0], strict=True):
        rows = _rows(t, begin, end)
        push[rows] += _hand(t[rows], day, rng)
        if day.vivid:
            push[rows] += _shake(t[rows], rng)
    rests = _stirred(day, t, rests, (up, rate, push), rng)
    drive = _drive(day, rng)
    return World(
        t,
        day.gravity * up + push,
        rate + earth,
        rate_dot,
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


def _rows(t: Array, begin: float, end: float) -> slice:
    first, last = np.searchsorted(t, (begin, end))
    return slice(int(first), int(last))


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
    first = _rows(t, 0.0, rests[0, 1])
    up[first], north[first] = here, ahead
    for turn, (begin, end) in zip(turns, rests[1:], strict=True):
        there = known[rng.integers(len(known))] if len(known) > 1 else _nearby(here, rng)
        axis, angle = _way(here, there, rng)
        angle += math.copysign(2.0 * math.pi, angle) * day.vivid  # a whole spin more ends where it would
        turn[2:5], turn[5] = axis, angle
        rows, then = _rows(t, turn[0], turn[1]), _rows(t, begin, end + 1.0)
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


def rotated(vector: Array, axis: Array, angle: Array) -> Array:
    """Rotate a vector (3,) about a unit axis (3,) by angles (n,) rad; shape (n, 3). Rodrigues' formula."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    turned: Array = vector * c + np.cross(axis, vector) * s + axis * (axis @ vector) * (1.0 - c)
    return turned


def minimum_jerk(t: Array, length: float, angle: float) -> tuple[Array, Array, Array]:
    """Return the angle turned, its rate and acceleration at times t (n,) s into a turn of `length` s."""
    s = np.clip(t / length, 0.0, 1.0)
    place = angle * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    speed = angle / length * 30.0 * s**2 * (1.0 - s) ** 2
    change = angle / length**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    return place, speed, change


def _hand(t: Array, day: Day, rng: np.random.Generator) -> Array:
    """Return the acceleration (n, 3) that a hand adds while it turns the phone."""
    if t.size < 2:
        return np.zeros((t.size, 3))
    size = 0.01 if day.pivot else log_uniform(rng, 0.05, 0.3)
    window = np.sin(math.pi * (t - t[0]) / (t[-1] - t[0])) ** 2
    return np.asarray(size * window[:, None] * _tones(t, rng, (0.5, 4.0), 4))


def _tones(t: Array, rng: np.random.Generator, band: tuple[float, float], count: int) -> Array:
    """Return sums of `count` tones of unit variance on three axes; shape (n, 3)."""
    pitch, phase = rng.uniform(*band, (count, 3)), rng.uniform(0.0, 2.0 * math.pi, (count, 3))
    waves = np.sin(2.0 * math.pi * pitch * t[:, None, None] + phase)
    return np.asarray(waves.sum(axis=1) * math.sqrt(2.0 / count))


def _shake(t: Array, rng: np.random.Generator) -> Array:
    """Return a hard shake (n, 3) along one axis, 8 to 25 m/s^2 at 3 Hz."""
    if t.size < 4:
        return np.zeros((t.size, 3))
    window = np.sin(math.pi * (t - t[0]) / (t[-1] - t[0]))
    axis = rng.standard_normal(3)
    wave = rng.uniform(8.0, 25.0) * window * np.sin(6.0 * math.pi * t)
    return np.asarray(wave[:, None] * axis / np.linalg.norm(axis))


def _stirred(
    day: Day, t: Array, rests: Array, motion: tuple[Array, Array, Array], rng: np.random.Generator
) -> Array:
    """Add the motion of a phone at rest, and return the spans that are still rests."""
    up, rate, push = motion
    if day.stirred == "vehicle":
        return _driven(t, rests, rate, push, rng)
    for begin, end in rests if day.stirred in ("breathing", "creep") else []:
        rows = _rows(t, begin, end)
        _tilt(t[rows] - begin, up[rows], rate[rows], day.stirred == "creep", rng)
    if day.stirred == "heartbeat":
        push += _beats(t, rng)[:, None] * (up + 0.3 * rng.standard_normal(3))
    return rests


def _tilt(t: Array, up: Array, rate: Array, creeps: bool, rng: np.random.Generator) -> None:
    """Tilt a rest's rows in place by breathing or creep, and add the rate of that tilt."""
    axis = np.cross(up[0], rng.standard_normal(3))
    axis /= np.linalg.norm(axis)
    if creeps:
        depth, tau = log_uniform(rng, 2e-5, 2e-3), log_uniform(rng, 60.0, 600.0)
        angle, speed = depth * -np.expm1(-t / tau), depth / tau * np.exp(-t / tau)
    else:
        depth, pitch = log_uniform(rng, 1e-4, 1.5e-3), 2.0 * math.pi * rng.uniform(0.2, 0.33)
        angle, speed = depth * (1.0 - np.cos(pitch * t)), depth * pitch * np.sin(pitch * t)
    up -= angle[:, None] * np.cross(axis, up)
    rate += speed[:, None] * axis


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
    rows = _rows(t, begin, end)
    count = rows.stop - rows.start
    road = rng.standard_normal((count, 3)) * rng.uniform(0.05, 0.3)
    push[rows] += road + 0.6 * _tones(t[rows], rng, (0.02, 0.2), 5)
    rate[rows] += 0.01 * rng.standard_normal((count, 3))
    outside = (rests[:, 1] < begin) | (rests[:, 0] > end)
    return np.asarray(rests[outside])


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
