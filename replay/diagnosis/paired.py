"""A simulation of the recording's own motion (`--paired`): what one reads less the other is judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import slow_effects
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import LOW_PASS
from stillcal.calib_core.diagnosis.comparison.of_samples import compare_samples
from stillcal.calib_core.diagnosis.comparison.pair.alignment import KnownBefore, Readings, align
from stillcal.calib_core.diagnosis.comparison.pair.compare import (
    compare_in_pair,
    without_equation,
    without_found,
)
from stillcal.calib_core.diagnosis.comparison.pair.delay import SURE, late
from stillcal.calib_core.diagnosis.comparison.pair.mounting import SHARED, shared_as_it_is
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.comparison.pair.search import examined_in_pair
from stillcal.calib_core.diagnosis.comparison.pair.stands import (
    with_own_of_simulation,
    with_owner_of_unknown,
)
from stillcal.calib_core.diagnosis.comparison.quantity import Quantity
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.direct.repeated_values import held_rows
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import NAME
from stillcal.calib_core.diagnosis.motion.group_delay import UNSURE
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.resample import read_at, temperature_at
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.answer import Fit, answer_of, findings_stated
from stillcal.replay.diagnosis.corrected import correct
from stillcal.replay.diagnosis.given_simulation import of_other_values, with_own_values
from stillcal.replay.diagnosis.judged import (
    Judged,
    ShowStage,
    charging_events,
    examined,
    refuse_short,
    silent,
)
from stillcal.replay.diagnosis.sample_changes import clipped, held_at, low_passed
from stillcal.replay.formats.trace import Recording

SAME_STAMP = 0.1
"""Part of the sample period by which two stamps of one moment may differ: rounding, and no more."""

NYQUIST = 0.49
"""Part of the sample rate above which no filter has a cutoff."""

SHIFTED = 0.02
"""s by which both sensors may be late alike: the narrowest filter of a phone's sensor delays by 19 ms
(MPU-6050, 5 Hz). More is a matter of stamps."""

READINGS = "comparing the readings of one motion"
AGAIN = "comparing again, without what was found"


def judge_paired(recording: Recording, simulation: Recording, show_stage: ShowStage = silent) -> Judged:
    """Judge a recording less a simulation of the same motion at the same stamps.

    Values and noise at rest are those of either, and compared as such. Raises UserError where stamps or the
    motion differ, NotSupported on too little data.
    """
    refuse_itself(recording, [simulation])
    _refuse_other_stamps(recording, simulation)
    refuse_short(recording, simulation)
    _refuse_other_motion(recording, simulation)
    recorded = examined(recording, show_stage, sought=())
    simulated = examined(simulation, show_stage, sought=())
    exams, names = (recorded, simulated), (recording.name, simulation.name)
    show_stage(READINGS, 0.0)
    beside = len(list(slow_effects(recorded)))
    values = compare_samples(exams, names, beside)
    own, other, unsure = _alike(recording, simulation, exams, values)
    _refuse_shifted(own, other)
    still = simulated.bins.rate
    at_rest = None if still is None or not len(still) else np.median(still, axis=0)
    steps = rounding(exams)
    known = KnownBefore(unsure, at_rest, steps)
    motion = align(readings_of(own), mean_readings(own, [other]), known)
    true = motion.readings
    apart, charging = less(own, true), charging_events(recording)
    bins, sensors = pair_residuals(apart, true, charging, 0.0, motion.added, rounding=steps)
    exam = examined_in_pair(recorded, bins, sensors, motion.found, lambda done: show_stage(READINGS, done))
    slow = with_own_of_simulation(compare_in_pair(exam, motion), exam, simulated)
    slow = with_owner_of_unknown(slow, exam, recorded, simulated)
    before = slow.and_of(values)
    fit = Fit.of(before, before)
    if before.discrepancies:
        show_stage(AGAIN, 0.0)
        moved = {(s.finding.effect, s.finding.sensor) for s in motion.found}
        in_motion = [d for d in slow.discrepancies if (d.effect, d.sensor) in moved]
        played = [*values.discrepancies, *in_motion]
        made = correct(simulation, played, {})
        own, other = _held(recording, made.recording)
        left = align(readings_of(own), mean_readings(own, [other]), known)
        after = without_found(exam, slow, left.found, left)
        measured = examined(made.recording, silent, sought=())
        measured = with_own_values(measured, simulated, of_other_values(played, made))
        after = after.and_of(compare_samples((recorded, measured), names, beside))
        out = [effect for effect in without_equation(slow) if effect not in {d.effect for d in in_motion}]
        fit = Fit.of(before, after, [*out, *made.left_out])
    stated = findings_stated([s.finding for s in recorded.statements], "recorded")
    stated |= findings_stated([s.finding for s in simulated.statements], "simulated")
    answer = answer_of(before, names, fit, stated, exam.bins.temperature)
    return Judged(recording, exam, simulated, before, None, None, answer)


def rounding(exams: Sequence[Examination]) -> dict[str, Array]:
    """Return, by sensor, the sd (3,) that coarse steps of two recordings leave in a mean difference."""
    out: dict[str, Array] = {}
    for stream in (s for exam in exams for s in exam.streams):
        out[stream.sensor] = np.hypot(out.get(stream.sensor, np.zeros(3)), stream.steps.left_in_mean())
    return out


def _alike(
    recording: Recording, simulation: Recording, exams: Sequence[Examination], values: Comparison
) -> tuple[Recording, Recording, float]:
    """Return both with limits, low-passes and held samples of both, so that the rest can be judged.

    values: has the low-passes that differ. The third is the standard error, s, of what these delay.
    """
    limits = _limits(exams)
    filters = [d.difference for d in values.discrepancies if d.difference and d.effect == LOW_PASS]
    own = _filtered(_limited(recording, limits), [d.simulated for d in filters])
    other = _filtered(_limited(simulation, limits), [d.recorded for d in filters])
    low_passes = [q for d in filters for q in (d.recorded, d.simulated) if not q.none]
    own, other = _held(own, other)
    rate = 1.0 / sample_period(recording.accelerometer.t)
    return own, other, max((unsure_delay(one, rate) for one in low_passes), default=0.0)


def unsure_delay(low_pass: Quantity, rate: float) -> float:
    """Return the standard error, s, of what a low-pass delays, played at a rate, Hz.

    A digital filter near half the rate delays by less than the analogue one of its cutoff, and the recording
    may be behind either.
    """
    cutoff, order = float(np.exp(low_pass.value[0])), int(low_pass.reference["order"])
    analogue = 1.0 / (2.0 * np.pi * cutoff)
    digital = 1.0 / (2.0 * rate * np.tan(np.pi * min(cutoff / rate, NYQUIST)))
    apart = (analogue - digital) / np.sin(np.pi / (2 * order))
    return float(np.hypot(UNSURE * analogue, apart / np.sqrt(2.0)))


def _filtered(recording: Recording, low_passes: Sequence[Quantity]) -> Recording:
    """Return a recording behind the low-passes of the other, so that both sides are behind all of them."""
    for one in low_passes:
        if not one.none:
            recording = _changed(recording, one.sensor, partial(low_passed, found=one))
    return recording


def _changed(recording: Recording, sensor: str, change: Callable[[Samples], Samples]) -> Recording:
    """Return a recording with the samples of one sensor changed, where it has that sensor."""
    if sensor == "accel":
        return replace(recording, accelerometer=change(recording.accelerometer))
    gyroscope = recording.gyroscope
    return recording if gyroscope is None else replace(recording, gyroscope=change(gyroscope))


def _limits(exams: Sequence[Examination]) -> dict[str, float]:
    """Return by sensor the lowest value at which one of the two saturates."""
    limits: dict[str, float] = {}
    for one in (s.finding for exam in exams for s in exam.statements):
        if one.effect.endswith("_saturation"):
            here = float(np.min(one.parameters["limit"].value))
            limits[one.sensor] = min(here, limits.get(one.sensor, np.inf))
    return limits


def _limited(recording: Recording, limits: Mapping[str, float]) -> Recording:
    """Return a recording that saturates where one of the two does: beyond it their readings say nothing."""
    for sensor, limit in limits.items():
        recording = _changed(recording, sensor, partial(clipped, limit=limit))
    return recording


def _held(recording: Recording, simulation: Recording) -> tuple[Recording, Recording]:
    """Return both with the samples held that either holds: such a one reads the motion of a moment before."""
    for sensor, own, other in _shared_streams(recording, simulation):
        again = held_rows(own) | held_rows(other)
        recording, simulation = (
            _changed(one, sensor, partial(held_at, again=again)) for one in (recording, simulation)
        )
    return recording, simulation


def refuse_itself(recording: Recording, others: Sequence[Recording]) -> None:
    """Raise UserError where another recording holds the same samples: nothing is left between them."""
    own = recording.accelerometer.xyz
    for other in others:
        if np.array_equal(other.accelerometer.xyz, own):
            raise UserError(
                f"{other.name}: holds the very samples of {recording.name}; give what another sensor, or a"
                " simulation, reads of the same motion"
            )


def _refuse_other_stamps(recording: Recording, simulation: Recording) -> None:
    """Raise UserError where two recordings are not of the same moments, naming the first that differs."""
    for sensor, own, other in _shared_streams(recording, simulation):
        n = min(len(own), len(other))
        apart = np.abs(own.t[:n] - other.t[:n]) > SAME_STAMP * float(np.median(np.diff(own.t)))
        if apart.any():
            i = int(np.argmax(apart))
            why = f"sample {i + 1} of the {NAME[sensor]} is stamped {other.t[i]:.6g} s, not {own.t[i]:.6g} s"
        elif len(own) != len(other):
            why = f"it has {len(other)} samples of the {NAME[sensor]}, not {len(own)}"
        else:
            continue
        raise UserError(
            f"{simulation.name}: {why} as in {recording.name}; --paired needs the same motion at the same"
            " stamps, leave it out for any other motion"
        )


def _refuse_other_motion(recording: Recording, simulation: Recording) -> None:
    """Raise UserError where a simulation moves otherwise, by the rule for a witness on another body."""
    shared = shared_as_it_is(readings_of(recording), readings_of(simulation))
    if shared is not None and shared < SHARED:
        raise UserError(
            f"{simulation.name}: is of another motion than {recording.name}, late against it or in other"
            f" axes: it shares {max(shared, 0.0):.0%} of the motion, and at least {SHARED:.0%} is needed;"
            " leave --paired out for any other motion"
        )


def _refuse_shifted(recording: Recording, simulation: Recording) -> None:
    """Raise UserError where a simulation reads the motion by more earlier or later than filters delay.

    Low-passes that were found are on both: what these delay is not counted.
    """
    own, other = readings_of(recording), readings_of(simulation)
    found = [late(own.force, other.force, "accel")]
    if own.rate is not None and other.rate is not None:
        found.append(late(own.rate, other.rate, "gyro"))
    delays = [one.delay for one in found if one is not None]
    alike = len(delays) == len(found) and abs(sum(np.sign(d.value) for d in delays)) == len(delays)
    if not alike or min(abs(d.value) - SURE * d.error for d in delays) < SHIFTED:
        return
    shift = float(np.mean([d.value for d in delays]))
    side = "earlier" if shift > 0.0 else "later"
    raise UserError(
        f"{simulation.name}: reads the motion {abs(shift) * 1e3:.0f} ms {side}"
        f" than {recording.name}; move its stamps by {shift * 1e3:+.0f} ms and interpolate it at those of"
        f" {recording.name}, or leave --paired out"
    )


def _shared_streams(recording: Recording, simulation: Recording) -> list[tuple[str, Samples, Samples]]:
    """Return the name of each sensor that both have, and its samples in both."""
    both = {
        "accel": (recording.accelerometer, simulation.accelerometer),
        "gyro": (recording.gyroscope, simulation.gyroscope),
    }
    return [(s, own, other) for s, (own, other) in both.items() if own is not None and other is not None]


def readings_of(recording: Recording) -> Readings:
    """Return what a recording's two sensors read."""
    return Readings(recording.accelerometer, recording.gyroscope)


def mean_readings(recording: Recording, others: Sequence[Recording]) -> Readings:
    """Return what the others read at the recording's stamps, on average."""
    force, rate = recording.accelerometer, recording.gyroscope
    rates = [o.gyroscope for o in others if o.gyroscope is not None]
    both = None if rate is None or not rates else _mean(rate, rates)
    return Readings(_mean(force, [o.accelerometer for o in others]), both)


def _mean(own: Samples, others: Sequence[Samples]) -> Samples:
    every = [read_at(o, own.t).xyz for o in others]
    return replace(own, xyz=frozen(np.mean(every, axis=0)))


def less(recording: Recording, true: Readings) -> Readings:
    """Return what the recording reads less what the others do, with the recording's own temperature."""
    force, rate = recording.accelerometer, recording.gyroscope
    warm = temperature_at(force, force.t)
    left = replace(
        force,
        xyz=frozen(force.xyz - true.force.xyz),
        temperature=None if warm is None else frozen(warm),
    )
    if rate is None or true.rate is None:
        return Readings(left, None)
    return Readings(left, replace(rate, xyz=frozen(rate.xyz - true.rate.xyz)))
