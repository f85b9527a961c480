"""Phones turned from rest to rest with known truth: analytic, and nothing shared with the integrator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from msgspec import structs
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.gyroscope.fit import GyroscopeFit
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment, cut_rotation_segment
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Samples, Sensor

G = 9.80665
ACCEL = SensorModel.identity()
REST, TURN = 2.5, 3.0
X, Y, Z = np.eye(3)


@dataclass(frozen=True)
class Phone:
    """raw rate = inv(scale) rate + bias + sensitivity force + noise; the accelerometer is true but noisy.

    Densities per sqrt(Hz). wander: rad/s, step of the bias between rests.
    """

    scale: Array
    bias: Array
    sensitivity: Array
    rate_hz: float = 50.0
    density: float = np.radians(0.005)
    force_density: float = 200e-6 * G
    wander: float = 0.0


@dataclass(frozen=True)
class Recording:
    """What the phone went through: rests and the turns between them."""

    phone: Phone
    rests: list[RestState]
    turns: list[RotationSegment]

    def fit(self, **options: object) -> GyroscopeFit:
        return gyroscope.fit(self.turns, ACCEL, G, **options)  # type: ignore[arg-type]

    def z(self, fitted: GyroscopeFit) -> Array:
        """Errors of the scale in stated standard uncertainties."""
        return ((fitted.model.scale - self.phone.scale) / fitted.scale_uncertainty).ravel()


def some_phone(rng: np.random.Generator, **changes: object) -> Phone:
    """Up to 5 % scale error, 2 % misalignment, 0.2 rad/s bias."""
    scale = rng.uniform(-0.02, 0.02, (3, 3))
    np.fill_diagonal(scale, rng.uniform(0.95, 1.05, 3))
    return replace(Phone(scale, rng.uniform(-0.2, 0.2, 3), np.zeros((3, 3))), **changes)  # type: ignore[arg-type]


def turning(s: Array, axes: Array, angle: float, wobbles: Array) -> tuple[Rotation, Array]:
    """Attitude along a turn, s in 0..1, and body rates (n, 3): `angle` about axes[0], then wobbles."""
    angles = [angle * s**3 * (10 - 15 * s + 6 * s * s)]
    speeds = [angle * 30 * s**2 * (1 - s) ** 2 / TURN]
    for cycles, size in zip((2.0, 4.5, 9.0), wobbles, strict=True):
        w = 2 * np.pi * cycles
        angles.append(size * np.sin(np.pi * s) ** 2 * np.sin(w * s))
        slope = np.pi * np.sin(2 * np.pi * s) * np.sin(w * s) + np.sin(np.pi * s) ** 2 * w * np.cos(w * s)
        speeds.append(size * slope / TURN)
    attitude, rates = Rotation.identity(s.size), np.zeros((s.size, 3))
    for axis, q, speed in zip(axes, angles, speeds, strict=True):
        part = Rotation.from_rotvec(q[:, None] * axis)
        rates = part.inv().apply(rates) + speed[:, None] * axis
        attitude = attitude * part
    return attitude, rates


def recorded(
    rng: np.random.Generator,
    phone: Phone,
    n: int = 20,
    about: Sequence[Array] | None = None,
    start: Rotation | None = None,
    wobble: float = 1.0,
) -> Recording:
    """Rest and turn, n turns. about: axes to turn about, in order, again and again; else at random."""
    at = Rotation.random(random_state=rng) if start is None else start
    s = np.arange(round(TURN * phone.rate_hz)) / round(TURN * phone.rate_hz)
    still = np.zeros((round(REST * phone.rate_hz), 3))
    rates, up = [], []
    for k in range(n + 1):
        rates.append(still)
        up.append(still + at.inv().apply([0, 0, 1]))
        axes = rng.normal(size=(4, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        if about is not None:
            axes[0] = about[k % len(about)]
        angle = rng.uniform(0.8, 3.0)
        path, w = turning(s, axes, angle, wobble * rng.normal(size=3) * (0.3, 0.1, 0.04))
        rates.append(w)
        up.append((at * path).inv().apply([0, 0, 1]))
        at = at * Rotation.from_rotvec(angle * axes[0])
    return sensed(rng, phone, rates[:-1], up[:-1])


def sensed(rng: np.random.Generator, phone: Phone, rates: list[Array], up: list[Array]) -> Recording:
    """Pass rates and gravity, alternately of rests and turns, through the phone's sensors."""
    walk = np.cumsum(rng.normal(size=(len(rates), 3)), axis=0) * phone.wander / np.sqrt(2)
    ideal = np.concatenate([w @ np.linalg.inv(phone.scale).T + b for w, b in zip(rates, walk, strict=True)])
    force = np.concatenate(up) * G
    sd, force_sd = phone.density * np.sqrt(phone.rate_hz), phone.force_density * np.sqrt(phone.rate_hz)
    raw = ideal + phone.bias + force @ phone.sensitivity.T + rng.normal(size=ideal.shape) * sd
    measured = force + rng.normal(size=force.shape) * force_sd
    gyro = Samples.checked(Sensor.GYROSCOPE, np.arange(len(raw)) / phone.rate_hz, raw)
    edges = np.cumsum([0, *(len(w) for w in rates)])
    rests = []
    for first, last in zip(edges[0::2], edges[1::2], strict=True):
        span, n = slice(first, last), last - first
        rests.append(
            RestState(
                t_start=float(gyro.t[first]),
                t_end=float(gyro.t[last - 1]),
                n=int(n),
                specific_force=measured[span].mean(axis=0),
                force_sd=np.full(3, force_sd),
                force_uncertainty=np.full(3, force_sd / np.sqrt(n)),
                level=force_sd,
                rate=raw[span].mean(axis=0),
                rate_sd=np.full(3, sd),
                rate_uncertainty=np.full(3, sd / np.sqrt(n)),
            )
        )
    cut = [cut_rotation_segment(a, b, gyro) for a, b in pairwise(rests)]
    return Recording(phone, rests, [turn for turn in cut if isinstance(turn, RotationSegment)])


def recording(seed: int, n: int = 20, **changes: object) -> Recording:
    rng = np.random.default_rng(seed)
    return recorded(rng, some_phone(rng, **changes), n)


def later(trip: Recording, by: float) -> Recording:
    """Move a recording on by some seconds, so that it can follow another: rests are told apart by time."""

    def moved(rest: RestState) -> RestState:
        return structs.replace(rest, t_start=rest.t_start + by, t_end=rest.t_end + by)

    turns = [replace(u, before=moved(u.before), after=moved(u.after), t=u.t + by) for u in trip.turns]
    return replace(trip, rests=[moved(rest) for rest in trip.rests], turns=turns)
