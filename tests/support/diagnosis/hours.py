"""Hours with a phone, from arrays alone: rests, turns and handling, two sensors, stamps, and any one fault.

Written apart from `stillcal.replay`, so that a trial does not rest on one maker's habits. `Hour` is what is
drawn;
`made` plays it. Faults are functions of `faults.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor

Array = NDArray[np.float64]
G = 9.80665


@dataclass
class Played:
    """What the sensors will say before steps and limits. t: (n,) true s; up, rate, rate_dot: (n, 3) body."""

    rng: np.random.Generator
    hour: Hour
    t: Array
    up: Array
    rate: Array
    rate_dot: Array
    shaking: Array
    force: Array = field(default_factory=lambda: np.zeros(0))
    white: dict[str, Array] = field(default_factory=dict)
    values: dict[str, Array] = field(default_factory=dict)
    stamp: Array = field(default_factory=lambda: np.zeros(0))
    arrival: Array = field(default_factory=lambda: np.zeros(0))
    keep: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))


Fault = Callable[[Played], None]


@dataclass
class Hour:
    """A phone's hour. Densities per sqrt(Hz), steps and limits SI; `claims` are of these unless told.

    handled: share of the time in a hand; rests, turn_s: lengths in s; jitter: part of the period; level,
    axes: true
    over claimed density, whole sensor and by axis; decimals: of values and stamps as printed (None: all).
    before: faults of the input; on_values: before steps and limits; on_clock: of stamps; after: of what is
    written.
    """

    duration: float = 3600.0
    rate: float = 50.0
    rests: tuple[float, float] = (20.0, 90.0)
    turn_s: tuple[float, float] = (0.8, 2.5)
    attitudes: int = 14
    handled: float = 0.0
    wander: float = 1.0
    density: dict[str, float] = field(default_factory=lambda: {"accel": 1.5e-3, "gyro": 1.2e-4})
    lsb: dict[str, float] = field(default_factory=lambda: {"accel": 6e-4, "gyro": 1.33e-4})
    limit: dict[str, float] = field(default_factory=lambda: {"accel": 78.0, "gyro": 35.0})
    level: float = 1.0
    axes: float = 0.0
    jitter: float = 0.005
    skew: float = 0.0
    latency: float = 0.001
    decimals: tuple[int | None, int | None] = (None, None)
    thermometer: bool = True
    arrives: bool = True
    before: tuple[Fault, ...] = ()
    on_values: tuple[Fault, ...] = ()
    on_clock: tuple[Fault, ...] = ()
    after: tuple[Fault, ...] = ()
    claims: Claims | None = None

    def told(self) -> Claims:
        """Return what the maker claims of a sound phone like this."""
        return self.claims or Claims(
            self.rate, G, self.limit["accel"], self.limit["gyro"], self.lsb["accel"], self.lsb["gyro"],
            self.density["accel"], self.density["gyro"],
        )  # fmt: skip


def _bell(x: Array) -> tuple[Array, Array, Array]:
    """Angle, rate and acceleration of a minimum-jerk turn of unit angle and time."""
    return 10 * x**3 - 15 * x**4 + 6 * x**5, 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


def _axis_turn(axis: Array, angle: Array) -> Array:
    """Rotation matrices (n, 3, 3) about a unit axis."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * cross + (1 - c) * (cross @ cross)


def _motion(hour: Hour, rng: np.random.Generator, t: Array) -> tuple[Array, Array, Array, Array]:
    """Return up, rate, rate_dot (n, 3) of rests, turns and handling, and how much the hand shakes (n,)."""
    up, rate, dot, shaking = (
        np.zeros((t.size, 3)),
        np.zeros((t.size, 3)),
        np.zeros((t.size, 3)),
        np.zeros(t.size),
    )
    targets = rng.normal(size=(hour.attitudes, 3))
    targets /= np.linalg.norm(targets, axis=1, keepdims=True)
    now, clock = targets[0], 0.0
    while clock < hour.duration:
        held = rng.random() < hour.handled
        rest = 0.0 if held else rng.uniform(*hour.rests)
        last = clock + rest
        a, b = np.searchsorted(t, (clock, last))
        up[a:b] = now
        length = float(rng.uniform(*hour.turn_s)) * (0.7 if held else 1.0)
        goal = targets[rng.integers(hour.attitudes)] if not held else now + 0.6 * rng.normal(size=3)
        goal = goal / np.linalg.norm(goal)
        axis = np.cross(goal, now) + 0.3 * rng.normal(size=3) * (1e-9 + np.linalg.norm(np.cross(goal, now)))
        axis /= max(np.linalg.norm(axis), 1e-12)
        angle = float(np.arccos(np.clip(now @ goal, -1, 1))) + 0.1
        a, b = np.searchsorted(t, (last, last + length))
        turned, speed, gain = _bell((t[a:b] - last) / length)
        R = _axis_turn(axis, turned * angle)
        up[a:b] = np.einsum("nji,j->ni", R, now)
        rate[a:b], dot[a:b] = np.outer(speed * angle / length, axis), np.outer(gain * angle / length**2, axis)
        shaking[a:b] = speed / 1.9 if not held else 1.0
        now = _axis_turn(axis, np.array([angle]))[0].T @ now
        clock = last + length
    return up, rate, dot, shaking


def _hand(rng: np.random.Generator, n: int, rate: float) -> Array:
    """Acceleration of a hand: noise of 0.25 s memory, unit size (n, 3)."""
    keep = np.exp(-1.0 / (0.25 * rate))
    return np.asarray(lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], rng.normal(size=(n, 3)), axis=0))


def _wander(rng: np.random.Generator, n: int, rate: float, size: float) -> Array:
    """Flicker of a bias: unit white noise shaped second by second, held between."""
    m = int(n / rate) + 3
    spectrum = np.fft.rfft(rng.normal(size=(2 * m, 3)), axis=0)
    f = np.maximum(np.fft.rfftfreq(2 * m, 1.0), 0.5 / m)
    slow = np.fft.irfft(spectrum / np.sqrt(f)[:, None], axis=0)[:m] / np.sqrt(2 * np.log(2) * 2)
    x = np.arange(n) / rate
    return size * np.stack([np.interp(x, np.arange(m), slow[:, a]) for a in range(3)], axis=1)


def made(hour: Hour, seed: int) -> tuple[Samples, Samples, list[Charging], Claims]:
    """Play an hour: accelerometer, gyroscope, events, claims."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(hour.duration * hour.rate)) / hour.rate
    played = Played(rng, hour, t, *_motion(hour, rng, t))
    played.force = G * played.up + 0.4 * played.shaking[:, None] * _hand(rng, t.size, hour.rate)
    for fault in hour.before:
        fault(played)
    _read(played)
    _timed(played)
    for fault in hour.after:
        fault(played)
    warm = 25.0 + 4.0 * np.sin(t / 700.0) + np.where((t % 1500.0) < 700.0, 2.0, 0.0)
    temperature = np.round(warm, 1)[played.keep] if hour.thermometer else None
    digits, ticks = hour.decimals
    stamp = played.stamp[played.keep] if ticks is None else np.round(played.stamp[played.keep], ticks)
    arrival = played.arrival[played.keep] if ticks is None else np.round(played.arrival[played.keep], ticks)
    streams = []
    for sensor, kind in (("accel", Sensor.ACCELEROMETER), ("gyro", Sensor.GYROSCOPE)):
        values = played.values[sensor][played.keep]
        values = values if digits is None else np.round(values, digits)
        own = temperature if sensor == "accel" else None
        streams.append(Samples.checked(kind, stamp, values, own, arrival if hour.arrives else None))
    plugs = [
        Charging(float(s), bool(i % 2 == 0)) for i, s in enumerate(np.arange(300.0, hour.duration, 700.0))
    ]
    return streams[0], streams[1], plugs, hour.told()


def _read(played: Played) -> None:
    """Let both sensors read: affine errors, wander, white noise, then faults, then steps and limits."""
    hour, rng, n = played.hour, played.rng, played.t.size
    true = {"accel": played.force, "gyro": played.rate}
    for sensor, bias in (("accel", 0.2), ("gyro", 0.01)):
        scale = np.eye(3) + np.diag(0.01 * rng.normal(size=3)) + 0.004 * rng.normal(size=(3, 3))
        spread = hour.level * (1.0 + hour.axes * rng.uniform(-1.0, 1.0, 3))
        sd = hour.density[sensor] * np.sqrt(hour.rate / 2.0) * spread
        played.white[sensor] = sd * rng.normal(size=(n, 3))
        slow = _wander(rng, n, hour.rate, hour.wander * {"accel": 4e-4, "gyro": 3e-5}[sensor])
        played.values[sensor] = true[sensor] @ scale.T + bias * rng.normal(size=3) + slow
    for fault in hour.on_values:
        fault(played)
    for sensor in ("accel", "gyro"):
        raw = played.values[sensor] + played.white[sensor]
        limit, lsb = hour.limit[sensor], hour.lsb[sensor]
        played.values[sensor] = np.round(np.clip(raw, -limit, limit) / lsb) * lsb


def _timed(played: Played) -> None:
    hour, rng, t = played.hour, played.rng, played.t
    period = 1.0 / hour.rate
    played.keep = np.ones(t.size, dtype=bool)
    off = np.clip(hour.jitter * rng.normal(size=t.size), -0.45, 0.45) * period
    played.stamp = np.maximum(t + off, 0.0)
    played.arrival = t / (1.0 + hour.skew) + 0.003 + rng.exponential(hour.latency, t.size)
    for fault in hour.on_clock:
        fault(played)
    played.stamp = np.maximum.accumulate(played.stamp)
    played.arrival = np.maximum.accumulate(played.arrival)


def with_fault(hour: Hour, stage: str, *faults: Fault) -> Hour:
    """Return an hour with faults at a stage (`before`, `on_values`, `on_clock`, `after`)."""
    return replace(hour, **{stage: (*getattr(hour, stage), *faults)})  # type: ignore[arg-type]
