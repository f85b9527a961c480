"""Biases that follow a driver: temperature, warm-up, drift, step, charging, and heat without a thermometer."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit.catalogue import drivers
from stillcal.calib_core.misfit.catalogue.entry import (
    Entry,
    Hypothesis,
    Linear,
    Scene,
    bias_columns,
    curves,
)
from stillcal.calib_core.samples import Array

DRIFT_HANDICAP = 1.5
"""A ramp is what a random walk looks like: steady drift must be thirty times less likely by chance."""

UNIT = {"accel": "m/s^2", "gyro": "rad/s"}
SIZE = {"accel": 0.3, "gyro": 0.02}
PER_KELVIN = {"accel": 0.02, "gyro": 2e-3}
NAME = {"accel": "accelerometer", "gyro": "gyroscope"}


def _step(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """Propose steps: a nudged phone steps across gravity too, so the tangent view is left out."""
    found = drivers.steps(scene)
    return [Hypothesis(entry, grid, bias_columns(scene, curve, ("tangent",))) for grid, curve in found]


def _near_step(entry: Entry, scene: Scene, grid: dict[str, float]) -> list[Hypothesis]:
    found = drivers.steps_near(scene, grid["t_start"])
    return [Hypothesis(entry, g, bias_columns(scene, curve, ("tangent",))) for g, curve in found]


def _near_tau(entry: Entry, scene: Scene, grid: dict[str, float]) -> list[Hypothesis]:
    """Propose time constants within a factor of four."""
    taus = grid["tau_s"] * np.geomspace(0.25, 4.0, 17)
    found = [(grid | {"tau_s": float(tau)}, _settling(scene, grid | {"tau_s": float(tau)})) for tau in taus]
    return [Hypothesis(entry, g, bias_columns(scene, curve)) for g, curve in found]


def _settling(scene: Scene, grid: dict[str, float]) -> Array:
    if "plug" not in grid:
        return drivers.relaxation(scene.bins, grid["tau_s"])
    curve = drivers.heat(scene.bins, grid["tau_s"], grid["plug"], grid["use"], grid["start"])
    return np.asarray(curve / np.ptp(curve))


def _other_lags(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """A phone's heat has several lags and a start of its own: all of one cause."""
    curves = drivers.other_lags(scene.bins)
    return [Hypothesis(entry, {}, bias_columns(scene, curve)) for curve in curves]


def entries(sensor: str) -> list[Entry]:
    """Return the bias entries of one sensor, "accel" or "gyro"."""
    unit, name, size = UNIT[sensor], NAME[sensor], SIZE[sensor]
    own = [
        f"{sensor}_{x}" for x in ("bias_temperature", "warmup", "bias_drift", "bias_step", "charging_bias")
    ]
    thermal, warmup, drift, step, charging = own
    return [
        Entry(
            thermal, sensor, "temperature", curves(drivers.temperature), (Linear("slope", f"{unit}/K", 3, PER_KELVIN[sensor]),),
            f"The {name}'s bias follows temperature on {{axes}}.",
            (warmup, drift, f"{sensor}_scale_temperature"),
            "let the phone warm and cool twice, in several attitudes",
        ),
        Entry(
            warmup, sensor, "time since start", curves(drivers.warmup), (Linear("amplitude", unit, 3, size),),
            f"The {name}'s bias settles after the start of the recording on {{axes}}.",
            (thermal, drift, "thermal_latent"), "switch on cold once more, or record temperature", {"tau_s": "s"}, _near_tau,
        ),
        Entry(
            drift, sensor, "time", curves(drivers.drift), (Linear("rate", f"{unit}/s", 3, size / 3600.0),),
            f"The {name}'s bias drifts steadily on {{axes}}.",
            (warmup, thermal, f"{sensor}_bias_random_walk"), "record for several times as long", handicap=DRIFT_HANDICAP,
        ),
        Entry(
            step, sensor, "time", _step, (Linear("step", unit, 3, size),),
            f"The {name}'s bias jumped once on {{axes}}.",
            (charging, f"{sensor}_bias_random_walk"), "knock the phone again, or repeat with the plug untouched",
            {"t_start": "s"}, _near_step, recurs=True,
        ),
        Entry(
            charging, sensor, "charging", curves(drivers.charging), (Linear("step", unit, 3, size),),
            f"The {name}'s bias switches with the charger on {{axes}}.",
            (thermal, step, "thermal_latent"), "plug in and out several times, some minutes apart",
        ),
        Entry(
            "thermal_latent", sensor, "charging and use", curves(drivers.latent_heat), (Linear("amplitude", unit, 3, size),),
            f"The {name}'s bias on {{axes}} follows a slow curve like heat from charging and use.",
            (warmup, charging, drift), "record temperature, or let the phone cool unplugged", {"tau_s": "s"}, _near_tau, _other_lags,
        ),
    ]  # fmt: skip
