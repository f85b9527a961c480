"""Rotations and smooth courses from which the examiner's motion is made."""

from __future__ import annotations

import math

import numpy as np

from stillcal.calib_core.arrays import Array


def rows_between(t: Array, begin: float, end: float) -> slice:
    """Return the rows of t (n,) from `begin` to `end` s."""
    first, last = np.searchsorted(t, (begin, end))
    return slice(int(first), int(last))


def rotated(vector: Array, axis: Array, angle: Array) -> Array:
    """Rotate a vector (3,) about a unit axis (3,) by angles (n,) rad; shape (n, 3). Rodrigues' formula."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    turned: Array = vector * c + np.cross(axis, vector) * s + axis * (axis @ vector) * (1.0 - c)
    return turned


def rotated_each(vectors: Array, axes: Array, angle: Array) -> Array:
    """Rotate vectors (n, 3) about unit axes (n, 3) by angles (n,) rad."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = (axes * vectors).sum(axis=1, keepdims=True)
    return np.asarray(vectors * c + np.cross(axes, vectors) * s + axes * along * (1.0 - c))


def tones(t: Array, rng: np.random.Generator, band: tuple[float, float], count: int) -> Array:
    """Return sums of `count` tones of unit variance on three axes; shape (n, 3)."""
    pitch, phase = rng.uniform(*band, (count, 3)), rng.uniform(0.0, 2.0 * math.pi, (count, 3))
    waves = np.sin(2.0 * math.pi * pitch * t[:, None, None] + phase)
    return np.asarray(waves.sum(axis=1) * math.sqrt(2.0 / count))


def minimum_jerk(t: Array, length: float, angle: float) -> tuple[Array, Array, Array]:
    """Return the angle turned, its rate and acceleration at times t (n,) s into a turn of `length` s."""
    s = np.clip(t / length, 0.0, 1.0)
    place = angle * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    speed = angle / length * 30.0 * s**2 * (1.0 - s) ** 2
    change = angle / length**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    return place, speed, change
