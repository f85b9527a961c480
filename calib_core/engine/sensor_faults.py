"""Sensors that stop, stick or tell something else than they should, as the detector's counts show it."""

from __future__ import annotations

from collections.abc import Mapping

from stillcal.calib_core.static.settings import Label, Ledger
from stillcal.calib_core.streams.samples import Sensor

LEAST_S = 60.0
"""s of windows that must have been looked at for anything to be said of a sensor."""

_SHARE = 0.5
"""Share of the windows that must have the same fault."""

_OF_WINDOWS = {
    Label.FROZEN: "it shows one value again and again",
    Label.IMPLAUSIBLE: "its readings at rest are not of gravity's size: check its unit and its range",
}
NO_SAMPLES = "it sends no samples, although the other sensor does"
NONE_OF_USE = "it sends no samples, too few of them, or one value again and again"


def failure(sensor: Sensor, fault: str) -> str:
    """Return what is said of a sensor that has failed."""
    return f"the {sensor} fails: {fault}"


def sensor_faults(
    then: Ledger, now: Ledger, has_gyroscope: bool, silent: bool, before: Mapping[Sensor, str]
) -> dict[Sensor, str]:
    """Return what is wrong with each sensor by the windows looked at between two moments.

    has_gyroscope: whether one has ever sent samples. silent: whether the accelerometer sends none. before:
    what was wrong by then, which stays where too little was looked at.
    """
    if silent:
        return {**before, Sensor.ACCELEROMETER: NO_SAMPLES}
    if now.accel_on_s - then.accel_on_s < LEAST_S:
        return dict(before)
    counts = {label: n - then.windows.get(label, 0) for label, n in now.windows.items()}
    found = {}
    for label, words in _OF_WINDOWS.items():
        if counts.get(label, 0) > _SHARE * sum(counts.values()):
            found[Sensor.ACCELEROMETER] = words
    if has_gyroscope and now.gyro_on_s == then.gyro_on_s:
        found[Sensor.GYROSCOPE] = NONE_OF_USE
    return found
