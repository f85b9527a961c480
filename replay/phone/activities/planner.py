"""The planner of motion: it lays pieces end to end, each starting where the last one ended."""

from __future__ import annotations

import math

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.phone.motion.trajectory import (
    Creep,
    Glide,
    Piece,
    Profile,
    Sway,
    Turn,
    Waves,
    rotation,
    turn_between,
)

Span = float | tuple[float, float]
"""A fixed number, or a range to draw from."""


def drawn(span: Span, rng: np.random.Generator) -> float:
    """Draw a number uniformly from a span."""
    return span if isinstance(span, float | int) else float(rng.uniform(*span))


def log_drawn(span: Span, rng: np.random.Generator) -> float:
    """Draw from a span evenly in the logarithm: short ones are common, long ones happen."""
    if isinstance(span, float | int):
        return span
    return float(math.exp(rng.uniform(math.log(span[0]), math.log(span[1]))))


def any_direction(rng: np.random.Generator) -> Array:
    """Draw a unit vector (3,) evenly over the sphere."""
    v = rng.standard_normal(3)
    unit: Array = v / np.linalg.norm(v)
    return unit


class Planner:
    """Pieces of motion laid end to end. Times in s; attitudes (3, 3) body to world."""

    def __init__(
        self,
        rng: np.random.Generator,
        attitude: Array,
        gravity: float,
        earth: Array | None = None,
        creep: Creep | None = None,
    ) -> None:
        self.rng = rng
        self.t = 0.0
        self.attitude = attitude
        self.gravity = gravity
        self.earth = earth
        self.creep = creep
        self.pieces: list[Piece] = []

    def move(
        self,
        duration: float,
        activity: str,
        *,
        still: bool = False,
        turns: tuple[Turn, ...] = (),
        sways: tuple[Sway, ...] = (),
        heading: Profile | None = None,
    ) -> None:
        """Add a piece of `duration` s that starts in the present attitude."""
        end = self.t + duration
        piece = Piece(
            self.t, end, self.attitude, activity, still, self.gravity, turns, sways, heading, self.earth
        )
        self.pieces.append(piece)
        self.attitude = piece.attitude_at(end)
        self.t = end

    def rest(self, duration: float, activity: str) -> None:
        """Lie still for `duration` s, on a support that creeps if the phone's does."""
        creeping = () if self.creep is None else (Turn(self._level_axis(), self.creep),)
        self.move(duration, activity, still=True, turns=creeping)

    def turn_to(self, attitude: Array, activity: str = "handling", lift: float = 0.15) -> None:
        """Turn by hand to an attitude, smoothly, wavering a little, raised and set down by about `lift` m.

        The mean speed of the turn is drawn from 1 to 2.6 rad/s: its peak, 1.9 times that, reaches 5 rad/s.
        """
        axis, angle = turn_between(self.attitude, attitude)
        duration = max(angle / self.rng.uniform(1.0, 2.6), self.rng.uniform(0.5, 0.9))
        waver = self.waves(0.06, (0.8, 3.0), 2, duration, duration / 2.0)
        turns = (Turn(any_direction(self.rng), waver), Turn(axis, Glide(angle, duration)))
        self.move(duration, activity, turns=turns, sways=self._carried(lift, duration))

    def put_down(self, attitude: Array, activity: str = "handling") -> None:
        """Turn by hand to an attitude on a hard support, and set the phone down with a thud."""
        self.turn_to(attitude, activity)
        duration = self.rng.uniform(0.15, 0.35)
        thud = self.shake(math.exp(self.rng.uniform(math.log(0.3), math.log(3.0))), (10.0, 40.0), 4, duration)
        self.move(duration, activity, turns=self.tremble(3e-4, (10.0, 40.0), 2, duration), sways=thud)

    def waves(self, rms: float, band: tuple[float, float], k: int, duration: float, fade: float) -> Waves:
        """Draw k sinusoids of a total root-mean-square value, frequencies in Hz log-even over a band."""
        rng = self.rng
        weight = rng.uniform(0.3, 1.0, k)
        amplitude = rms * math.sqrt(2.0) * weight / math.sqrt(float(weight @ weight))
        frequency = np.exp(rng.uniform(math.log(band[0]), math.log(band[1]), k))
        return Waves(amplitude, frequency, rng.uniform(0.0, 2.0 * math.pi, k), duration, fade)

    def tremble(self, rms: float, band: tuple[float, float], k: int, duration: float) -> tuple[Turn, ...]:
        """Draw small rotations about all three body axes, each of `rms` rad within a band in Hz."""
        fade = min(0.5, duration / 2.0)
        return tuple(Turn(axis, self.waves(rms, band, k, duration, fade)) for axis in np.eye(3))

    def shake(self, rms: float, band: tuple[float, float], k: int, duration: float) -> tuple[Sway, ...]:
        """Draw accelerations along all three world axes, each of `rms` m/s^2 within a band in Hz."""
        fade = min(0.5, duration / 2.0)
        return tuple(Sway(axis, self.waves(rms, band, k, duration, fade), order=0) for axis in np.eye(3))

    def _carried(self, lift: float, duration: float) -> tuple[Sway, ...]:
        half = duration / 2.0
        height = lift * self.rng.uniform(0.3, 1.0)
        aside = 0.3 * any_direction(self.rng) * self.rng.uniform(0.0, 1.0)
        up = np.array([0.0, 0.0, 1.0])
        return (
            Sway(up, Glide(height, half)),
            Sway(up, Glide(-height, half, half)),
            Sway(aside, Glide(1.0, duration)),
        )

    def _level_axis(self) -> Array:
        up = self.attitude[2]
        level = np.cross(up, any_direction(self.rng))
        axis: Array = level / np.linalg.norm(level)
        return axis


def tilted(attitude: Array, angle: float, rng: np.random.Generator) -> Array:
    """Return an attitude turned by about `angle` rad in any direction."""
    turned: Array = attitude @ rotation(any_direction(rng), angle * abs(rng.standard_normal()))
    return turned
