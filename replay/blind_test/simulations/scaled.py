"""Effects at a share of their size: none, half, all, one and a half, twice."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from stillcal.replay.blind_test.keys import TrueEffect
from stillcal.replay.blind_test.power.sizing import Stage, drawn_effect
from stillcal.replay.blind_test.world.forward_model import FORWARD
from stillcal.replay.blind_test.world.phones import Part, Phone

SHARES = (0.0, 0.5, 1.0, 1.5, 2.0)
"""How much of the recording's effect the simulation has."""

CONSTANTS = {
    "accel_bias": ("accel", 0.3),
    "gyro_bias": ("gyro", 0.015),
    "accel_scale": ("accel", 0.02),
    "gyro_scale": ("gyro", 0.03),
}
"""Constant parameters: the sensor, and a usual size (SI, relative)."""

MOST_D = 25.0
"""Largest d' of effects on noise and stamps: at twice of it a phone would be ten times too noisy."""

SHAPES = ("tau_s", "at_s", "frequency")
"""Parameters that say where or how an effect is, not how large."""

EFFECTS = (
    *CONSTANTS,
    "accel_bias_temperature",
    "gyro_bias_temperature",
    "accel_scale_temperature",
    "accel_warmup",
    "gyro_warmup",
    "gyro_g_sensitivity",
    "accel_nonlinearity",
    "accel_charging_bias",
    "gyro_charging_bias",
    "accel_bias_drift",
    "gyro_bias_drift",
    "accel_bias_random_walk",
    "gyro_bias_random_walk",
    "noise_level",
    "noise_unequal_axes",
    "timestamp_jitter",
    "dropped_samples",
    "clock_skew",
    "accel_gyro_time_offset",
)
"""Effects that a simulation may have too little or too much of. A step falls at a time, and so cannot be the
same in other motion; limits, steps of the values and bandwidths are there or not."""


MOST_JITTER = 0.1
"""Periods of the higher rate that a jitter has at its full size."""


def drawn(stage: Stage, effect: str, d: float) -> TrueEffect:
    """Draw an effect at its full size; constants in their usual size, others at d'."""
    if effect not in CONSTANTS:
        return drawn_effect(stage, effect, d if effect in FORWARD else min(d, MOST_D))
    sensor, usual = CONSTANTS[effect]
    size = usual * stage.rng.uniform(0.6, 1.4, 3) * stage.rng.choice([-1.0, 1.0], 3)
    return TrueEffect(
        effect, sensor, ["x", "y", "z"], {"size": size.tolist()}, None, 0.0, stage.world.duration
    )


def told_by_stamps(effect: TrueEffect, rate_hz: float) -> TrueEffect:
    """Return an effect whose jitter, if it has one, stamps at a rate can have twice as large.

    Both makers hold stamps within 0.45 periods of their sample. Of a normal error of 0.2 periods, twice the
    full size, 98 % is left; of a larger one less, and a simulation had as much as the recording where it was
    to have twice of it.
    """
    if effect.effect != "timestamp_jitter":
        return effect
    sigma = min(float(effect.parameters["sigma"]), MOST_JITTER / rate_hz)
    return replace(effect, parameters={**effect.parameters, "sigma": sigma})


def scaled(effect: TrueEffect, share: float) -> TrueEffect:
    """Return a share of an effect; of ratios their power, for a ratio of one is nothing."""

    def of(name: str, value: Any) -> Any:
        if name in SHAPES:
            return value
        array = np.asarray(value, dtype=np.float64)
        return (array**share if name == "ratio" else share * array).tolist()

    return replace(effect, parameters={k: of(k, v) for k, v in effect.parameters.items()})


def without_own(phone: Phone, effect: str) -> Phone:
    """Return a phone that has nothing itself of what is about to be given to it."""
    if effect in ("clock_skew", "accel_gyro_time_offset", "timestamp_jitter"):
        own = {"clock_skew": "skew", "accel_gyro_time_offset": "gyro_late_s", "timestamp_jitter": "jitter_s"}
        return replace(phone, clock=replace(phone.clock, **{own[effect]: 0.0}))
    if effect in CONSTANTS:
        which = CONSTANTS[effect][0]
        part: Part = getattr(phone, which)
        bare = (
            replace(part, bias=(0.0, 0.0, 0.0)) if effect.endswith("_bias") else _rescaled(part, np.zeros(3))
        )
        return replace(phone, **{which: bare})  # type: ignore[arg-type]
    return phone


def with_constant(phone: Phone, effect: TrueEffect) -> Phone:
    """Return a phone with a constant parameter as it is stated."""
    part: Part = getattr(phone, effect.sensor)
    size = np.asarray(effect.parameters["size"])
    if effect.effect.endswith("_bias"):
        changed = replace(part, bias=tuple(float(v) for v in size))
    else:
        changed = _rescaled(part, size)
    return replace(phone, **{effect.sensor: changed})  # type: ignore[arg-type]


def _rescaled(part: Part, size: Any) -> Part:
    """Return a sensor whose scale's diagonal is one and a bit."""
    scale = np.array(part.scale)
    np.fill_diagonal(scale, 1.0 + size)
    return replace(part, scale=tuple(tuple(float(v) for v in row) for row in scale))
