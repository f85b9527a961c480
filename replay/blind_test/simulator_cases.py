"""The other half of the cases: motion and phones of `stillcal.replay.phone`, as the examiner's worlds."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.blind_test.keys import TrueEffect
from stillcal.replay.blind_test.power.sizing import EITHER, NAMES
from stillcal.replay.blind_test.world.day import World
from stillcal.replay.blind_test.world.noise import log_uniform
from stillcal.replay.blind_test.world.phones import Additions, MadeRecording, Part, Phone
from stillcal.replay.phone import Simulation, simulate
from stillcal.replay.phone import phone as simulator
from stillcal.replay.phone.scenario import Scenario

CANNOT = ("gyro_scale_temperature", "gyro_nonlinearity", "accel_saturation", "gyro_saturation", "lever_arm")
"""Effects that need the examiner's own turns, its shakes or its hinge."""

CAN = tuple(name for name in NAMES if name not in CANNOT)
"""Effects that simulated phones can have."""

GROUNDS = ("firm", "foam", "cushion", "breathing", "vehicle")
"""What a simulated phone can lie on."""

DECOYS = ("thermometer", "quantisation", "location")
"""Decoys that simulated phones can have."""

_SUPPORTS = {
    "screen_up": 0.2,
    "screen_down": 0.15,
    "leaning": 0.15,
    "stand_landscape": 0.15,
    "on_long_edge": 0.15,
    "upright": 0.1,
    "upside_down": 0.1,
}
"""How often a phone is put down on each support: mostly flat, as on tables. Assumed."""

_CREEP = {"foam": (3e-4, 5e-3), "cushion": (2e-3, 1.5e-2)}
"""By how much a support gives way, rad."""


def drawn_day(
    duration: float, rng: np.random.Generator, ground: str = "firm", *, wandering: bool = False
) -> Scenario:
    """Draw a day of rests and turns, on and off the charger, in rooms of several temperatures.

    wandering: whether the air changes every few minutes, as at an open window.
    """
    pieces = int(rng.integers(9, 14)) if wandering else int(rng.integers(4, 8))
    spread = (14.0, 32.0) if wandering else (18.0, 28.0)
    segments: list[dict[str, Any]] = [
        {
            "activity": "table",
            "duration_s": duration / pieces,
            "rest_s": [20.0, 80.0],
            "look": 0.1,
            "supports": _SUPPORTS,
            "charging": i % 2 == 1,
            "ambient_c": float(rng.uniform(*spread)),
        }
        for i in range(pieces)
    ]
    if ground in ("breathing", "vehicle"):
        inserted: dict[str, dict[str, Any]] = {
            "breathing": {"activity": "mattress", "shift_s": [60.0, 300.0]},
            "vehicle": {"activity": "drive"},
        }
        segments.insert(pieces // 2, {**inserted[ground], "duration_s": duration / 4.0})
    place = {
        "latitude": float(rng.uniform(-65.0, 65.0)),
        "longitude": 0.0,
        "altitude": float(rng.uniform(0.0, 800.0)),
    }
    settings = {"segment": segments, "duration_s": duration, "place": place, "earth_rotation": True}
    return msgspec.convert(settings, type=Scenario)


def world_of(simulation: Simulation, rate_hz: float) -> World:
    """Return a simulated day as a world; its turns are unknown."""
    t = np.arange(0.0, simulation.plan.duration, 1.0 / rate_hz)
    motion, around = simulation.plan.motion(t), simulation.plan.surroundings
    heating = around.heating()
    spans = np.array([(r.t_start, r.t_end) for r in simulation.truth.rests if r.t_end - r.t_start > 2.0])
    begins = np.array([p.t_start for p in simulation.plan.pieces])
    north = np.array([p.attitude[1] for p in simulation.plan.pieces])
    return World(
        t,
        motion.force,
        motion.rate,
        motion.rate_dot,
        north[np.maximum(np.searchsorted(begins, t, side="right") - 1, 0)],
        simulation.temperature_at(t),
        around.charging.at(t),
        np.column_stack([heating.t, heating.value]),
        spans,
        np.empty((0, 6)),
    )


def phone_table(phone: Phone, entries: list[dict[str, Any]], *, rounded: bool = True) -> dict[str, Any]:
    """Return a phone drawn here as a phone file has it. rounded: whether it rounds readings to their step."""
    clock = phone.clock
    return {
        "description": "phone",
        "accel": _sensor(phone.accel, clock.rate_hz, rounded=rounded),
        "gyro": _sensor(phone.gyro, clock.rate_hz, rounded=rounded),
        "clock": {
            "shared": True,
            "skew": clock.skew,
            "jitter_s": clock.jitter_s,
            "latency_s": clock.latency_s,
            "latency_jitter_s": clock.scatter_s,
            "gyro_delay_s": clock.gyro_late_s,
        },
        "heat": {"thermometer": phone.thermometer, "thermometer_lsb_c": 0.05, "thermometer_noise_c": 0.02},
        "effect": entries,
    }


def creep_of(ground: str, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Draw how a ground gives way, as an entry of a phone file; none for a firm one."""
    if ground not in _CREEP:
        return []
    return [
        {
            "name": "tilt_creep",
            "amplitude": log_uniform(rng, *_CREEP[ground]),
            "tau_s": log_uniform(rng, 20.0, 400.0),
        }
    ]


def simulated(
    phone: Phone, day: Scenario, entries: list[dict[str, Any]], seed: int, *, rounded: bool = True
) -> Simulation:
    """Return the simulation of a phone drawn here, with entries of effects, through a day."""
    table = phone_table(phone, entries, rounded=rounded)
    return simulate(day, msgspec.convert(table, type=simulator.Phone), seed)


def _sensor(part: Part, rate_hz: float, *, rounded: bool) -> dict[str, Any]:
    """Return a sensor's settings. Flicker of bias instability B has the lowest Allan deviation 0.664 B."""
    colour = part.colour
    noise: dict[str, Any] = {
        "white": [colour.white * r for r in part.ratio],
        "flicker": colour.floor / math.sqrt(2.0 * math.log(2.0) / math.pi),
        "random_walk": colour.walk,
    }
    if colour.sigma > 0.0:
        noise["gauss_markov"] = [{"sigma": colour.sigma, "tau_s": colour.tau_s}]
    return {
        "rate_hz": rate_hz,
        "bias": part.bias,
        "scale": part.scale,
        "lsb": part.lsb if rounded else 0.0,
        "range": part.limit,
        "noise": noise,
    }


def entry_of(phone: Phone, truth: TrueEffect) -> dict[str, Any]:
    """Return an effect as a phone file has it. A phone file's jitter comes on top of the phone's own."""
    entry = {"name": truth.effect, **truth.parameters}
    if truth.effect in EITHER:
        entry["sensor"] = truth.sensor
    if truth.effect == "timestamp_jitter":
        entry["sigma"] = math.sqrt(max(entry["sigma"] ** 2 - phone.clock.jitter_s**2, 0.0))
    if truth.effect == "vibration_tone":
        entry["amplitude"] = [entry["amplitude"], 0.0, 0.0]
    return entry


def recorded(simulation: Simulation, phone: Phone, added: Additions | None = None) -> MadeRecording:
    """Return the recording, with the claims of the phone as it was drawn and of the place where it is.

    added: what is added to the readings of a simulation that is not rounded, at the times of its world.
    """
    whole = simulation.whole()
    charging = [e for e in whole.events if isinstance(e, Charging)]
    gravity = None if phone.claims.gravity is None else round(simulation.truth.intervals[0].gravity, 5)
    accel, gyro = whole.accelerometer, whole.gyroscope
    assert gyro is not None, "every phone drawn here has a gyroscope"
    if added is not None:
        t = np.arange(len(added.accel)) / phone.clock.rate_hz
        accel = _with_added(accel, t, added.accel + added.force, phone.accel.lsb)
        gyro = _with_added(gyro, t, added.gyro, phone.gyro.lsb)
    claims = msgspec.structs.replace(phone.claims, gravity=gravity)
    return MadeRecording(accel, gyro, charging, claims)


def _with_added(samples: Samples, t: Array, added: Array, step: float) -> Samples:
    """Return samples with what is added at times t (n,) s, rounded to their step."""
    nearest = np.clip(np.rint(samples.t * (1.0 / (t[1] - t[0]))).astype(np.int64), 0, t.size - 1)
    values = samples.xyz + added[nearest]
    return Samples(
        samples.sensor,
        samples.t,
        frozen(np.round(values / step) * step),
        samples.temperature,
        samples.t_arrival,
    )
