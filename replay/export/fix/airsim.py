"""AirSim's settings.json, corrected: noise of every IMU in it.

Names and units are explained, with sources, in `stillcal.replay.export.targets.airsim`. A setting that is
missing has AirSim's own value. JSON has no comments; the order of members stays, the spaces become those of
this writer.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.diagnosis.comparison.noise.white_noise import OF_DENSITY
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.maths.rms import rms
from stillcal.replay.export.fix.findings import (
    SENSORS,
    SLOW_NOISE,
    WHITE,
    Finding,
    Fixed,
    apply_findings,
    common_level,
    note_change,
    recorded,
    slow_walk,
)
from stillcal.replay.export.targets.airsim import KEYS, TAUS, stability

IMU = 2
"""SensorType of an IMU (AirSim, docs/sensors.md)."""

OWN = {
    "AngularRandomWalk": 0.30,
    "VelocityRandomWalk": 0.24,
    "GyroBiasStability": 4.6,
    "AccelBiasStability": 36.0,
}
"""AirSim's values of settings that are missing (ImuSimpleParams.hpp)."""


def fix(text: str | None, findings: Sequence[Finding]) -> Fixed:
    """Return the settings with the differences in them; new ones with one vehicle where there are none."""
    settings = _new() if text is None else _parsed(text)
    fixed = Fixed("")
    imus = list(_imus(settings))

    def white(finding: Finding) -> None:
        key, unit, *_ = KEYS[SENSORS[finding["sensor"]]]
        own = rms(recorded(finding, WHITE)) / float(np.sqrt(2.0)) / unit
        for imu in imus:
            _set(imu, key, common_level(_get(imu, key), finding, WHITE, own), fixed)

    def slow(finding: Finding) -> None:
        sensor = SENSORS[finding["sensor"]]
        key, walk = KEYS[sensor][2], rms(slow_walk(finding))
        for imu in imus:
            _set(imu, key, stability(sensor, walk, imu.get(TAUS[sensor]))[key], fixed)

    handlers = dict.fromkeys(SLOW_NOISE, slow) | dict.fromkeys(OF_DENSITY, white)
    apply_findings(findings, handlers, fixed)
    fixed.text = json.dumps(settings, indent=2) + "\n"
    return fixed


def _new() -> dict[str, Any]:
    sensor = {"SensorType": IMU, "Enabled": True} | {tau: KEYS[name][4] for name, tau in TAUS.items()}
    vehicle = {"VehicleType": "SimpleFlight", "Sensors": {"Imu": sensor}}
    return {"SettingsVersion": 1.2, "SimMode": "Multirotor", "Vehicles": {"Drone1": vehicle}}


def _parsed(text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"not JSON: {error}") from error
    if not isinstance(value, dict):
        raise UserError("expected a JSON object")
    return value


def _imus(settings: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield every IMU's settings; a vehicle without one gets one, where no default sensors have it."""
    vehicles = settings.setdefault("Vehicles", {"Drone1": {"VehicleType": "SimpleFlight"}})
    if not isinstance(vehicles, dict):
        raise UserError("Vehicles: expected a JSON object")
    holders = [
        settings.get("DefaultSensors"),
        *(v.get("Sensors") for v in vehicles.values() if isinstance(v, dict)),
    ]
    groups = [g for g in holders if isinstance(g, dict)]
    found = [s for g in groups for s in g.values() if isinstance(s, dict) and s.get("SensorType") == IMU]
    if not found:
        for vehicle in vehicles.values():
            sensors = vehicle.setdefault("Sensors", {}) if isinstance(vehicle, dict) else None
            if not isinstance(sensors, dict):
                raise UserError("Vehicles: expected JSON objects with Sensors, which is one")
            sensors["Imu"] = {"SensorType": IMU, "Enabled": True}
            found.append(sensors["Imu"])
    yield from found


def _get(imu: dict[str, Any], key: str) -> float:
    value = imu.get(key, OWN[key])
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < sys.float_info.max:
        raise UserError(f"{key}: expected a finite number")
    return float(value)


def _set(imu: dict[str, Any], key: str, value: float, fixed: Fixed) -> None:
    before = _get(imu, key)
    imu[key] = float(f"{value:.10g}")
    note_change(fixed, key, before, imu[key])
