"""Real devices' measured errors, and activity carried through them.

A device is what its six faces say of it (replay/studies/methods/device_faces.py), with its own noise at rest.
Nobody's walk was recorded by these devices: what is made here from other recordings is semi-synthetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.model import SensorModel
from stillcal.replay.formats.hhar_still import read
from stillcal.replay.phone import Phone, draw_rests
from stillcal.replay.phone.settings import Noise, SensorSettings
from stillcal.replay.studies.har.recordings import FOLDER, REFERENCE, Still, by_device, read_still
from stillcal.replay.studies.methods.device_faces import calibrate_devices

RESTS = 12
"""Of which a device is calibrated: between the two days of the paper (11 and 13 states, 4.2)."""

FLICKER = 5e-4
"""m/s^2: bias instability that a device's rests are drawn with, the middle of replay/phone's population."""

CARRIED = (
    "ucihar carried through the measured errors and noise of {} real devices of hhar_still (semi-synthetic)"
)


@dataclass(frozen=True, eq=False)
class Device:
    """One device: raw = forward @ true + bias, m/s^2, and its recordings at rest."""

    name: str
    model: str
    forward: Array
    bias: Array
    rests: tuple[Still, ...]

    @cached_property
    def rate_hz(self) -> float:
        """Samples a second, over all its recordings."""
        return sum(len(r.creation) - 1 for r in self.rests) / sum(float(r.creation[-1]) for r in self.rests)

    def distort(self, accel: Array) -> Array:
        """Return true forces (..., 3) as the device has them, without noise."""
        return accel @ self.forward.T + self.bias

    def noise(self, n: int, length: int, rng: np.random.Generator) -> Array:
        """Return n stretches of its own noise at rest, (n, length, 3), in the order it came in."""
        rest = max(self.rests, key=lambda r: len(r.accel))
        residual = rest.accel - rest.accel.mean(axis=0)
        start = rng.integers(0, len(residual) - length, n)
        return np.asarray(residual[start[:, None] + np.arange(length)])

    def carry(self, accel: Array, rng: np.random.Generator) -> Array:
        """Return what the device makes of true forces (n, length, 3), its noise included."""
        return self.distort(accel) + self.noise(accel.shape[0], accel.shape[1], rng)

    def calibrated(self, seed: int) -> SensorModel:
        """Return what the product's fit makes of `RESTS` rests of this device, drawn in random attitudes."""
        rests = draw_rests(self._phone(), RESTS, seed)
        return accelerometer.fit(rests.forces, rests.white_uncertainties, rests.gravity).model

    def _phone(self) -> Phone:
        sd = float(np.mean([r.accel.std(axis=0).mean() for r in self.rests]))
        rows = tuple(tuple(float(v) for v in row) for row in self.forward)
        bias = tuple(float(v) for v in self.bias)
        sensor = SensorSettings(
            rate_hz=self.rate_hz,
            bias=bias,  # type: ignore[arg-type]  # three numbers
            scale=rows,  # type: ignore[arg-type]  # three rows of three
            noise=Noise(white=sd * float(np.sqrt(2.0 / self.rate_hz)), flicker=FLICKER),
        )
        return Phone(accel=sensor, gyro=None)


def read_devices(data: Path) -> list[Device]:
    """Read every device whose six faces calibrate it, the reference unit left out."""
    rests = by_device([r for r in read_still(data) if not r.frozen])
    found = []
    for outcome in calibrate_devices(read(data / FOLDER), STANDARD):
        about, fit = outcome.recordings, outcome.calibration
        if fit is None or about.model == REFERENCE:
            continue
        name = f"{about.model} {about.device}"
        own = tuple(rests[name])
        forward = np.asarray(np.linalg.inv(fit.model.scale), dtype=np.float64)
        found.append(Device(name, about.model, forward, fit.model.bias, own))
    return found
