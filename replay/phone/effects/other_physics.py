"""An effect of another package, played by its own class."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.catalogue import foreign_effects
from stillcal.calib_core.diagnosis.model.effect import Effect as CatalogueEffect
from stillcal.calib_core.diagnosis.model.moments import History, Moments
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone.effects.base import Circumstances, Effect, Moment, Term


class OtherPhysics(Effect, frozen=True, kw_only=True, tag="other_physics"):
    """What a class named under the entry point group `stillcal.effects` adds to a sensor's output.

    effect: its name; values: its linear parameters one after another, SI; grid: its other parameters.
    """

    effect: str
    values: tuple[float, ...]
    grid: dict[str, float] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        self.physics()

    def concerns(self, sensor: Sensor) -> bool:
        """Whether the effect acts on a sensor's samples."""
        return sensor is (Sensor.ACCELEROMETER if self.physics().sensor == "accel" else Sensor.GYROSCOPE)

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term: the class' response to the parameters."""
        physics, values = self.physics(), np.asarray(self.values)

        def term(m: Moment) -> Array:
            return np.asarray(physics.response(_drivers(m), dict(self.grid)) @ values)

        return term

    def physics(self) -> CatalogueEffect:
        """Return the class' effect. Raises ValueError where no installed package has it."""
        for effect in foreign_effects():
            if effect.name == self.effect and sum(p.count for p in effect.parameters) == len(self.values):
                return effect
        raise ValueError(
            f"no installed package has the effect {self.effect!r} with {len(self.values)} parameters;"
            " install the package that names it under the entry point group stillcal.effects"
        )


def _drivers(m: Moment) -> Moments:
    """Return the simulated moment as an effect's drivers; time counts from switching on."""
    return Moments(
        m.t,
        np.zeros(m.t.size),
        History((0.0, math.inf), np.zeros((1, 2))),
        m.force,
        m.rate,
        m.warmth,
        m.charging,
    )
