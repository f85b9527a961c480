"""What is measured on: a day of a simulated phone whose truth is known, made once and kept in out/."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.phone import Phone, load_scenario, simulate
from stillcal.replay.phone.settings import Noise, SensorSettings

FOLDER = Path("out/benchmarks")
G = 9.80665
MILLI_G = G / 1000
FORWARD = np.array([[1.01, 0.004, -0.004], [-0.004, 0.99, 0.004], [-0.004, -0.004, 1.01]])
BIAS = MILLI_G * np.array([40.0, -30.0, 20.0])
RATE_HZ = 50.0
LOCAL_G = 9.81264
"""At 52.2 degrees north, where the day is lived."""


@dataclass(frozen=True, slots=True)
class Day:
    """A day's samples of both sensors, 50 Hz."""

    accelerometer: Samples
    gyroscope: Samples


def phone() -> Phone:
    """Return the phone of the issue: 40, 30, 20 mg of bias, 1 % of scale, 0.4 % of cross-axis sensitivity."""
    x, y, z = (float(b) for b in BIAS)
    rows = [tuple(float(v) for v in row) for row in FORWARD]
    accel = SensorSettings(
        rate_hz=RATE_HZ,
        bias=(x, y, z),
        scale=(rows[0], rows[1], rows[2]),  # type: ignore[arg-type]
        noise=Noise(white=150e-6 * G, flicker=20e-6 * G),
        lsb=4 * G / 32768,
        range=4 * G,
    )
    gyro = SensorSettings(
        rate_hz=RATE_HZ, bias=(0.01, -0.02, 0.005), noise=Noise(white=1e-4, flicker=1e-5), lsb=1e-3
    )
    return Phone(accel=accel, gyro=gyro)


def day() -> Day:
    """Return the day, from its file where it has been made before."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    file = FOLDER / "day.npz"
    if not file.exists():
        whole = simulate(load_scenario("day"), phone(), 0).whole()
        assert whole.gyroscope is not None
        a, g = whole.accelerometer, whole.gyroscope
        np.savez(file, t=a.t, accel=a.xyz, t_gyro=g.t, gyro=g.xyz)
    kept = np.load(file)
    return Day(
        Samples(Sensor.ACCELEROMETER, frozen(kept["t"]), frozen(kept["accel"])),
        Samples(Sensor.GYROSCOPE, frozen(kept["t_gyro"]), frozen(kept["gyro"])),
    )


def flat_file() -> Path:
    """Return a file of the day's accelerometer, t x y z by sample, to be read piece by piece."""
    file = FOLDER / "day.f8"
    if not file.exists():
        accel = day().accelerometer
        np.column_stack((accel.t, accel.xyz)).tofile(file)
    return file


def error_mg(model: SensorModel) -> float:
    """Return the mean vector error over 2000 attitudes in mg, the rotation common to all taken out."""
    up = np.random.default_rng(0).normal(size=(2000, 3))
    true = G * up / np.linalg.norm(up, axis=1, keepdims=True)
    u, _, v = np.linalg.svd(model.scale @ FORWARD)
    corrected = model.apply(true @ FORWARD.T + BIAS) @ (u @ v)
    return float(np.linalg.norm(corrected - true, axis=1).mean() / MILLI_G)
