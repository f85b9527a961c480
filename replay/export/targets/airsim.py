"""AirSim's settings.json: the noise of its IMU.

microsoft/AirSim, AirLib/include/sensors/imu/ImuSimpleParams.hpp: AngularRandomWalk in deg/sqrt(h),
VelocityRandomWalk in mg/sqrt(Hz), GyroBiasStability in deg/h, AccelBiasStability in ug, the two Tau in s.
ImuSimple.hpp: one sample has the standard deviation of the random walk's density times sqrt(rate), and the
bias walks by stability / sqrt(Tau) per sqrt(s). The bias at the start is zero and no setting changes it.
There is one number for all axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.maths.rms import rms
from stillcal.daemon.store.document import pretty
from stillcal.replay.export.imu import ImuParameters
from stillcal.replay.export.target import Target, one_number

DEG_PER_HOUR = float(np.deg2rad(1.0) / 3600.0)
DEG_PER_ROOT_HOUR = float(np.deg2rad(1.0) / 60.0)
MILLI_G, MICRO_G = STANDARD / 1e3, STANDARD / 1e6

KEYS = {
    "gyroscope": ("AngularRandomWalk", DEG_PER_ROOT_HOUR, "GyroBiasStability", DEG_PER_HOUR, 500.0),
    "accelerometer": ("VelocityRandomWalk", MILLI_G, "AccelBiasStability", MICRO_G, 800.0),
}
"""White noise and its unit in SI, stability and its unit, and AirSim's own Tau in s, which is kept."""

TAUS = {"gyroscope": "GyroBiasStabilityTau", "accelerometer": "AccelBiasStabilityTau"}


class AirSim(Target):
    """A settings file with one vehicle; its Imu is to be copied into the user's own."""

    name = "airsim"
    title = "AirSim"
    source = "microsoft/AirSim ImuSimpleParams.hpp, ImuSimple.hpp"
    invertible = False
    needs_noise = True

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return noise."""
        return imu.named("white noise", "slow noise")

    def notes(self, imu: ImuParameters) -> list[str]:
        """Return what one number for three axes leaves out."""
        return one_number(imu)

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return JSON; the remarks are its member `Comment`, which AirSim does not read."""
        sensor: dict[str, Any] = {"SensorType": 2, "Enabled": True}
        for name, part in imu.parts():
            if part.noise is not None:
                white, white_unit, *_ = KEYS[name]
                sensor[white] = rms(part.noise.two_sided) / white_unit
                sensor |= stability(name, rms(part.noise.walk_alike()))
        vehicle = {"VehicleType": "SimpleFlight", "Sensors": {"Imu": sensor}}
        out = {"Comment": list(remarks), "SettingsVersion": 1.2, "SimMode": "Multirotor"}
        return (pretty(out | {"Vehicles": {"Drone1": vehicle}}) + "\n").encode()


def stability(name: str, walk: float, tau: float | None = None) -> dict[str, float]:
    """Return the settings of a bias that walks by `walk`, SI unit per sqrt(s)."""
    _, _, key, unit, own = KEYS[name]
    tau = own if tau is None else tau
    return {TAUS[name]: tau, key: walk * float(np.sqrt(tau)) / unit}
