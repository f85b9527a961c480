"""The catalogue of effects: one small object each, gathered here."""

from __future__ import annotations

from stillcal.calib_core.misfit.catalogue import bias, force, generic
from stillcal.calib_core.misfit.catalogue.entry import Entry


def slow_entries(sensor: str) -> list[Entry]:
    """Return every entry that is judged on the still bins of one sensor, "accel" or "gyro"."""
    own = force.accelerometer_entries() if sensor == "accel" else force.gyroscope_entries()
    return [*bias.entries(sensor), *own, *generic.entries(sensor)]
