"""The examiner's own phones: random sensors and clocks, and the recordings that they make."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.blind_test.world.day import World
from stillcal.replay.blind_test.world.noise import Colour, at, drawn_colour, log_uniform
from stillcal.replay.formats.claims import Claims

Rows = NDArray[np.intp]

STALL_S = 0.3
"""Length of one stall of delivery, s."""

LEVEL_SPREAD, AXIS_SPREAD = 0.08, 0.05
"""Relative spread of noise densities among phones without effects: about the claim, and between axes."""

JITTER_SPAN = (0.002, 0.025)
"""Jitter of time stamps in phones without effects, as a share of the period."""

SKEW_SPREAD = 1e-4
"""Largest relative error of the clock in phones without effects."""


LATE_SPREAD_S = 5e-4
"""Largest time offset of the gyroscope in phones without effects, s."""


@dataclass(frozen=True, slots=True)
class Part:
    """One sensor: raw = Q(clip(low-pass(scale @ true + bias + noise))). ratio: of white noise, by axis."""

    colour: Colour
    bias: tuple[float, ...]
    scale: tuple[tuple[float, ...], ...]
    lsb: float
    limit: float
    ratio: tuple[float, ...] = (1.0, 1.0, 1.0)
    tail_ratio: float = 1.0
    tail_fraction: float = 0.02
    cutoff_hz: float | None = None


@dataclass(frozen=True, slots=True)
class Clock:
    """Time stamps and delivery.

    rate_hz: nominal. skew: relative error of the device's clock. dropped: share of samples lost. stalled:
    share of time in which delivery stalls. gyro_late_s: s, delay of the gyroscope.
    """

    rate_hz: float
    skew: float = 0.0
    jitter_s: float = 0.0
    latency_s: float = 0.003
    scatter_s: float = 0.0015
    dropped: float = 0.0
    stalled: float = 0.0
    gyro_late_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Phone:
    """A phone with its maker's claims. lever: m, from the centre of rotation to the accelerometer."""

    accel: Part
    gyro: Part
    clock: Clock
    claims: Claims
    thermometer: bool = True
    lever: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Additions:
    """What effects add, (n, 3): to the true force, and to the readings of either sensor."""

    force: Array
    accel: Array
    gyro: Array

    @classmethod
    def none(cls, world: World) -> Additions:
        """Return zeros to which effects are added."""
        return cls(*(np.zeros((world.t.size, 3)) for _ in range(3)))


@dataclass(frozen=True, slots=True, eq=False)
class MadeRecording:
    """A simulated recording in memory."""

    accelerometer: Samples
    gyroscope: Samples | None
    events: list[Charging] = field(default_factory=list)
    claims: Claims = field(default_factory=Claims)


def drawn_phone(family: str, rate_hz: float, gravity: float, rng: np.random.Generator) -> Phone:
    """Draw a phone without effects: noise of one family, and claims as accurate as makers' claims are."""
    accel_colour, gyro_colour = (drawn_colour(family, sensor, rng) for sensor in ("accel", "gyro"))
    accel_step = _step((4.0 * 9.81 / 2**15, 4.0 * 9.81 / 2**13), accel_colour, rate_hz, rng)
    gyro_step = _step((1.33e-4, 2.66e-4), gyro_colour, rate_hz, rng)
    accel = _part(accel_colour, 0.2, 4.0 * 9.81, accel_step, rng)
    gyro = _part(gyro_colour, 0.01, math.radians(2000.0), gyro_step, rng)
    jitter = rng.uniform(*JITTER_SPAN) / rate_hz
    clock = Clock(
        rate_hz,
        skew=float(rng.uniform(-SKEW_SPREAD, SKEW_SPREAD)),
        jitter_s=float(jitter),
        latency_s=log_uniform(rng, 0.001, 0.01),
        scatter_s=log_uniform(rng, 0.0005, 0.003),
        gyro_late_s=float(rng.uniform(-LATE_SPREAD_S, LATE_SPREAD_S)),
    )
    claims = Claims(
        device="phone",
        nominal_rate_hz=rate_hz,
        gravity=gravity,
        accel_range=accel.limit,
        gyro_range=gyro.limit,
        accel_lsb=accel.lsb,
        gyro_lsb=gyro.lsb,
        accel_noise_density=accel.colour.white,
        gyro_noise_density=gyro.colour.white,
    )
    return Phone(_own_level(accel, rng), _own_level(gyro, rng), clock, claims)


def _part(colour: Colour, bias: float, limit: float, step: float, rng: np.random.Generator) -> Part:
    """Draw a sensor. bias: standard deviation of its bias."""
    scale = np.eye(3) + np.diag(0.01 * rng.standard_normal(3)) + 0.004 * rng.standard_normal((3, 3))
    rows = tuple(tuple(float(v) for v in row) for row in scale)
    return Part(colour, tuple(float(v) for v in bias * rng.standard_normal(3)), rows, step, limit)


def _step(steps: tuple[float, float], colour: Colour, rate_hz: float, rng: np.random.Generator) -> float:
    """Draw a step, finer than the noise, so that the noise dithers it."""
    return min(steps[int(rng.integers(2))], colour.white * math.sqrt(rate_hz / 2.0))


def _own_level(part: Part, rng: np.random.Generator) -> Part:
    level = rng.uniform(1.0 - LEVEL_SPREAD, 1.0 + LEVEL_SPREAD)
    axes = rng.uniform(1.0 - AXIS_SPREAD, 1.0 + AXIS_SPREAD, 3)
    return replace(part, ratio=tuple(float(v) for v in level * axes))


def recorded(world: World, phone: Phone, added: Additions, rng: np.random.Generator) -> MadeRecording:
    """Return what a phone records of a world; the world's times are taken as the phone's own.

    A clock that runs fast by `skew` makes t seconds of t / (1 + skew), in which the same turn is faster.
    """
    arm = np.asarray(phone.lever)
    centripetal = np.cross(world.rate, np.cross(world.rate, arm)) + np.cross(world.rate_dot, arm)
    force = world.force + added.force + centripetal
    rate = _late(world.t, world.rate, phone.clock.gyro_late_s) * (1.0 + phone.clock.skew)
    accel = _read(world, phone.accel, force, added.accel, rng)
    gyro = _read(world, phone.gyro, rate, added.gyro, rng)
    stamp, arrival, delivered = _timed(world.t, phone.clock, rng)
    temperature = frozen(_thermometer(world.temperature, rng)[delivered]) if phone.thermometer else None
    return MadeRecording(
        Samples(Sensor.ACCELEROMETER, stamp, frozen(accel[delivered]), temperature, arrival),
        Samples(Sensor.GYROSCOPE, stamp, frozen(gyro[delivered]), None, arrival),
        [Charging(float(t), bool(on)) for t, on in world.drive[1:]],
        phone.claims,
    )


def _late(t: Array, values: Array, delay: float) -> Array:
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - only recordings that are made need it

    return np.asarray(CubicSpline(t, values)(np.clip(t - delay, t[0], t[-1])))


def _read(world: World, part: Part, true: Array, added: Array, rng: np.random.Generator) -> Array:
    """Return a sensor's readings (n, 3); samples come as often as the world's."""
    rate_hz = 1.0 / float(world.t[1] - world.t[0])
    sd = part.colour.white * math.sqrt(rate_hz / 2.0) * np.asarray(part.ratio)
    white = sd * rng.standard_normal(true.shape)
    if part.tail_ratio != 1.0:
        white *= np.where(rng.random(true.shape) < part.tail_fraction, part.tail_ratio, 1.0)
    slow = at(part.colour.drawn(world.duration, rng), world.t)
    analogue = true @ np.asarray(part.scale).T + np.asarray(part.bias) + added + slow + white
    if part.cutoff_hz is not None:
        analogue = low_passed(analogue, part.cutoff_hz, rate_hz)
    limited = np.clip(analogue, -part.limit, part.limit)
    return np.asarray(np.round(limited / part.lsb) * part.lsb)


def low_passed(values: Array, cutoff_hz: float, rate_hz: float) -> Array:
    """Filter (n, 3) by the second-order Butterworth response 1 / (1 + i sqrt(2) x - x^2), x = f / cutoff."""
    padded = np.concatenate([values, values[::-1]])
    x = np.fft.rfftfreq(len(padded), 1.0 / rate_hz) / cutoff_hz
    response = 1.0 / (1.0 + 1j * math.sqrt(2.0) * x - x**2)
    filtered = np.fft.irfft(np.fft.rfft(padded, axis=0) * response[:, None], len(padded), axis=0)
    return np.asarray(filtered[: len(values)])


def _timed(t: Array, clock: Clock, rng: np.random.Generator) -> tuple[Array, Array, Rows]:
    """Return stamps, arrivals and the rows delivered."""
    period = 1.0 / clock.rate_hz
    scatter = np.clip(clock.jitter_s * rng.standard_normal(t.size), -0.45 * period, 0.45 * period)
    true = t / (1.0 + clock.skew)
    arrival = true + clock.latency_s + rng.exponential(clock.scatter_s, t.size)
    stalls = round(t[-1] * clock.stalled / STALL_S)
    slot = t[-1] / max(stalls, 1)  # one stall in each, so that the share of time is what it says
    for begin in slot * np.arange(stalls) + rng.uniform(0.0, slot - STALL_S, stalls):
        rows = slice(*np.searchsorted(true, (begin, begin + STALL_S)))
        arrival[rows] = np.maximum(arrival[rows], begin + STALL_S)
    delivered = np.flatnonzero(rng.random(t.size) >= clock.dropped)
    stamp = np.maximum(t + scatter, 0.0)
    return frozen(stamp[delivered]), frozen(np.maximum.accumulate(arrival)[delivered]), delivered


def _thermometer(temperature: Array, rng: np.random.Generator) -> Array:
    noisy = temperature + 0.02 * rng.standard_normal(temperature.size)
    return np.asarray(np.round(noisy / 0.05) * 0.05)


def without_gravity(claims: Claims) -> Claims:
    """Return claims without the local gravity."""
    return msgspec.structs.replace(claims, gravity=None)


def coarse(phone: Phone, rng: np.random.Generator) -> Phone:
    """Return a phone whose quantisation steps are 1.5 to 5 times its noise, as its maker claims."""
    steps = [
        rng.uniform(1.5, 5.0) * p.colour.white * math.sqrt(phone.clock.rate_hz / 2.0)
        for p in (phone.accel, phone.gyro)
    ]
    return replace(
        phone,
        accel=replace(phone.accel, lsb=float(steps[0])),
        gyro=replace(phone.gyro, lsb=float(steps[1])),
        claims=msgspec.structs.replace(phone.claims, accel_lsb=float(steps[0]), gyro_lsb=float(steps[1])),
    )
