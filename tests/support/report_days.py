"""Short simulated recordings for the tests of the report: a phone that warms and cools twice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone import load_phone, simulate
from stillcal.replay.phone.activities.resting import Table
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.scenario import Scenario

THERMAL = {"name": "accel_bias_temperature", "slope": [0.006, 0.0, -0.005]}
TONE = {"name": "vibration_tone", "frequency": 17.0, "amplitude": [0.0, 0.0, 0.02]}
RATE = 25.0


PART_S = 300.0
"""Of the four parts of a recording; what is put in shows beyond doubt in rests of twenty minutes."""


def course(part_s: float = PART_S) -> Scenario:
    """Rests in which the phone warms on the charger and cools twice. part_s: how long each time, s."""
    parts = [
        Table(duration_s=part_s, rest_s=(20.0, 60.0), look=0.0, use=float(warm), charging=warm)
        for warm in (False, True, False, True)
    ]
    return Scenario(segments=tuple(parts))


def phone_with(*effects: Mapping[str, Any]) -> Phone:
    table = msgspec.to_builtins(load_phone("typical"))
    for sensor in ("accel", "gyro"):
        table[sensor]["rate_hz"] = RATE
    table["heat"] = {"charge_k": 8.0, "slow_tau_s": 300.0, "thermometer_lsb_c": 0.05}
    return msgspec.convert(table | {"effect": list(effects)}, type=Phone)


def recorded(phone: Phone, seed: int, claims: Phone | None = None, part_s: float = PART_S) -> Recording:
    """Return what a phone records. claims: the phone whose data sheet goes with it, else a default one."""
    made = simulate(course(part_s), phone, seed).whole()
    told = msgspec.convert((claims or phone_with()).claimed(), Claims)
    return Recording(made.accelerometer, made.gyroscope, list(made.events), told, [])
