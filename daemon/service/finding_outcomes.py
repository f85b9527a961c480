"""What became of each finding of the self-diagnosis, in words: for the log, the socket and the terminal."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from stillcal.calib_core.calibration.corrections.catalogue import ADOPT, ADOPTABLE
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.trial import TESTED
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.service.engine_actions import REMEDY
from stillcal.daemon.service.engine_thread import View
from stillcal.daemon.store.document import StoreDocument
from stillcal.daemon.system.plain_words import duration

Handled = Literal["corrected", "on_trial", "reported"]

_SENSORS = {"accel": Sensor.ACCELEROMETER, "gyro": Sensor.GYROSCOPE}
"""Sensors by their names in a diagnosis."""

_LEARNT = ("_bias_temperature", BY_CHARGING)
"""Ends of the names of effects that are learnt at every check (calibration/bias_curve)."""

_ANEW = "no need, the bias is measured anew at every check"
_WHY_NOT = {
    "_bias_temperature": "taken up at an hourly check once it predicts later rests better, nothing to do",
    BY_CHARGING: "taken up at an hourly check once it predicts later rests better and no thermometer does",
    "_drift": _ANEW,
    "_step": _ANEW,
    "_warmup": "the daemon does not know when its sensors were switched on; let the phone warm up",
}
"""Why effects are only reported, by the end of their names."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a finding. words: the same for people, with the reason and what they can do."""

    handled: Handled
    words: str

    @property
    def sentence(self) -> str:
        """The words as a sentence."""
        return f"{self.words[:1].upper()}{self.words[1:]}."


def outcome(finding: Mapping[str, Any], view: View, document: StoreDocument, now: float | None) -> Outcome:
    """Return what became of a finding by `now` (s). view: of the engine; document: the store's contents."""
    effect, record = str(finding["effect"]), view.record
    sensor = _SENSORS.get(finding["sensor"])
    if record is not None and _corrects(record, effect, sensor):
        since = _corrected_since([record, *_replaced(document)], effect, sensor)
        return Outcome("corrected", f"corrected{_for(since, now)} by the calibration, nothing to do")
    if effect in view.on_trial:
        tested = _for(view.on_trial[effect], now)
        then = "taken up by a coming self-diagnosis if it predicts them better, nothing to do"
        return Outcome("on_trial", f"not corrected yet: tested on later rests{tested}, and {then}")
    alike = [a["effect"] for a in finding.get("alternatives", ()) if a.get("indistinguishable")]
    return Outcome("reported", f"not corrected: {_why_not(effect, alike, view)}")


def _why_not(effect: str, alike: Collection[str], view: View) -> str:
    """Return why a finding is only reported, and what a user can do. alike: what looks the same."""
    if effect.endswith(_LEARNT) and not view.learns_temperature:
        return "learn_temperature is false in the settings; set it to true to have it learnt"
    if effect in TESTED and alike:
        return f"these rests do not tell it from {' or '.join(alike)}; to decide, {REMEDY}"
    if effect in TESTED:
        return "that takes a full calibration with the gyroscope first; let the phone lie in more attitudes"
    otherwise = f"a calibration has no term for it; to know more, {REMEDY}"
    if effect in ADOPTABLE:
        otherwise = f"{ADOPT} takes it up from a diagnosis; for that, {REMEDY}"
    return next((why for end, why in _WHY_NOT.items() if effect.endswith(end)), otherwise)


def _corrects(record: CalibrationRecord, effect: str, sensor: Sensor | None) -> bool:
    return any(term.effect == effect and term.sensor == sensor for term in record.terms)


def _replaced(document: StoreDocument) -> Sequence[CalibrationRecord]:
    """Return the calibrations that were in use before, newest first."""
    return [entry.calibration for entry in reversed(document.history) if entry.what == "replaced"]


def _corrected_since(
    records: Sequence[CalibrationRecord], effect: str, sensor: Sensor | None
) -> float | None:
    """Return since when calibrations (newest first) have had a term without a break, s; None if unknown."""
    with_it = [_corrects(record, effect, sensor) for record in records]
    first = records[with_it.index(False) - 1 if False in with_it else -1]
    bias_at = None if first.gyroscope is None else first.gyroscope.zeroed_at
    return bias_at if sensor is Sensor.GYROSCOPE and bias_at is not None else first.fitted_at


def _for(since: float | None, now: float | None) -> str:
    """Return for how long something has been so, for use within a sentence."""
    if since is None or now is None or now < since:
        return ""
    return f" for {duration(now - since)}" if now - since >= 1.0 else " from now on"
