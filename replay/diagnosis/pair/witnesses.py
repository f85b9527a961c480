"""Other sensors on the same body (`--witness`): what the recording reads less what they read is judged.

How they are turned and what their clocks say is found from the motion that they share, and undone before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Readings
from stillcal.calib_core.diagnosis.comparison.pair.clocks import MOST_LATE
from stillcal.calib_core.diagnosis.comparison.pair.compare import (
    compare_in_pair,
    without_equation,
    without_found,
)
from stillcal.calib_core.diagnosis.comparison.pair.mounting import SHARED, Mounting, mounting
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.comparison.pair.search import examined_in_pair
from stillcal.calib_core.diagnosis.comparison.pair.vote import voted
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95, Measured
from stillcal.calib_core.errors import NotSupported, UserError
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.answer import Fit, answer_of
from stillcal.replay.diagnosis.judged import Judged, ShowStage, charging_events, examined, silent
from stillcal.replay.diagnosis.pair.owners import owners_of, tell_owners
from stillcal.replay.diagnosis.pair.paired import AGAIN, READINGS
from stillcal.replay.diagnosis.pair.readings import less, mean_readings, readings_of, refuse_itself
from stillcal.replay.diagnosis.words.names import BUILT_IN
from stillcal.replay.diagnosis.words.units import plain
from stillcal.replay.formats.trace import Recording

MISMATCH = 0.01
"""Part of what shakes a body by which the means of two sensors on it differ: they rectify differently, and
are not quite at one place and one time. A simulation at the same stamps is."""

THERE = 0.5
"""Part of the recording that a witness must have been there for."""


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """Another sensor's recording, with its turn and its clock taken off, and what these were."""

    recording: Recording
    mounting: Mounting

    def plain(self) -> dict[str, Any]:
        """Return what was taken off in plain values, with a sentence."""
        found, degree = self.mounting, np.degrees(1.0)
        angle, late, rate = found.angle, found.delay, found.rate
        return {
            "recording": self.recording.name,
            "mounting": {
                "angle": _parameter(angle, float(degree), "deg"),
                "rotation": found.rotation.tolist(),
            },
            "clock": {"delay": _parameter(late, 1.0, "s"), "rate": _parameter(rate, 1.0, "1")},
            "shared_motion": found.shared,
            "note": f"{self.recording.name} is turned by {_text(angle, float(degree), 'deg')} against the"
            f" recording, its stamps are late by {_text(late, 1e3, 'ms')} in the middle and its clock is fast"
            f" by {_text(rate, 1e6, 'ppm')}; this is taken off.",
        }


def _parameter(one: Measured, factor: float, unit: str) -> dict[str, Any]:
    value, half = one.value * factor, NORMAL_95 * one.error * factor
    return {"value": value, "ci95": [value - half, value + half], "unit": unit}


def _text(one: Measured, factor: float, unit: str) -> str:
    return f"{plain(one.value * factor, NORMAL_95 * one.error * factor)} {unit}"


def judge_with_witnesses(
    recording: Recording, witnesses: Sequence[Recording], show_stage: ShowStage = silent
) -> Judged:
    """Judge a recording against the built-in simulation, slow effects by what other sensors read beside it.

    How a witness is mounted, what its clock says, and its own bias and scale, do not matter. Of several the
    mean is taken, and they vote whose an effect is. Raises UserError where they were not there at the same
    time or not on the same body, NotSupported on too little data.
    """
    refuse_itself(recording, witnesses)
    _while_there(recording, witnesses)
    beside = [_aligned(recording, one) for one in witnesses]
    others = [one.recording for one in beside]
    recording = _while_there(recording, others)
    recorded = examined(recording, show_stage, sought=())
    show_stage(READINGS, 0.0)
    true = mean_readings(recording, others)
    bins, sensors = pair_residuals(less(recording, true), true, charging_events(recording), MISMATCH)
    stated = recorded.statements
    exam = examined_in_pair(recorded, bins, sensors, stated, lambda done: show_stage(READINGS, done))
    found = compare_in_pair(exam)
    owned = owners_of(exam, found, stated, [recording, *others], partial(_differing, recording, others))
    before = voted(found, [(one.discrepancy, one.own) for one in owned])
    fit = Fit.of(before, before)
    if before.discrepancies:
        show_stage(AGAIN, 0.0)
        fit = Fit.of(before, without_found(exam, found, stated), without_equation(before))
    answer = answer_of(before, (recording.name, BUILT_IN), fit, {}, exam.bins.temperature)
    tell_owners(answer, before, owned)
    told = [one.plain() for one in beside]
    for k, one in enumerate(told, start=1):
        one["findings"] = [each.of_witness() for each in owned if each.owner == k]
    answer["witnesses"] = told
    return Judged(recording, exam, None, before, None, None, answer)


def _differing(recording: Recording, others: Sequence[Recording], k: int) -> list[SensorResiduals]:
    """Return residuals of one recording less the mean of the rest; k: 0 for the recording, then the others.

    All are cut at the recording's stamps, and have its temperature.
    """
    every = [readings_of(recording), *(mean_readings(recording, [one]) for one in others)]
    rest = [one for i, one in enumerate(every) if i != k]
    rates = [one.rate for one in rest if one.rate is not None]
    true = Readings(_mean([one.force for one in rest]), _mean(rates) if rates else None)
    own = replace(recording, accelerometer=every[k].force, gyroscope=every[k].rate)
    warm = recording.accelerometer.temperature
    own = replace(own, accelerometer=replace(own.accelerometer, temperature=warm))
    return pair_residuals(less(own, true), true, charging_events(recording), MISMATCH)[1]


def _mean(every: Sequence[Samples]) -> Samples:
    return replace(every[0], xyz=frozen(np.mean([one.xyz for one in every], axis=0)))


def _aligned(recording: Recording, witness: Recording) -> Witness:
    """Return a witness in the recording's axes and on its clock.

    Raises UserError where it is not shown to be on the same body, NotSupported where the motion does not
    tell how it is turned.
    """
    read = readings_of(witness)
    found = mounting(readings_of(recording), read)
    if found is None:
        raise NotSupported(
            f"the body hardly moves, so it is not shown that {witness.name} was on it",
            ("a recording in which the body is turned; or leave --witness out",),
        )
    if not found.one_body:
        raise UserError(
            f"{witness.name}: was not on the same body as {recording.name}, or its stamps are off by more"
            f" than {MOST_LATE:.0f} s: it shares {max(found.shared, 0.0):.0%} of the motion, and at least"
            f" {SHARED:.0%} is needed; give a sensor that was on the same body, or leave --witness out"
        )
    if not found.is_known:
        raise NotSupported(
            f"how {witness.name} is mounted is not shown, because the body turns about one axis only",
            ("turns about another axis",),
        )
    back = found.undone(read)
    return Witness(replace(witness, accelerometer=back.force, gyroscope=back.rate), found)


def _while_there(recording: Recording, witnesses: Sequence[Recording]) -> Recording:
    """Cut a recording to when all witnesses were there. Raises UserError where that is too little of it."""
    t = recording.accelerometer.t
    streams = [s for w in witnesses for s in _streams(w)]
    start, end = max(float(s.t[0]) for s in streams), min(float(s.t[-1]) for s in streams)
    if min(end, t[-1]) - max(start, t[0]) < THERE * (t[-1] - t[0]):
        spans = "; ".join(map(_spans, witnesses))
        raise UserError(
            f"{spans}; {recording.name} from {t[0]:.6g} to {t[-1]:.6g} s; both sensors of every witness must"
            " have been there at the same time, for at least half of the recording"
        )

    def cut(samples: Samples | None) -> Samples | None:
        return None if samples is None else samples[_inside(samples.t, start, end)]

    accelerometer = cut(recording.accelerometer)
    assert accelerometer is not None, "half of it is left"
    return replace(recording, accelerometer=accelerometer, gyroscope=cut(recording.gyroscope))


def _streams(recording: Recording) -> list[Samples]:
    return [s for s in (recording.accelerometer, recording.gyroscope) if s is not None]


def _spans(recording: Recording) -> str:
    spans = [f"the {s.sensor} from {s.t[0]:.6g} to {s.t[-1]:.6g} s" for s in _streams(recording)]
    return f"{recording.name}: recorded {' and '.join(spans)}"


def _inside(t: Array, start: float, end: float) -> slice:
    return slice(int(np.searchsorted(t, start)), int(np.searchsorted(t, end, side="right")))
