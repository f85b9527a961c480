"""Messages of ROS 2 for inertial sensors, as bytes: sensor_msgs/Imu and sensor_msgs/Temperature in CDR.

Little-endian CDR (OMG DDSI-RTPS) aligns doubles to 8 bytes after its own four, for which the frame's name of
four fits. A quantity that a message does not have is said to be absent by a covariance that begins with -1
(sensor_msgs/Imu.msg); a covariance or variance of zero says that it is unknown.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array

_FRAME = b"imu\0"
_HEAD = [("encapsulation", "S4"), ("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4"), ("frame", "S4")]
_CDR_LITTLE_ENDIAN = b"\0\1\0\0"

_IMU_LAYOUT = np.dtype([*_HEAD, ("doubles", "<f8", 37)])
_TEMPERATURE_LAYOUT = np.dtype([*_HEAD, ("doubles", "<f8", 2)])
_RATE, _FORCE = 13, 25
LATEST_S = float(1 << 31)
"""Stamps from here on do not fit into a message's seconds, nor do negative ones."""

IMU, TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"

_COMMON = """\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMU_SCHEMA = f"""\
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{_COMMON}\
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
TEMPERATURE_SCHEMA = f"std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n{_COMMON}"


def nanoseconds(t: Array) -> Any:
    """Return times, s, as whole ns."""
    return np.rint(t * 1e9).astype(np.int64)


def _headed(t: Array, layout: Any) -> Any:
    """Return messages (n,) with their headers filled in. t: (n,) s."""
    messages = np.zeros(len(t), dtype=layout)
    stamps = nanoseconds(t)
    messages["encapsulation"] = _CDR_LITTLE_ENDIAN
    messages["sec"], messages["nanosec"] = stamps // 10**9, stamps % 10**9
    messages["length"], messages["frame"] = len(_FRAME), _FRAME
    return messages


def imu(t: Array, force: Array, rate: Array) -> Any:
    """Return sensor_msgs/Imu (n,), as CDR. t: (n,) s. force, rate: (n, 3) m/s^2, rad/s, NaN where absent."""
    messages = _headed(t, _IMU_LAYOUT)
    doubles = messages["doubles"]
    doubles[:, 3], doubles[:, 4] = 1.0, -1.0  # no orientation
    for first, values in ((_RATE, rate), (_FORCE, force)):
        there = np.asarray(np.isfinite(values).all(axis=1))
        doubles[:, first : first + 3] = np.where(there[:, None], values, 0.0)
        doubles[:, first + 3] = np.where(there, 0.0, -1.0)
    return messages


def temperatures(t: Array, celsius: Array) -> Any:
    """Return sensor_msgs/Temperature (n,), as CDR. t: (n,) s. celsius: (n,) degC."""
    messages = _headed(t, _TEMPERATURE_LAYOUT)
    messages["doubles"][:, 0] = celsius
    return messages
