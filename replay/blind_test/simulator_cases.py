"""The other half of the cases: motion and phones of `stillcal.replay.phone`, as the examiner's worlds."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.streams.events import Charging
from stillcal.replay.blind_test.keys import TrueEffect
from stillcal.replay.blind_test.power.sizing import EITHER
from stillcal.replay.blind_test.world.day import World
from stillcal.replay.blind_test.world.forward_model import FORWARD
from stillcal.replay.blind_test.world.phones import MadeRecording, Part, Phone
from stillcal.replay.phone import Simulation, simulate
from stillcal.replay.phone import phone as simulator
from stillcal.replay.phone.scenario import Scenario

GRID_S = 0.5
"""Step at which a simulated recording is evaluated to compute d' at rest, s."""

CAN = (
    *(n for n in FORWARD if n not in ("gyro_scale_temperature", "gyro_nonlinearity")),
    "accel_bias_random_walk",
    "gyro_bias_random_walk",
    "accel_quantisation",
    "gyro_quantisation",
    "noise_level",
    "noise_unequal_axes",
    "noise_heavy_tailed",
    "clock_skew",
    "timestamp_jitter",
    "dropped_samples",
    "arrival_bursts",
)
"""Effects whose d' needs rests or samples only, and that simulated phones can have."""

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


def drawn_day(duration: float, rng: np.random.Generator) -> Scenario:
    """Draw a day of rests and turns, on and off the charger, in rooms of several temperatures."""
    pieces = int(rng.integers(4, 8))
    segments = [
        {
            "activity": "table",
            "duration_s": duration / pieces,
            "rest_s": [20.0, 80.0],
            "look": 0.1,
            "supports": _SUPPORTS,
            "charging": i % 2 == 1,
            "ambient_c": float(rng.uniform(18.0, 28.0)),
        }
        for i in range(pieces)
    ]
    place = {
        "latitude": float(rng.uniform(-65.0, 65.0)),
        "longitude": 0.0,
        "altitude": float(rng.uniform(0.0, 800.0)),
    }
    settings = {"segment": segments, "duration_s": duration, "place": place, "earth_rotation": True}
    return msgspec.convert(settings, type=Scenario)


def world_of(simulation: Simulation) -> World:
    """Return a simulated day as a world on a coarse grid; good for rests, not for motion."""
    t = np.arange(0.0, simulation.plan.duration, GRID_S)
    motion, around = simulation.plan.motion(t), simulation.plan.surroundings
    heating = around.heating()
    spans = np.array([(r.t_start, r.t_end) for r in simulation.truth.rests if r.t_end - r.t_start > 2.0])
    return World(
        t,
        motion.force,
        motion.rate,
        motion.rate_dot,
        simulation.temperature_at(t),
        around.charging.at(t),
        np.column_stack([heating.t, heating.value]),
        spans,
        np.empty((0, 6)),
    )


def simulated(phone: Phone, day: Scenario, effects: list[TrueEffect], seed: int, creep: bool) -> Simulation:
    """Return the simulation of a phone drawn here, with effects, through a day."""
    entries = [_entry(phone, e) for e in effects] + (
        [{"name": "tilt_creep", "amplitude": 3e-4}] if creep else []
    )
    clock = phone.clock
    table = {
        "description": "phone",
        "accel": _sensor(phone.accel, clock.rate_hz),
        "gyro": _sensor(phone.gyro, clock.rate_hz),
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
    return simulate(day, msgspec.convert(table, type=simulator.Phone), seed)


def _sensor(part: Part, rate_hz: float) -> dict[str, Any]:
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
        "lsb": part.lsb,
        "range": part.limit,
        "noise": noise,
    }


def _entry(phone: Phone, truth: TrueEffect) -> dict[str, Any]:
    """Return an effect as a phone file has it. A phone file's jitter comes on top of the phone's own."""
    entry = {"name": truth.effect, **truth.parameters}
    if truth.effect in EITHER:
        entry["sensor"] = truth.sensor
    if truth.effect == "timestamp_jitter":
        entry["sigma"] = math.sqrt(max(entry["sigma"] ** 2 - phone.clock.jitter_s**2, 0.0))
    return entry


def recorded(simulation: Simulation, phone: Phone) -> MadeRecording:
    """Return the recording, with the claims of the phone as it was drawn and of the place where it is."""
    whole = simulation.whole()
    charging = [e for e in whole.events if isinstance(e, Charging)]
    claims = msgspec.structs.replace(phone.claims, gravity=round(simulation.truth.intervals[0].gravity, 5))
    return MadeRecording(whole.accelerometer, whole.gyroscope, charging, claims)
