"""Random phones with the spread of errors of 36 real devices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.replay.phone.noise import seeded
from stillcal.replay.phone.phone import Claims, Phone
from stillcal.replay.phone.settings import (
    ClockSettings,
    HeatSettings,
    Matrix,
    Noise,
    SensorSettings,
    Vector,
)

G = 9.81
"""The standard against which Stisen et al. took deviations, m/s^2."""


@dataclass(frozen=True, slots=True)
class Model:
    """A device model: how many were measured, its accelerometer's rate in Hz, whether it has a gyroscope."""

    device: str
    count: int
    rate_hz: float
    gyro: bool = True


MODELS = (
    Model("LG G watch", 2, 200.0),
    Model("Samsung Galaxy Gear watch", 2, 100.0),
    Model("Apple iPhone 6", 2, 100.0),
    Model("Samsung Galaxy Pocket+", 1, 100.0),
    Model("Samsung Galaxy S3 mini", 3, 100.0),
    Model("LG Nexus 4", 11, 200.0),
    Model("Samsung Galaxy S3", 3, 150.0),
    Model("Samsung Galaxy Nexus", 2, 125.0),
    Model("Samsung Galaxy S+", 4, 50.0),
    Model("LG Optimus 2X", 1, 100.0),
    Model("HTC Desire", 3, 50.0, gyro=False),
    Model("HTC Nexus One", 3, 25.0, gyro=False),
    Model("Samsung Galaxy Tab 10.1", 1, 100.0),
)
"""Stisen et al. 2015, Table 1 (both rows of the S3 mini together). Which have a gyroscope is not in it."""

FACE_RANGE = (-0.085, 0.075)
"""Deviation of a face's reading from g that no measured device exceeded (Stisen et al. 2015, 3.1)."""

BIAS_SD, SCALE_MEAN, SCALE_SD = 0.43, -0.005, 0.010
"""Spread of bias in m/s^2 and scale error before devices beyond FACE_RANGE are drawn anew.

Of the paper: near Gaussian, mean reading 9.76 m/s^2, mean absolute deviation 0.35 m/s^2, so a standard
deviation of 0.35 sqrt(pi / 2) = 0.44 m/s^2 = hypot(0.43, 0.010 g). Scale is what opposite faces share; in
the recordings published with the paper it varies by 0.9 %. Keeping to FACE_RANGE as well brings the mean
absolute deviation down to 0.3 m/s^2: the paper's three figures do not fit one Gaussian.
"""


def _vector(values: np.ndarray) -> Vector:
    x, y, z = (float(v) for v in values)
    return (x, y, z)


def _matrix(values: np.ndarray) -> Matrix:
    x, y, z = (_vector(row) for row in values)
    return (x, y, z)


def face_deviations(bias: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return by how much of g the reading of each of the six faces departs from 1 g; shape (6,)."""
    up = np.diag(scale) - 1.0 + bias / G
    down = np.diag(scale) - 1.0 - bias / G
    return np.concatenate([up, down])


def _drawn_affine(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    while True:
        bias = BIAS_SD * rng.standard_normal(3)
        scale = np.eye(3) + np.diag(SCALE_MEAN + SCALE_SD * rng.standard_normal(3))
        deviations = face_deviations(bias, scale)
        if deviations.min() >= FACE_RANGE[0] and deviations.max() <= FACE_RANGE[1]:
            return bias, scale + 0.005 * rng.standard_normal((3, 3)) * (1.0 - np.eye(3))


def _drawn_accel(rate: float, rng: np.random.Generator) -> SensorSettings:
    bias, scale = _drawn_affine(rng)
    bits = int(rng.choice([10, 12, 14, 16]))
    noise = Noise(
        white=float(np.exp(rng.uniform(*np.log([1e-3, 5e-3])))), flicker=float(rng.uniform(2e-4, 8e-4))
    )
    return SensorSettings(
        rate_hz=rate,
        bias=_vector(bias),
        scale=_matrix(scale),
        lsb=4.0 * G / 2**bits,
        range=4.0 * G,
        noise=noise,
    )


def _drawn_gyro(rate: float, rng: np.random.Generator) -> SensorSettings:
    white, flicker = np.radians(rng.uniform(0.004, 0.02)), np.radians(rng.uniform(0.002, 0.01))
    return SensorSettings(
        rate_hz=rate,
        bias=_vector(np.radians(1.0) * rng.standard_normal(3)),
        scale=_matrix(np.eye(3) + 0.01 * rng.standard_normal((3, 3))),
        lsb=float(np.radians(2000.0) / 2**15),
        range=float(np.radians(2000.0)),
        noise=Noise(white=float(white), flicker=float(flicker)),
    )


def _drawn_phone(rng: np.random.Generator) -> Phone:
    counts = np.array([m.count for m in MODELS], dtype=float)
    model = MODELS[int(rng.choice(len(MODELS), p=counts / counts.sum()))]
    rate = model.rate_hz * float(rng.normal(1.0, 0.01))
    clock = ClockSettings(
        skew=float(rng.normal(0.0, 2e-5)),
        jitter_s=float(rng.uniform(0.005, 0.05)) / rate,
        latency_s=float(rng.uniform(0.001, 0.02)),
        latency_jitter_s=float(rng.uniform(0.0005, 0.01)),
        burst_fraction=float(rng.uniform(0.0, 0.1)),
    )
    return Phone(
        description=f"A drawn {model.device}",
        accel=_drawn_accel(rate, rng),
        gyro=_drawn_gyro(rate, rng) if model.gyro else None,
        clock=clock,
        heat=HeatSettings(thermometer=False),
        claims=Claims(device=model.device, nominal_rate_hz=model.rate_hz),
    )


def population(n: int, seed: int = 0) -> list[Phone]:
    """Draw n phones: models as common as in Stisen et al. 2015, Table 1, each with errors of its own.

    From the paper: rates, the spread of readings on the six faces. Assumed within what parts of those years
    state: noise, resolution, cross-axis 0.5 %, gyroscopes, clocks. Phone i depends on seed and i alone.
    """
    return [_drawn_phone(seeded(seed, "population", i)) for i in range(n)]
