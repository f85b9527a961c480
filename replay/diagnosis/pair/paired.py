"""A simulation of the recording's own motion (`--paired`): what one reads less the other is judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.axes import exchange_of
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import slow_effects
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import LOW_PASS
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Alignment, KnownBefore, align
from stillcal.calib_core.diagnosis.comparison.pair.compare import (
    compare_in_pair,
    without_equation,
    without_found,
)
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.compare_samples import (
    FoundAlready,
    compare_samples,
)
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.vibrations import IN_MOTION
from stillcal.calib_core.diagnosis.comparison.pair.search import examined_in_pair
from stillcal.calib_core.diagnosis.comparison.pair.stands import (
    with_own_of_simulation,
    with_owner_of_unknown,
)
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.noise.lines.line import TONE, middle_hz
from stillcal.replay.diagnosis.answer import Fit, answer_of, findings_stated
from stillcal.replay.diagnosis.corrected import correct, with_echoes
from stillcal.replay.diagnosis.given_simulation import (
    of_other_values,
    put_right,
    with_exchange,
    with_own_values,
)
from stillcal.replay.diagnosis.judged import (
    Judged,
    ShowStage,
    charging_events,
    examined,
    refuse_short,
    silent,
)
from stillcal.replay.diagnosis.pair.as_both import as_both, without_held_rows
from stillcal.replay.diagnosis.pair.readings import (
    less,
    nearer,
    readings_of,
    refuse_itself,
    refuse_other_motion,
    refuse_other_stamps,
    refuse_shifted,
)
from stillcal.replay.formats.trace import Recording

READINGS = "comparing the readings of one motion"
AGAIN = "comparing again, without what was found"


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """A recording and a simulation of its motion, each examined by itself.

    values: what single samples and the noise at rest of the two differ by.
    """

    recording: Recording
    simulation: Recording
    exams: tuple[Examination, Examination]
    values: Comparison

    @classmethod
    def of(cls, recording: Recording, simulation: Recording, show_stage: ShowStage) -> _Pair:
        """Examine both."""
        exams = examined(recording, show_stage, sought=()), examined(simulation, show_stage, sought=())
        show_stage(READINGS, 0.0)
        values = _values_of(exams, (recording.name, simulation.name))
        return cls(recording, simulation, exams, values)

    @property
    def names(self) -> tuple[str, str]:
        """What the two are called."""
        return self.recording.name, self.simulation.name

    def known(self, unsure: float) -> KnownBefore:
        """Return what is known before their motion is compared. unsure: s, what low-passes delay."""
        still = self.exams[1].bins.rate
        at_rest = None if still is None or not len(still) else np.median(still, axis=0)
        return KnownBefore(unsure, at_rest, rounding(self.exams), noise_at_rest(self.exams[1]))


def judge_paired(recording: Recording, simulation: Recording, show_stage: ShowStage = silent) -> Judged:
    """Judge a recording less a simulation of the same motion at the same stamps.

    Values and noise at rest are those of either, and compared as such. Raises UserError where stamps or the
    motion differ, NotSupported on too little data.
    """
    refuse_itself(recording, [simulation], simulated=True)
    refuse_other_stamps(recording, simulation)
    refuse_short(recording, simulation)
    refuse_other_motion(recording, simulation)
    pair = _Pair.of(recording, simulation, show_stage)
    for of_recording in (True, False):
        own, other = pair.exams if of_recording else pair.exams[::-1]
        exchange = exchange_of(own, other)
        if exchange is None:
            continue
        assert own.other_axes is not None, "it has an exchange"
        wrong, true = (recording, simulation) if of_recording else (simulation, recording)
        right = put_right(wrong, exchange)
        if not nearer(right, wrong, true):  # the other sensor's axes are wrong
            continue
        both = (right, simulation) if of_recording else (recording, right)
        judged = _judged(_Pair.of(*both, show_stage), show_stage)
        return with_exchange(judged, exchange, own.other_axes, of_recording=of_recording)
    return _judged(pair, show_stage)


def _judged(pair: _Pair, show_stage: ShowStage) -> Judged:
    """Judge a pair that is told in the same axes."""
    recording, simulation = pair.recording, pair.simulation
    recorded, simulated = pair.exams
    low_passes = [d.difference for d in pair.values.discrepancies if d.difference and d.effect == LOW_PASS]
    both = as_both((recording, simulation), pair.exams, low_passes)
    own, other = both.recording, both.simulation
    refuse_shifted(own, other)
    known = pair.known(both.late)
    motion = align(readings_of(own), readings_of(other), known)
    true = motion.readings
    apart, charging = less(own, true), charging_events(recording)
    bins, sensors = pair_residuals(
        apart, true, charging, 0.0, motion.added, rounding=known.rounding, unsure=both.left
    )
    exam = examined_in_pair(recorded, bins, sensors, motion.found, lambda done: show_stage(READINGS, done))
    slow = with_own_of_simulation(compare_in_pair(exam, motion), exam, pair.exams, pair.names)
    slow = with_owner_of_unknown(slow, exam, recorded, simulated)
    before = slow.and_of(pair.values)
    after, left_out = None, list[str]()
    if before.discrepancies:
        show_stage(AGAIN, 0.0)
        after, left_out = _corrected(pair, exam, slow, known, motion)
    fit = Fit.of(before, after or before, left_out)
    stated = findings_stated([s.finding for s in recorded.statements], "recorded")
    stated |= findings_stated([s.finding for s in simulated.statements], "simulated")
    answer = answer_of(before, pair.names, fit, stated, exam.bins.temperature)
    return Judged(recording, exam, simulated, before, after, None, answer)


def _corrected(
    pair: _Pair, exam: Examination, slow: Comparison, known: KnownBefore, motion: Alignment
) -> tuple[Comparison, list[str]]:
    """Return how the corrected simulation compares, and the effects that could not be put into it.

    exam: of the difference of readings, in which `slow` was found, and `motion` of what moves.
    """
    recorded, simulated = pair.exams
    moved = {(s.finding.effect, s.finding.sensor) for s in motion.found}
    in_motion = [d for d in slow.discrepancies if (d.effect, d.sensor) in moved]
    # Vibrations that motion shows are taken off the difference: nobody knows their phase. What an equation
    # puts in at high frequency is rough: only low-passes that were there before are sought again.
    of_motion = [d for d in pair.values.discrepancies if d.where.driver == IN_MOTION]
    lines = [d for d in of_motion if d.effect == TONE]
    filtered = {d.sensor for d in of_motion if d.effect == LOW_PASS}
    others = [d for d in pair.values.discrepancies if all(d is not one for one in lines)]
    played = [*with_echoes(pair.simulation, others, pair.values.compared), *in_motion]
    made = correct(pair.simulation, played, {})
    own, other = without_held_rows(pair.recording, made.recording)
    left = align(readings_of(own), readings_of(other), known)
    after = without_found(exam, slow, left.found, left)
    measured = examined(made.recording, silent, sought=())
    measured = with_own_values(measured, simulated, of_other_values(played, made))
    values = _values_of((recorded, measured), pair.names, FoundAlready(_frequencies(lines), filtered))
    after = after.and_of(values)
    out = [effect for effect in without_equation(slow) if effect not in {d.effect for d in in_motion}]
    return after, [*out, *made.left_out]


def _values_of(
    exams: tuple[Examination, Examination], names: tuple[str, str], known: FoundAlready | None = None
) -> Comparison:
    """Compare what samples show, beside the slow effects that are looked for."""
    return compare_samples(exams, names, len(list(slow_effects(exams[0]))), known)


def _frequencies(lines: Sequence[Discrepancy]) -> dict[str, list[float]]:
    """Return the frequencies, Hz, of vibrations by sensor."""
    out: dict[str, list[float]] = {}
    for own, sensor in ((d.recorded or d.simulated, d.sensor) for d in lines):
        assert own is not None, "one of the two alone has it"
        out.setdefault(sensor, []).append(middle_hz(own))
    return out


def rounding(exams: Sequence[Examination]) -> dict[str, Array]:
    """Return, by sensor, the sd (3,) that coarse steps of two recordings leave in a mean difference."""
    out: dict[str, Array] = {}
    for stream in (s for exam in exams for s in exam.streams):
        out[stream.sensor] = np.hypot(out.get(stream.sensor, np.zeros(3)), stream.steps.left_in_mean())
    return out


def noise_at_rest(exam: Examination) -> dict[str, Array]:
    """Return, by sensor, the variance (3,) of what a recording reads at rest; none where nothing is."""
    pieces = {s.sensor: s.still.pieces for s in exam.streams if s.still.pieces}
    return {sensor: np.mean([p.var(axis=0) for p in own], axis=0) for sensor, own in pieces.items()}
