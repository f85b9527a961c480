"""Biases that follow a driver: temperature, warm-up, drift, step, charging, and heat unmeasured."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.hypothesis import (
    TILTED,
    Entry,
    Hypothesis,
    Linear,
    Scene,
    bias_columns,
    curves,
    no_hypotheses,
)
from stillcal.calib_core.diagnosis.model.records import NAME
from stillcal.calib_core.diagnosis.slow import regressors as drivers

DRIFT_HANDICAP = 1.5
"""A ramp is what a random walk looks like: steady drift must be thirty times less likely by chance."""

ROUGH = 0.25
"""How far heat is from a first-order response to charging and use, as a part of it."""

UNIT = {"accel": "m/s^2", "gyro": "rad/s"}
SIZE = {"accel": 0.3, "gyro": 0.02}
PER_KELVIN = {"accel": 0.02, "gyro": 2e-3}


def _near_step(entry: Entry, scene: Scene, grid: dict[str, float]) -> list[Hypothesis]:
    found = drivers.steps_near(scene, grid["t_start"])
    blind = TILTED if scene.bins.pose is None else ()
    return [Hypothesis(entry, g, bias_columns(scene, curve, blind)) for g, curve in found]


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
    """Propose what else one cause does: a phone's heat has several lags and a start of its own."""
    curves = drivers.other_lags(scene.bins)
    return [Hypothesis(entry, {}, bias_columns(scene, curve)) for curve in curves]


def entries(sensor: str) -> list[Entry]:
    """Return the bias entries of one sensor, "accel" or "gyro"."""
    return [*_thermal(sensor), *_timed(sensor)]


def _thermal(sensor: str) -> list[Entry]:
    """Return what follows heat: temperature, warm-up, and heat without a thermometer."""
    unit, name, size = UNIT[sensor], NAME[sensor], SIZE[sensor]
    thermal, warmup, drift = (f"{sensor}_{x}" for x in ("bias_temperature", "warmup", "bias_drift"))
    return [
        Entry(
            effect=thermal,
            sensor=sensor,
            follows="temperature",
            propose=curves(drivers.temperature),
            parameters=(Linear("slope", f"{unit}/K", 3, PER_KELVIN[sensor]),),
            sentence=f"The {name}'s bias changes with temperature on {{axes}}.",
            look_alikes=(warmup, drift, f"{sensor}_scale_temperature"),
            decides="let the phone warm and cool twice, in several attitudes",
        ),
        Entry(
            effect=warmup,
            sensor=sensor,
            follows="time since start",
            propose=curves(drivers.warmup),
            parameters=(Linear("amplitude", unit, 3, size),),
            sentence=f"The {name}'s bias settles after the start of the recording on {{axes}}.",
            look_alikes=(thermal, drift, "thermal_latent"),
            decides="switch on cold once more, or record temperature",
            grid_units={"tau_s": "s"},
            refine=_near_tau,
        ),
        Entry(
            effect="thermal_latent",
            sensor=sensor,
            follows="charging and use",
            propose=curves(drivers.latent_heat),
            parameters=(Linear("amplitude", unit, 3, size),),
            sentence=f"The {name}'s bias on {{axes}} follows the heat of charging and use (no thermometer).",
            look_alikes=(warmup, f"{sensor}_charging_bias", drift),
            decides="record temperature, or let the phone cool unplugged",
            grid_units={"tau_s": "s"},
            refine=_near_tau,
            kin=_other_lags,
            rough=ROUGH,
        ),
    ]


def _timed(sensor: str) -> list[Entry]:
    """Return what follows the clock or the plug: drift, step, charging."""
    unit, name, size = UNIT[sensor], NAME[sensor], SIZE[sensor]
    thermal, walk = f"{sensor}_bias_temperature", f"{sensor}_bias_random_walk"
    return [
        Entry(
            effect=f"{sensor}_bias_drift",
            sensor=sensor,
            follows="time",
            propose=curves(drivers.drift),
            parameters=(Linear("rate", f"{unit}/s", 3, size / 3600.0),),
            sentence=f"The {name}'s bias drifts steadily on {{axes}}.",
            look_alikes=(f"{sensor}_warmup", thermal, walk),
            decides="record for several times as long",
            handicap=DRIFT_HANDICAP,
        ),
        Entry(
            effect=f"{sensor}_bias_step",
            sensor=sensor,
            follows="time",
            propose=no_hypotheses,
            bank=drivers.steps,
            parameters=(Linear("step", unit, 3, size),),
            sentence=f"The {name}'s bias jumped once on {{axes}}.",
            look_alikes=(f"{sensor}_charging_bias", walk),
            decides="knock the phone again, or repeat with the plug untouched",
            grid_units={"t_start": "s"},
            refine=_near_step,
            recurs=True,
        ),
        Entry(
            effect=f"{sensor}_charging_bias",
            sensor=sensor,
            follows="charging",
            propose=curves(drivers.charging),
            parameters=(Linear("step", unit, 3, size),),
            sentence=f"The {name}'s bias changes while charging on {{axes}}.",
            look_alikes=(thermal, f"{sensor}_bias_step", "thermal_latent"),
            decides="plug in and out several times, some minutes apart",
        ),
    ]
