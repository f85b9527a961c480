"""Lines in the spectra of two recordings: which are one vibration, and what one lacks of the other's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.comparison.direct import partner
from stillcal.calib_core.diagnosis.comparison.stated import Sole
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.line import (
    COMES_AND_GOES,
    WANDERS,
    is_line,
    middle_hz,
    reach_hz,
)
from stillcal.calib_core.diagnosis.noise.lines.line_put_in import (
    CLOCKS,
    as_shown,
    every_line,
    may_have,
    same_line,
    would_show,
)
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import SHORT, AtRest
from stillcal.calib_core.diagnosis.noise.lines.steady_period import DRIVER as PERIOD
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.stream import of_one_vibration

STEADIER = 0.25
"""Part of another line's wandering, over the same time, that a line which is stated as steady may have."""


def unlike(one: Finding, other: Finding) -> bool:
    """Whether one of two lines, of one vibration, is steady where the other one comes and goes or wanders."""
    return _come_and_go_apart(one, other) or _wander_apart(one, other)


def _wander_apart(one: Finding, other: Finding) -> bool:
    """Whether the frequency of one of two lines wanders so far that the other, which is steady, does not.

    A frequency that goes its way at random goes as far as the root of the time.
    """
    if one.where.driver != WANDERS:
        one, other = other, one
    if one.where.driver != WANDERS or other.effect == "unknown":
        return False
    lengths = [f.where.t_end - f.where.t_start for f in (one, other)]
    as_long = float(np.sqrt(min(lengths[1] / max(lengths[0], 1e-9), 1.0)))
    return STEADIER * 2.0 * reach_hz(one) * as_long > 1.0 / SHORT


def _come_and_go_apart(one: Finding, other: Finding) -> bool:
    """Whether a vibration comes and goes in one of two recordings, and is there for more of the other."""
    if one.effect == other.effect:
        return False
    shares = [np.ravel(f.parameters["fraction"].ci95) for f in (one, other)]
    (low, high), (least, most) = shares
    return bool(high < least or most < low)


def beside_steady(one: Finding, other: Finding, names: Sequence[str], of_recording: bool) -> Sole:
    """Say of the one of two vibrations that comes and goes, or wanders, that the other recording's is steady.

    of_recording: whether the first is the recording's. Returned is also whose the unsteady one is.
    """
    if one.effect != "unknown":
        one, other, of_recording = other, one, not of_recording
    also = f"In {names[int(of_recording)]} the vibration at {middle_hz(other):.4g} Hz is steady instead."
    return replace(one, remark=" ".join(filter(None, (one.remark, also)))), of_recording


def with_lines_heard(
    sides: tuple[list[Finding], list[Finding]], exams: tuple[Examination, Examination]
) -> tuple[list[Finding], list[Finding]]:
    """Return what both state, also the gyroscope's lines that are told with the accelerometer's of both.

    A vibration that both recordings have may shake the gyroscope in one of them alone. One of the two may
    have it from what the device lay on, and not state it.
    """

    def told_with(exam: Examination, own: list[Finding], stated: list[Finding], other: int) -> list[Finding]:
        others = [*stated, *(line for s in exams[other].streams for line in s.passing)]
        felt = [f for f in own if f.sensor == "accel" and is_line(f) and partner(f, own, others)]
        known = [f.where for f in own if f.sensor == "gyro"]
        lines = [line for s in exam.streams if s.sensor == "gyro" for line in s.lines]
        heard = [line for line in lines if line.where not in known]
        return [line for line in heard if any(of_one_vibration(line, f) for f in felt)]

    one, other = sides
    return [*one, *told_with(exams[0], one, other, 1)], [*other, *told_with(exams[1], other, one, 0)]


class LinesOf:
    """The lines that a recording has, stated or not; those that are not stated are looked for when needed."""

    def __init__(self, exam: Examination) -> None:
        self._streams = {s.sensor: s for s in exam.streams}
        self._period = sample_period(exam.accelerometer.t)
        self._every: dict[str, list[Finding]] = {}
        self._hidden: dict[str, list[Finding]] = {}

    def _of(self, sensor: str) -> list[Finding]:
        if sensor not in self._every:
            stream = self._streams.get(sensor)
            self._every[sensor] = [] if stream is None else every_line(stream.calm, sensor, stream.lines)
        return self._every[sensor]

    def has_passing(self, line: Finding) -> bool:
        """Whether its sensor has a line that is not stated because it is of what the device lay on."""
        stream = self._streams.get(line.sensor)
        return is_line(line) and stream is not None and bool(stream.passing)

    def unstated(self, finding: Finding, own: Sequence[Finding], others: Sequence[Finding]) -> Finding | None:
        """Return a line like one of another recording that is not among those stated; None without one.

        The other sensor's line may stand for it, or others be surer. own: what that recording states;
        others: what this one does.
        """
        if not is_line(finding):
            return None
        stated = [o.where for o in others if o.sensor == finding.sensor]
        return partner(finding, own, [f for f in self._of(finding.sensor) if f.where not in stated])

    def why_not_steady(self, line: Finding) -> str | None:
        """Say why these rests may seem to have a steady line where it comes and goes as another one does."""
        if line.where.driver != COMES_AND_GOES:
            return None
        (seen,) = as_shown(self._streams[line.sensor].calm, line.sensor, [line], self._of(line.sensor))
        spells = seen is not None and seen.where.driver == COMES_AND_GOES
        return None if spells else "its rests would not show that a vibration comes and goes"

    def why_none(
        self, finding: Finding, own: Sequence[Finding], others: Sequence[Finding], exam: Examination
    ) -> str | None:
        """Say why this may have a line of another recording all the same; None where it has not.

        exam: of that recording; the others are those of `unstated`.
        """
        sensor = finding.sensor
        if not (is_line(finding) or finding.where.driver == PERIOD) or sensor not in self._streams:
            return None
        rate = 1.0 / max(self._period, sample_period(exam.accelerometer.t))
        if finding.where.driver == PERIOD:
            return next(
                (_may_be_same("vibration", line) for line in self._of(sensor) if _near(finding, line)), None
            )
        for line in self._of(sensor):
            pair = middle_hz(finding), middle_hz(line)
            if same_line(*pair, rate, max(reach_hz(finding), reach_hz(line))):
                return _may_be_same("vibration", line) + (", folded back" if max(pair) > rate / 2.0 else "")
        period = self._streams[sensor].period
        if period is not None and _near(finding, period):
            return _may_be_same("steady period", period)
        if sensor not in self._hidden:
            lines = [f for f in own if f.sensor == sensor and is_line(f)]
            absent = [f for f in lines if not (partner(f, own, others) or self.unstated(f, own, others))]
            calm = self._streams[sensor].calm
            shown = would_show(calm, sensor, absent, self._of(sensor))
            rests = AtRest.of(calm, sensor).brief if any(shown) else None
            self._hidden[sensor] = [
                f for f, seen in zip(absent, shown, strict=True) if not seen or may_have(rests, f)
            ]
        return not_as_large("rests") if any(finding is f for f in self._hidden[sensor]) else None


def _near(one: Finding, other: Finding) -> bool:
    """Whether a vibration and a steady period are one, which is near 4 Hz and told as either."""
    pair = middle_hz(one), middle_hz(other)
    return abs(pair[0] - pair[1]) < CLOCKS * max(pair)


def _may_be_same(what: str, line: Finding) -> str:
    """Say that what another recording has may be a line, as it is called here."""
    return f"its {what} at {middle_hz(line):.4g} Hz may be the same one"


def not_as_large(where: str) -> str:
    """Say that what another recording has may be hidden: in its rests, or in its turns."""
    return f"its {where} would not show one of this size"
