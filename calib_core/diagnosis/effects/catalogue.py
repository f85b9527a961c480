"""The catalogue: the effects of this package, those of other packages, and the nameless ones."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from importlib.metadata import entry_points

import numpy as np

from stillcal.calib_core.diagnosis.effects.by_force import ForceNonlinearity, GSensitivity
from stillcal.calib_core.diagnosis.effects.by_rate import RateNonlinearity
from stillcal.calib_core.diagnosis.effects.covariate import covariate_effects
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature, ScaleTemperature
from stillcal.calib_core.diagnosis.effects.timed import Charging, Drift, Step
from stillcal.calib_core.diagnosis.effects.unknown import unknown_effects, unknown_sentence
from stillcal.calib_core.diagnosis.effects.warmup import LatentHeat, Warmup
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.errors import UserError

GROUP = "stillcal.effects"
"""Entry point group under which other packages name their own effects."""


@cache
def named_effects() -> tuple[Effect, ...]:
    """Return every effect that has a name, of both sensors, in rests and in turns.

    Raises UserError where an effect of another package cannot be loaded or is none.
    """
    return (*own_effects(), *foreign_effects())


def own_effects() -> list[Effect]:
    """Return the effects of this package that have a name."""
    own: list[Effect] = []
    for sensor in ("accel", "gyro"):
        own += [BiasTemperature(sensor, degree) for degree in (1, 2, 3)]
        own += [Warmup(sensor), LatentHeat(sensor), Drift(sensor), Step(sensor), Charging(sensor)]
        own.append(ScaleTemperature(sensor))
    own += [ForceNonlinearity(2), ForceNonlinearity(3), GSensitivity()]
    own += [RateNonlinearity(2), RateNonlinearity(3)]
    return own


def foreign_effects() -> list[Effect]:
    """Return the effects that other installed packages name under `GROUP`: a class, or a ready effect."""
    found = []
    for point in entry_points(group=GROUP):
        try:
            loaded = point.load()
            effect = loaded() if isinstance(loaded, type) else loaded
        except Exception as error:
            raise UserError(
                f"the effect {point.name} ({point.value}) cannot be loaded: {error};"
                " mend or uninstall its package"
            ) from error
        if not isinstance(effect, Effect) or effect.sensor not in ("accel", "gyro"):
            raise UserError(
                f"the effect {point.name} ({point.value}) is no Effect of the sensor 'accel' or 'gyro';"
                " see docs/effects.md"
            )
        found.append(effect)
    return found


def effects_of(sensor: str, without: Collection[str] = (), *, in_turns: bool = False) -> list[Effect]:
    """Return what is judged on one sensor's rests, or on its turns, named and nameless.

    without: names that are taken away. Whatever drives a named effect may drive a nameless one. Where both
    compete the name is preferred, so the nameless twin enters only for effects in `without`.
    """
    every = [e for e in named_effects() if e.sensor == sensor]
    every = [nameless(e) if e.name in without else e for e in every]
    return [e for e in (*every, *unknown_effects(sensor)) if e.in_turns == in_turns]


def effects_in(residuals: SensorResiduals, without: Collection[str] = ()) -> list[Effect]:
    """Return what residuals are judged by: the catalogue, and a bias that follows a further logged column.

    without: as for `effects_of`.
    """
    logged: list[Effect] = []
    if not residuals.turns:
        moments = residuals.moments
        spreads = {name: float(np.ptp(moments.column(name))) for name in moments.history.columns}
        logged += [
            effect
            for name, spread in spreads.items()
            if spread > 0.0
            for effect in covariate_effects(residuals.sensor, name, spread)
        ]
    return [*logged, *effects_of(residuals.sensor, without, in_turns=bool(residuals.turns))]


def nameless(effect: Effect) -> Effect:
    """Return an effect with the same driver and no word of physics."""
    return effect.nameless(thresholds.UNKNOWN_PENALTY, unknown_sentence(effect.follows))
