"""A short life, a phone with or without effects, and both recordings: what the tests of effects share."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from stillcal.replay.phone import Phone, Scenario, simulate
from stillcal.replay.phone.effects.base import Effect
from stillcal.replay.phone.effects.registry import EFFECTS
from stillcal.replay.phone.settings import ClockSettings, HeatSettings, Noise, SensorSettings

SILENT = Noise()
V = (0.3, -0.2, 0.1)
SCENARIO = """
{"ambient_c": 20.0, "duration_s": 150.0, "segment": [
  {"activity": "table", "duration_s": 60.0, "rest_s": [4.0, 9.0], "use": 0.5},
  {"activity": "walk", "duration_s": 30.0, "ambient_c": 12.0},
  {"activity": "table", "duration_s": 60.0, "rest_s": [4.0, 9.0], "charging": true}
]}
"""
M = np.array([[1.01, 0.004, -0.003], [0.002, 0.99, 0.005], [-0.004, 0.001, 1.02]])
G3 = ((0.01, 0.002, 0.0), (0.0, -0.01, 0.003), (0.001, 0.0, 0.02))


def scenario() -> Scenario:
    return msgspec.json.decode(SCENARIO, type=Scenario)


def phone(*effects: Effect, noise: Noise = SILENT, **clock: Any) -> Phone:
    sensor = SensorSettings(
        rate_hz=100.0, bias=(0.1, -0.2, 0.3), scale=tuple(map(tuple, M.tolist())), noise=noise
    )
    return Phone(
        accel=sensor,
        gyro=sensor,
        clock=ClockSettings(shared=True, **clock),
        heat=HeatSettings(),
        effects=effects,
    )


def effect(name: str, **parameters: Any) -> Effect:
    return msgspec.convert({"name": name, **parameters}, type=EFFECTS[name])


def both(*effects: Effect, noise: Noise = SILENT, **clock: Any) -> tuple[Any, Any]:
    return (
        simulate(scenario(), phone(noise=noise, **clock), seed=1).whole(),
        simulate(scenario(), phone(*effects, noise=noise, **clock), seed=1).whole(),
    )
