"""AirSim's settings.json, corrected: noise of every IMU in it.

Names and units are explained, with sources, in `stillcal.replay.export.airsim`. A setting that is missing has
AirSim's own value. JSON has no comments; the order of members stays, the spaces become those of this writer.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.errors import UserError
from stillcal.replay.export.airsim import KEYS, TAUS
from stillcal.replay.export.fix.findings import (
    SENSORS,
    Finding,
    Fixed,
    apply_findings,
    common_ratio,
    note_change,
)

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
        _multiply(imus, KEYS[SENSORS[finding["sensor"]]][0], common_ratio(finding, "density"), fixed)

    def slow(finding: Finding) -> None:
        factor = common_ratio(finding, "allan_deviation_100s")
        _multiply(imus, KEYS[SENSORS[finding["sensor"]]][2], factor, fixed)

    handlers = {"noise_level": white, "accel_slow_noise": slow, "gyro_slow_noise": slow}
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
            sensors = vehicle.setdefault("Sensors", {})
            sensors["Imu"] = {"SensorType": IMU, "Enabled": True}
            found.append(sensors["Imu"])
    yield from found


def _multiply(imus: Sequence[dict[str, Any]], key: str, factor: float, fixed: Fixed) -> None:
    for imu in imus:
        before = imu.get(key, OWN[key])
        if not isinstance(before, int | float):
            raise UserError(f"{key}: expected a number")
        imu[key] = float(f"{before * factor:.10g}")
        note_change(fixed, key, float(before), np.float64(imu[key]))
