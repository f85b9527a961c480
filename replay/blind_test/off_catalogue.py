"""Real things that no catalogue of the tool lists: a right answer calls them unknown, and says where.

Slow ones are courses of unit size along a drawn direction, sized by d'; sudden ones corrupt the readings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.world import World

Course = Callable[[World, np.random.Generator], Array]
Corruption = Callable[[Array, "Span", np.random.Generator], None]


@dataclass(frozen=True, slots=True)
class Span:
    """Rows of a recording, and their times in s."""

    rows: slice
    t_start: float
    t_end: float


@dataclass(frozen=True, slots=True)
class OffCatalogueEffect:
    """An effect outside the catalogue.

    course: gives the course in time (n,) of a slow one; corrupt: changes readings (n, 3) of a sudden one in
    place. entailed: catalogue names that are true besides, and no misnaming.
    """

    sensor: str
    course: Course | None = None
    corrupt: Corruption | None = None
    entailed: tuple[str, ...] = ()


def _since_move(world: World) -> Array:
    index = np.clip(np.searchsorted(world.rests[:, 0], world.t, side="right") - 1, 0, None)
    return np.asarray(world.t - world.rests[index, 0])


def _light(world: World, rng: np.random.Generator) -> Array:
    """Supply of an ambient light sensor that switches on and off, told by no event."""
    toggles = np.sort(rng.uniform(0.05, 0.95, int(rng.integers(5, 10)))) * world.duration
    return np.asarray(np.searchsorted(toggles, world.t) % 2, dtype=np.float64)


def _stress(world: World, rng: np.random.Generator) -> Array:
    """Strain in the package that each move leaves one way or the other, by the sense of its turn."""
    sense = np.sign(world.turns[:, 2:5] @ rng.standard_normal(3)) if len(world.turns) else np.zeros(0)
    values = np.concatenate([[0.0], sense])
    return np.asarray(values[np.searchsorted(world.turns[:, 1], world.t, side="right")])


def _hysteresis(world: World, rng: np.random.Generator) -> Array:
    """Play of temperature: follows only after it has turned back by some width; its linear part taken off."""
    width = 0.3 * float(np.ptp(world.temperature))
    coarse = np.arange(0.0, world.duration + 5.0, 5.0)
    played, now = np.empty(coarse.size), float(world.temperature[0])
    for i, warmth in enumerate(np.interp(coarse, world.t, world.temperature)):
        now = min(max(now, float(warmth) - width), float(warmth) + width)
        played[i] = now
    course = np.interp(world.t, coarse, played)
    slope, level = np.polyfit(world.temperature, course, 1)
    return np.asarray(course - slope * world.temperature - level)


def _bursts(world: World, rng: np.random.Generator) -> Array:
    """Add some bursts of 25 to 60 s."""
    course = np.zeros(world.t.size)
    for begin in rng.uniform(0.0, 0.95, int(rng.integers(4, 8))) * world.duration:
        course[(world.t >= begin) & (world.t < begin + rng.uniform(25.0, 60.0))] = 1.0
    return course


def _sawtooth(world: World, rng: np.random.Generator) -> Array:
    """Drift, which firmware resets every two or three minutes."""
    return np.asarray(np.mod(world.t / rng.uniform(100.0, 220.0) + rng.random(), 1.0))


def _autozero(world: World, rng: np.random.Generator) -> Array:
    """Firmware that zeroes the rate within each rest and forgets at each move."""
    return np.exp(-_since_move(world) / rng.uniform(10.0, 20.0))


def _cyclic(world: World, rng: np.random.Generator) -> Array:
    """Return a cycle of some minutes, as of a fan or an air conditioner, that no thermometer follows."""
    return np.sin(2.0 * math.pi * (world.t / rng.uniform(200.0, 450.0) + rng.random()))


def _swapped(values: Array, span: Span, rng: np.random.Generator) -> None:
    values[span.rows] = values[span.rows][:, [1, 0, 2]]


def _flipped(values: Array, span: Span, rng: np.random.Generator) -> None:
    values[span.rows, int(rng.integers(3))] *= -1.0


def _frozen(values: Array, span: Span, rng: np.random.Generator) -> None:
    """Sample and hold: for a third of the span the readings stand still for 10 to 40 samples at a time."""
    row = span.rows.start
    while row < span.rows.stop:
        hold = int(rng.integers(10, 40))
        values[row : row + hold] = values[row]
        row += 3 * hold


def _regained(values: Array, span: Span, rng: np.random.Generator) -> None:
    """Change the gain of all axes, as a power mode may."""
    values[span.rows] *= 1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(0.004, 0.012))


OFF_CATALOGUE: dict[str, OffCatalogueEffect] = {
    "light_switch_bias": OffCatalogueEffect("accel", _light),
    "stress_after_moves": OffCatalogueEffect("accel", _stress),
    "temperature_hysteresis": OffCatalogueEffect("accel", _hysteresis),
    "rate_bursts": OffCatalogueEffect("gyro", _bursts),
    "sawtooth_reset": OffCatalogueEffect("gyro", _sawtooth),
    "autozero_in_rests": OffCatalogueEffect("gyro", _autozero),
    "cyclic_bias": OffCatalogueEffect("accel", _cyclic),
    "axes_swapped": OffCatalogueEffect("accel", corrupt=_swapped),
    "sign_flipped": OffCatalogueEffect("gyro", corrupt=_flipped),
    "sample_and_hold": OffCatalogueEffect("accel", corrupt=_frozen),
    "gain_by_power_mode": OffCatalogueEffect("accel", corrupt=_regained),
}
"""Off-catalogue effects by the names that only keys know."""


def drawn_span(world: World, rng: np.random.Generator) -> Span:
    """Draw a stretch of a fifth to two fifths of a recording that begins and ends within it."""
    length = rng.uniform(0.2, 0.4) * world.duration
    begin = rng.uniform(0.1, 0.9 - length / world.duration) * world.duration
    first, last = np.searchsorted(world.t, (begin, begin + length))
    return Span(slice(int(first), int(last)), float(begin), float(begin + length))
