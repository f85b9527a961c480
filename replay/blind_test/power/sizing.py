"""Drawing effects of the catalogue with a given d', and putting them into the examiner's phones."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.keys import TrueEffect
from stillcal.replay.blind_test.power import detectability as power
from stillcal.replay.blind_test.power import direct as sizes
from stillcal.replay.blind_test.power import rotation as motion
from stillcal.replay.blind_test.world.day import Bins, World, over_bins
from stillcal.replay.blind_test.world.forward_model import FORWARD, played, sensor_of
from stillcal.replay.blind_test.world.noise import log_uniform
from stillcal.replay.blind_test.world.phones import Additions, Phone

Drawn = tuple[dict[str, Any], float | None]
"""Parameters with their d' (None where the effect has none)."""

ALLOWED_WALK = {"accel": 30e-6 * 9.80665, "gyro": math.radians(0.001)}
"""Random walk that Android allows a phone, per sqrt(s) (compatibility definition, 7.3)."""

HAND_M_S2, HAND_S = 0.15, 0.25
"""Typical acceleration of a hand that turns a phone, and its correlation time."""


@dataclass(eq=False)
class Stage:
    """A case in the making: the world, its bins, the phone so far, and the inverse covariances by sensor."""

    world: World
    bins: Bins
    phone: Phone
    rng: np.random.Generator
    weights: dict[str, Array] = field(default_factory=dict)

    def weight(self, sensor: str) -> Array:
        """Return the inverse covariance of a sensor's bins."""
        if sensor not in self.weights:
            part = self.phone.accel if sensor == "accel" else self.phone.gyro
            self.weights[sensor] = power.precision(self.bins, sensor, part.colour)
        return self.weights[sensor]

    @property
    def still(self) -> int:
        """How many samples lie in rests."""
        return int(np.ptp(self.world.rests, axis=1).sum() * self.phone.clock.rate_hz)

    @property
    def samples(self) -> int:
        """How many samples there are."""
        return int(self.world.duration * self.phone.clock.rate_hz)

    def sigma(self, sensor: str) -> float:
        """Return the standard deviation of a sensor's single samples."""
        part = self.phone.accel if sensor == "accel" else self.phone.gyro
        return part.colour.white * math.sqrt(self.phone.clock.rate_hz / 2.0)

    def direction(self) -> Array:
        """Draw a direction that is along one axis, in a plane or anywhere, evenly."""
        active = self.rng.permutation(3) < self.rng.integers(1, 4)
        vector = np.where(active, self.rng.uniform(0.4, 1.0, 3) * self.rng.choice([-1.0, 1.0], 3), 0.0)
        return np.asarray(vector / np.linalg.norm(vector))


def _slow(stage: Stage, effect: str, sensor: str, d: float) -> Drawn:
    """Draw an effect and size it so that it has d'."""
    unit, sized = _unit(stage, effect)
    delta = over_bins(stage.world, stage.bins, played(stage.world, effect, unit))
    reached = power.d_prime(stage.weight(sensor), delta)
    if effect in ("gyro_scale_temperature", "gyro_nonlinearity"):
        reached = motion.turn_d_prime(stage.world, played(stage.world, effect, unit), stage.phone.gyro.colour)
    return {**unit, sized: (np.asarray(unit[sized]) * d / reached).tolist()}, d


def _sized(effect: str) -> str:
    """Return the parameter that sizes a slow effect."""
    endings = {
        "_temperature": "slope",
        "_warmup": "amplitude",
        "_latent": "amplitude",
        "_step": "step",
        "_drift": "rate",
        "_charging_bias": "step",
        "_nonlinearity": "quadratic",
        "_g_sensitivity": "matrix",
    }
    return next(name for ending, name in endings.items() if effect.endswith(ending))


def _unit(stage: Stage, effect: str) -> tuple[dict[str, Any], str]:
    """Draw an effect's shape at unit size; returns it and the name of the parameter that sizes it."""
    rng, direction, sized = stage.rng, stage.direction(), _sized(effect)
    if sized == "matrix":
        filled = rng.standard_normal((3, 3)) * (rng.random((3, 3)) < 0.4) + np.diag(direction)
        return {sized: filled.tolist()}, sized
    shape = {}
    if effect.endswith("_warmup"):
        shape = {"tau_s": log_uniform(rng, 60.0, 0.3 * stage.world.duration)}
    elif effect == "thermal_latent":
        shape = {"tau_s": log_uniform(rng, 150.0, 600.0)}
    elif effect.endswith("_bias_step"):
        shape = {"at_s": float(rng.uniform(0.25, 0.75) * stage.world.duration)}
    return {sized: direction.tolist(), **shape}, sized


def _walk(stage: Stage, sensor: str, d: float) -> Drawn:
    allowed = ALLOWED_WALK[sensor]
    return {"density": [allowed * math.exp(d / d_of_walks(stage, sensor, 2.0 * allowed))] * 3}, d


def d_of_walks(stage: Stage, sensor: str, density: float) -> float:
    """Return d' of random walks whose densities, about this one, are a factor of e apart."""
    white = stage.sigma(sensor) / math.sqrt(stage.phone.clock.rate_hz / 2.0)
    spacing = stage.world.duration / len(stage.world.rests)
    return power.walk_d_prime(math.e, density, white, stage.world.duration, spacing)


def _clipped(stage: Stage, sensor: str, d: float) -> Drawn:
    """Draw a limit that about d'^2 samples reach: what counts is the number of samples on the limit."""
    values = np.sort(np.abs(stage.world.force if sensor == "accel" else stage.world.rate).ravel())
    limit = max(float(values[-max(round(d * d), 4)]), 12.5 if sensor == "accel" else 1.0)
    return {"limit": limit}, math.sqrt(float((values >= limit).sum()))


def _offset(stage: Stage, sensor: str, d: float) -> Drawn:
    swept = np.cross(stage.world.rate, stage.world.force)
    information = float((swept**2).sum()) / stage.phone.clock.rate_hz / HAND_S / HAND_M_S2**2
    sign = float(stage.rng.choice([-1.0, 1.0]))
    return {"delay": sign * sizes.delay(d, information)}, d


def _lever(stage: Stage, sensor: str, d: float) -> Drawn:
    """Draw a lever arm of 1 to 6 cm; on a hinge this is far above the noise, so it has no d'."""
    return {"position": (stage.direction() * log_uniform(stage.rng, 0.01, 0.06)).tolist()}, None


def _tone(stage: Stage, sensor: str, d: float) -> Drawn:
    pitch = float(stage.rng.uniform(0.15, 0.45) * stage.phone.clock.rate_hz)
    return {"frequency": pitch, "amplitude": sizes.tone_amplitude(d, stage.still, stage.sigma("accel"))}, d


def _unequal(stage: Stage, sensor: str, d: float) -> Drawn:
    ratio = np.ones(3)
    ratio[int(stage.rng.integers(3))] = sizes.axis_ratio(d, stage.still)
    return {"ratio": ratio.tolist()}, d


SUDDEN: dict[str, Callable[[Stage, str, float], Drawn]] = {
    "accel_bias_random_walk": _walk,
    "gyro_bias_random_walk": _walk,
    "accel_saturation": _clipped,
    "gyro_saturation": _clipped,
    "accel_quantisation": lambda s, w, d: ({"step": sizes.comb_step(d, s.still, s.sigma(w))}, d),
    "gyro_quantisation": lambda s, w, d: ({"step": sizes.comb_step(d, s.still, s.sigma(w))}, d),
    "noise_level": lambda s, w, d: ({"ratio": sizes.noise_ratio(d, s.still)}, d),
    "noise_unequal_axes": _unequal,
    "noise_heavy_tailed": lambda s, w, d: ({"ratio": sizes.tail_ratio(d, s.still)}, d),
    "vibration_tone": _tone,
    "clock_skew": lambda s, w, d: (
        {"relative": sizes.skew(d, s.world.duration, s.samples, s.phone.clock.scatter_s)},
        d,
    ),
    "timestamp_jitter": lambda s, w, d: ({"sigma": sizes.jitter(d, 1.0 / s.phone.clock.rate_hz)}, d),
    "dropped_samples": lambda s, w, d: ({"fraction": sizes.dropped(d, s.samples)}, d),
    "arrival_bursts": lambda s, w, d: ({"fraction": sizes.stalled(d)}, d),
    "accel_gyro_time_offset": _offset,
    "bandwidth": lambda s, w, d: ({"cutoff": sizes.cutoff(d, s.phone.clock.rate_hz)}, d),
    "lever_arm": _lever,
}
"""Effects that do not change the bias at rest, with the function that draws each at a d'."""

TIMING = ("clock_skew", "timestamp_jitter", "dropped_samples", "arrival_bursts", "accel_gyro_time_offset")
EITHER = ("noise_level", "noise_unequal_axes", "noise_heavy_tailed", "bandwidth", "thermal_latent")
NAMES: tuple[str, ...] = (*FORWARD, *SUDDEN)
"""Every name of the documented catalogue."""


def drawn_effect(stage: Stage, effect: str, d: float) -> TrueEffect:
    """Draw an effect of the catalogue, by name, with the given d'."""
    sensor = sensor_of(effect)
    if effect in EITHER:
        sensor = ("accel", "gyro")[int(stage.rng.integers(2))]
    if effect in FORWARD:
        parameters, reached = _slow(stage, effect, sensor, d)
    else:
        parameters, reached = SUDDEN[effect](stage, sensor, d)
    reported_sensor = "timing" if effect in TIMING else sensor
    begin = parameters["at_s"] if effect.endswith("_bias_step") else 0.0
    return TrueEffect(
        effect, reported_sensor, _axes(parameters), parameters, reached, begin, stage.world.duration
    )


def _axes(parameters: dict[str, Any]) -> list[str]:
    """Return the axes on which a parameter is not zero; all for a single number."""
    main = next((np.asarray(v) for v in parameters.values() if np.ndim(v) > 0), None)
    if main is None:
        return ["x", "y", "z"]
    size = np.abs(main - ("ratio" in parameters)).reshape(3, -1).max(axis=1)
    return [axis for axis, value in zip("xyz", size, strict=True) if value > 0.05 * size.max()]


def put_in(stage: Stage, truth: TrueEffect, added: Additions) -> None:
    """Put an effect into a stage's phone or into what is added to its readings."""
    p, which = truth.parameters, "gyro" if truth.sensor == "gyro" else "accel"
    if truth.effect in FORWARD:
        getattr(added, which)[:] += played(stage.world, truth.effect, p)
    elif truth.effect == "vibration_tone":
        wave = np.sin(2.0 * math.pi * p["frequency"] * stage.world.t + stage.rng.uniform(0.0, 6.28))
        added.force[:, int(stage.rng.integers(3))] += p["amplitude"] * wave
    elif truth.effect == "lever_arm":
        stage.phone = replace(stage.phone, lever=tuple(p["position"]))
    elif truth.effect in TIMING:
        stage.phone = replace(stage.phone, clock=_retimed(stage.phone, truth.effect, p))
    else:
        stage.phone = replace(stage.phone, **{which: _repaired(stage.phone, which, truth.effect, p)})


def _retimed(phone: Phone, effect: str, p: dict[str, Any]) -> Any:
    fields = {
        "clock_skew": ("skew", "relative"),
        "timestamp_jitter": ("jitter_s", "sigma"),
        "dropped_samples": ("dropped", "fraction"),
        "arrival_bursts": ("stalled", "fraction"),
        "accel_gyro_time_offset": ("gyro_late_s", "delay"),
    }
    name, parameter = fields[effect]
    own = getattr(phone.clock, name) if name in ("skew", "gyro_late_s") else 0.0
    return replace(phone.clock, **{name: own + p[parameter]})


def as_recorded(phone: Phone, truth: TrueEffect) -> TrueEffect:
    """Return an effect with the parameters that the recording shows: the phone's own part is included."""
    part = phone.accel if truth.sensor == "accel" else phone.gyro
    total = {
        "clock_skew": {"relative": phone.clock.skew},
        "accel_gyro_time_offset": {"delay": phone.clock.gyro_late_s},
        "noise_level": {"ratio": float(np.sqrt(np.mean(np.square(part.ratio))))},
    }
    return replace(truth, parameters=total.get(truth.effect, truth.parameters))


def _repaired(phone: Phone, which: str, effect: str, p: dict[str, Any]) -> Any:
    """Return a sensor with an effect on its noise, range, step or bandwidth."""
    part = phone.accel if which == "accel" else phone.gyro
    if effect.endswith("_random_walk"):
        return replace(part, colour=replace(part.colour, walk=math.hypot(part.colour.walk, p["density"][0])))
    if effect in ("noise_level", "noise_unequal_axes"):
        return replace(part, ratio=tuple(np.asarray(part.ratio) * np.asarray(p["ratio"])))
    if effect == "noise_heavy_tailed":
        return replace(part, tail_ratio=p["ratio"])
    if effect == "bandwidth":
        return replace(part, cutoff_hz=p["cutoff"])
    return replace(
        part, **({"lsb": p["step"]} if effect.endswith("_quantisation") else {"limit": p["limit"]})
    )
