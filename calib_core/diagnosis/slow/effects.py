"""The catalogue of effects: one small object each, gathered here."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import Entry
from stillcal.calib_core.diagnosis.slow import effects_bias as bias
from stillcal.calib_core.diagnosis.slow import effects_force as force
from stillcal.calib_core.diagnosis.slow import unnamed as generic


def slow_entries(sensor: str, without: Collection[str] = ()) -> list[Entry]:
    """Return every entry that is judged on the still bins of one sensor, "accel" or "gyro".

    Whatever drives a named effect may drive a nameless one, so the generic bank has every driver too. Where
    both compete the name is preferred, so the nameless twin enters only for effects in `without`.
    """
    own = force.accelerometer_entries() if sensor == "accel" else force.gyroscope_entries()
    named = [nameless(e) if e.effect in without else e for e in (*bias.entries(sensor), *own)]
    return [*named, *generic.entries(sensor)]


def nameless(entry: Entry) -> Entry:
    """Return an entry as one of the generic bank: the same driver, and no word of physics."""
    return replace(
        entry,
        effect="unknown",
        sentence=generic.SAY + entry.follows + ".",
        kin=None,
        handicap=max(entry.handicap, thresholds.UNKNOWN_HANDICAP),
    )
