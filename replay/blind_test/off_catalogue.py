"""Real effects outside the diagnosis' catalogue: a right answer calls them unknown, and says where.

Slow ones are courses of unit size along a drawn direction, sized by d'; sudden ones corrupt the readings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.world.day import World

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
    """Return the supply of a light sensor, which switches on and off without an event."""
    toggles = np.sort(rng.uniform(0.05, 0.95, int(rng.integers(5, 10)))) * world.duration
    return np.asarray(np.searchsorted(toggles, world.t) % 2, dtype=np.float64)


def _stress(world: World, rng: np.random.Generator) -> Array:
    """Return strain in the package after each move; its sign is that of the rotation."""
    sense = np.sign(world.turns[:, 2:5] @ rng.standard_normal(3)) if len(world.turns) else np.zeros(0)
    values = np.concatenate([[0.0], sense])
    return np.asarray(values[np.searchsorted(world.turns[:, 1], world.t, side="right")])


def _hysteresis(world: World, rng: np.random.Generator) -> Array:
    """Return hysteresis of temperature (play of 0.3 of its span), without its linear part."""
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
    """Return four to seven bursts of 25 to 60 s."""
    course = np.zeros(world.t.size)
    for begin in rng.uniform(0.0, 0.95, int(rng.integers(4, 8))) * world.duration:
        course[(world.t >= begin) & (world.t < begin + rng.uniform(25.0, 60.0))] = 1.0
    return course


def _sawtooth(world: World, rng: np.random.Generator) -> Array:
    """Return a drift that the firmware resets every 100 to 220 s."""
    return np.asarray(np.mod(world.t / rng.uniform(100.0, 220.0) + rng.random(), 1.0))


def _autozero(world: World, rng: np.random.Generator) -> Array:
    """Return an offset that the firmware removes within each rest and that returns with each move."""
    return np.exp(-_since_move(world) / rng.uniform(10.0, 20.0))


def _cyclic(world: World, rng: np.random.Generator) -> Array:
    """Return a cycle of some minutes, as of an air conditioner, that the thermometer does not show."""
    return np.sin(2.0 * math.pi * (world.t / rng.uniform(200.0, 450.0) + rng.random()))


def _swapped(values: Array, span: Span, rng: np.random.Generator) -> None:
    values[span.rows] = values[span.rows][:, [1, 0, 2]]


def _flipped(values: Array, span: Span, rng: np.random.Generator) -> None:
    values[span.rows, int(rng.integers(3))] *= -1.0


def _frozen(values: Array, span: Span, rng: np.random.Generator) -> None:
    """Hold readings for 10 to 40 samples at a time, in a third of the span."""
    row = span.rows.start
    while row < span.rows.stop:
        hold = int(rng.integers(10, 40))
        values[row : row + hold] = values[row]
        row += 3 * hold


def _regained(values: Array, span: Span, rng: np.random.Generator) -> None:
    """Change the gain of all axes by 0.4 to 1.2 %, as a power mode may."""
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
"""Off-catalogue effects by name; only keys use these names."""


def drawn_span(world: World, rng: np.random.Generator) -> Span:
    """Draw a span of a fifth to two fifths of a recording, inside it."""
    length = rng.uniform(0.2, 0.4) * world.duration
    begin = rng.uniform(0.1, 0.9 - length / world.duration) * world.duration
    first, last = np.searchsorted(world.t, (begin, begin + length))
    return Span(slice(int(first), int(last)), float(begin), float(begin + length))
