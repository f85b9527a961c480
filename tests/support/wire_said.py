"""Messages and runs of samples to say on a wire, and their comparison with what came of them."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams.events import Charging, End, Location, Temperature, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.wire.messages import Grant, Hello, Identify, Message, Rate, Status

A, G = Sensor.ACCELEROMETER, Sensor.GYROSCOPE

OTHERS: list[Message] = [
    Hello(
        session=7, flow="credit", claims={"device": "bench*1,A", "nominal_rate_hz": 100.0, "accel_lsb": None}
    ),
    Hello(),
    Temperature(12.5, 31.25),
    Charging(3600.0, True),
    Charging(7200.0, False),
    Location(1.5, 52.2, 0.1, 17.0),
    Location(1.5, -33.9, 151.2),
    Tick(99.000001),
    Status(99.5, 12.25, True, 3),
    Sense(120.0),
    Sense(math.inf),
    Sleep(300.5),
    Sleep(math.inf),
    Rate(50.0),
    Grant(10.0),
    Identify(),
    End(86400.0),
]


def run(n: int, sensor: Sensor = A, start: float = 0.0, seed: int = 1, temperature: bool = False) -> Samples:
    rng = np.random.default_rng(seed)
    t = start + np.cumsum(rng.uniform(0.005, 0.015, n))
    return Samples.checked(sensor, t, rng.normal(0, 9, (n, 3)), rng.normal(30, 1, n) if temperature else None)


def joined(messages: Iterable[object], sensor: Sensor = A) -> Samples:
    runs = [m for m in messages if isinstance(m, Samples) and m.sensor is sensor]
    return Samples.joined(runs) if runs else Samples.empty(sensor)


def same(a: Samples, b: Samples) -> bool:
    """Whether two runs are equal bit for bit, columns that are not there included."""

    def columns(s: Samples) -> list[bytes | None]:
        return [None if c is None else c.tobytes() for c in (s.t, s.xyz, s.temperature, s.t_arrival)]

    return a.sensor is b.sensor and columns(a) == columns(b)


def others(messages: Iterable[Message]) -> list[Message]:
    return [m for m in messages if not isinstance(m, Samples)]
