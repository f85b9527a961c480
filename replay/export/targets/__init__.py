"""All targets by name, each imported when it is asked for; one module a target."""

from __future__ import annotations

import importlib

from stillcal.replay.export.target import Target

TARGETS = {
    "kalibr": "kalibr:Kalibr",
    "px4": "px4:Px4",
    "ardupilot": "ardupilot:ArduPilot",
    "android": "android:Android",
    "gazebo": "gazebo:Gazebo",
    "airsim": "airsim:AirSim",
    "imusensor": "imusensor:ImuSensor",
    "ros2": "ros2:Ros2",
    "iio": "iio:Iio",
    "numpy": "numpy_file:Python",
    "npz": "numpy_file:Npz",
    "c": "c_header:CHeader",
}
"""Name to module and class within this package."""

INVERTIBLE = ("kalibr", "px4", "ardupilot", "android", "gazebo", "imusensor", "iio", "npz")
"""Targets whose files can be read back; a test holds this against the classes."""


def target_named(name: str) -> Target:
    """Return a target. Raises KeyError where there is none of this name."""
    module, attribute = TARGETS[name].split(":")
    made: Target = getattr(importlib.import_module(f"{__package__}.{module}"), attribute)()
    return made
