"""Covariances for ROS 2's sensor_msgs/Imu, as parameters for whatever node publishes the message.

ros2/common_interfaces, sensor_msgs/msg/Imu.msg: row major 3x3 covariances about x, y, z of angular velocity,
(rad/s)^2, and linear acceleration, (m/s^2)^2; -1 as the first number of a covariance says that the message
has no such estimate. They are those of one sample: white noise at the sample rate.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.replay.export.imu import ImuParameters
from stillcal.replay.export.target import Target, commented

FIELDS = {"gyroscope": "angular_velocity_covariance", "accelerometer": "linear_acceleration_covariance"}


class Ros2(Target):
    """A parameter file for all nodes (/**)."""

    name = "ros2"
    title = "ROS 2 sensor_msgs/Imu"
    source = "ros2/common_interfaces Imu.msg"
    invertible = False
    needs_noise = True

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return white noise."""
        return imu.named("white noise")

    def notes(self, imu: ImuParameters) -> list[str]:
        """Return what the numbers hold for."""
        return [f"these hold for samples at {imu.rate_hz:g} Hz; they grow in proportion to the rate"]

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return YAML."""
        text = commented(remarks) + "/**:\n  ros__parameters:\n    orientation_covariance: "
        text += _list([-1.0, *[0.0] * 8])
        parts = dict(imu.parts())
        for name, field in FIELDS.items():
            noise = parts[name].noise if name in parts else None
            if noise is not None:
                text += f"    {field}: {_list(np.diag(noise.sample_sd**2).ravel().tolist())}"
        return text.encode()


def _list(values: list[float]) -> str:
    return f"[{', '.join(_number(v) for v in values)}]\n"


def _number(value: float) -> str:
    """Return a number with a point, which YAML 1.1 wants before an exponent."""
    text = repr(value)
    return text if "e" not in text or "." in text else text.replace("e", ".0e")
