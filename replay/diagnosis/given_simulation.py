"""`stillcal diagnose REC --simulated SIM`: where SIM differs from REC, by what physics, by how much.

Other motion and another length do not matter, and another rate is one finding: both are fitted by one model.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.axes import Exchange, exchange_of
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.coverage.assumed_drivers import columns_over, course_over
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import OF_DENSITY
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.vibrations import IN_MOTION
from stillcal.calib_core.diagnosis.comparison.quantity import posterior
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy
from stillcal.calib_core.diagnosis.comparison.stated import sole_discrepancy
from stillcal.calib_core.diagnosis.effects.followed import driver_of, follows_temperature
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.line import TONE
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.stream import Stream
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.answer import Fit, answer_of, findings_stated
from stillcal.replay.diagnosis.condense import LongRecording
from stillcal.replay.diagnosis.corrected import Corrected, correct, span_of, with_echoes
from stillcal.replay.diagnosis.judged import Judged, ShowStage, examined, refuse_short, silent
from stillcal.replay.formats.trace import Recording

Correct = Callable[[Comparison, dict[str, Any]], Corrected]
"""Puts what was found into a simulation: the comparison and its answer in plain values are given."""

ON_VALUES = (*OF_DENSITY, "saturation", "quantisation", "held_samples", "bandwidth", "time_offset")
"""Effects, by the end of their names, that change a sensor's noise at rest, its single values or its time."""

OF_SAMPLES = (TONE, "lever_arm")
"""What single samples show, and not how they are rounded."""


def judge_simulation(recording: Recording, simulation: Recording, show_stage: ShowStage = silent) -> Judged:
    """Compare a recording with a simulation's. Raises NotSupported where either has too little data."""
    refuse_short(recording, simulation)
    recorded = examined(recording, show_stage)
    simulated = examined(simulation, show_stage)
    for own, other, of_recording in ((recorded, simulated, True), (simulated, recorded, False)):
        exchange = exchange_of(own, other)
        which = recording if of_recording else simulation
        if exchange is None or isinstance(which, LongRecording):
            continue
        assert own.other_axes is not None, "it has an exchange"
        right = put_right(which, exchange)
        again = examined(right, show_stage, name=f"{right.name} with its axes put right")
        both = (right, again, simulation, simulated) if of_recording else (recording, recorded, right, again)
        judged = judge_examined(*both, show_stage=show_stage)
        return with_exchange(judged, exchange, own.other_axes, of_recording=of_recording)
    return judge_examined(recording, recorded, simulation, simulated, show_stage=show_stage)


def put_right(recording: Recording, exchange: Exchange) -> Recording:
    """Return a recording of which the exchanged axes are put right."""

    def right(samples: Samples, sensor: str) -> Samples:
        matrix = exchange.matrices.get(sensor)
        return samples if matrix is None else replace(samples, xyz=frozen(samples.xyz @ matrix.T))

    accel, gyro = recording.accelerometer, recording.gyroscope
    return replace(
        recording,
        accelerometer=right(accel, "accel"),
        gyroscope=None if gyro is None else right(gyro, "gyro"),
    )


def with_exchange(judged: Judged, exchange: Exchange, shown: Finding, *, of_recording: bool) -> Judged:
    """Return what was judged with axes put right, and their exchange as findings beside it.

    shown: the exchange as turns show it.
    """
    assert judged.simulated is not None, "of a given simulation"
    nats = shown.evidence.log_bayes_factor
    probability = posterior(nats, max(judged.before.comparisons, 1))
    said = f"{exchange.said} All else was compared with these axes put right."
    found = [
        replace(sole_discrepancy((finding, of_recording), probability), put_right=said)
        for finding in exchange.findings(shown)
    ]
    before = Comparison(discrepancies=found, evidence=[(shown.effect, nats)]).and_of(judged.before)
    not_put_in = judged.answer["fit"]["not_put_in"]
    fit = Fit.of(before, judged.after or judged.before, not_put_in)
    names = judged.answer["recording"], judged.answer["simulation"]
    answer = answered(before, fit, judged.recorded, judged.simulated, names)
    return replace(judged, before=before, answer=answer)


def judge_examined(
    recording: Recording,
    recorded: Examination,
    simulation: Recording,
    simulated: Examination,
    again: Correct | None = None,
    *,
    show_stage: ShowStage = silent,
) -> Judged:
    """Compare a recording with a simulation's, both with their examinations.

    again: plays the simulation, a phone, anew with what was found; None where it is put into the samples.
    """
    names, played = (recording.name, simulation.name), again is not None
    show_stage("comparing", 0.0)
    before = compare(recorded, simulated, names, played=played)
    answer = answered(before, None, recorded, simulated, names)
    if not before.discrepancies:
        return Judged(recording, recorded, simulated, before, None, None, answer)
    simulation = _driven(simulation, recording, recorded.bins, before)
    made = _added(recording, simulation, before) if again is None else again(before, answer)
    measured = examined(
        made.recording,
        show_stage,
        name=f"{simulation.name} with the differences put in",
        within=recorded.bins if played else None,
    )
    if again is None:
        measured = with_own_values(measured, simulated, of_other_values(before.discrepancies, made))
    after = compare(recorded, measured, names, played=played)
    answer = answered(before, Fit.of(before, after, made.left_out), recorded, simulated, names)
    return Judged(recording, recorded, simulated, before, after, made.recording, answer)


def answered(
    before: Comparison,
    fit: Fit | None,
    recorded: Examination,
    simulated: Examination,
    names: tuple[str, str],
) -> dict[str, Any]:
    """Return the answer in plain values. fit: with what was found put in; None where nothing was."""
    stated = findings_stated([s.finding for s in recorded.statements], "recorded")
    stated |= findings_stated([s.finding for s in simulated.statements], "simulated")
    return answer_of(before, names, fit or Fit.of(before, before), stated, recorded.bins.temperature)


def _added(recording: Recording, simulation: Recording, before: Comparison) -> Corrected:
    """Return the simulation with the differences put in, its biases known as they were measured."""
    biases = {
        d.simulated.sensor: d.simulated.value
        for d in before.compared
        if d.simulated.effect in ("accel_bias", "gyro_bias")
    }
    found = with_echoes(simulation, before.discrepancies, before.compared)
    return correct(simulation, found, biases, span=span_of(recording.accelerometer))


def _driven(simulation: Recording, recording: Recording, bins: Bins, before: Comparison) -> Recording:
    """Return a simulation with what was assumed to drive effects in it, stretched to it.

    bins: the recording's, whose temperature it is.
    """
    drivers = {d.where.driver for d in before.discrepancies if d.note}
    if any(map(follows_temperature, drivers)):
        simulation = _warmed(simulation, bins)
    assumed = {n: c for n, c in recording.covariates.items() if driver_of(n) in drivers}
    if not assumed:
        return simulation
    columns = columns_over(assumed, bins.span, span_of(simulation.accelerometer))
    return replace(simulation, covariates={**simulation.covariates, **columns})


def _warmed(simulation: Recording, recorded: Bins) -> Recording:
    """Return a simulation with the temperature of a recording's bins, stretched to it."""
    samples = simulation.accelerometer
    course = course_over(recorded, span_of(samples))
    warm = replace(simulation, accelerometer=replace(samples, temperature=frozen(course.at(samples.t))))
    if isinstance(warm, LongRecording) and warm.overview is not None:
        t = warm.overview.force.t
        overview = replace(warm.overview, thermometer=np.column_stack([t, course.at(t)]))
        return replace(warm, overview=overview)
    return warm


def of_other_values(discrepancies: Sequence[Discrepancy], made: Corrected) -> set[str]:
    """Return the sensors whose noise or single values were changed on purpose.

    A low-pass that motion shows, and noise does not, has the noise behind it.
    """
    put_in = (d for d in discrepancies if d.effect not in made.left_out and d.where.driver != IN_MOTION)
    return {d.sensor for d in put_in if d.effect.endswith(ON_VALUES)}


def with_own_values(measured: Examination, simulated: Examination, changed: Collection[str]) -> Examination:
    """Return what was measured of a corrected simulation, single values and stamps as the simulation's own.

    What is added is slow, but it takes the values off the steps that they came in: the noise of rounding
    would then count as the sensor's, and a value that repeats the one before would not any more. changed:
    sensors whose noise or single values were changed on purpose.
    """
    own = {s.sensor: s for s in simulated.streams if s.sensor not in changed}

    def anew(one: Stated) -> bool:
        found = one.finding
        return one.hypothesis is not None or found.sensor in changed or found.effect in OF_SAMPLES

    return replace(
        measured,
        streams=[_with_lines_of(own.get(s.sensor, s), s) for s in measured.streams],
        statements=[
            *(s for s in simulated.statements if not anew(s)),
            *(s for s in measured.statements if anew(s)),
        ],
    )


def _with_lines_of(stream: Stream, measured: Stream) -> Stream:
    """Return a sensor's stream with the vibrations of another one, those that were put in among them."""
    return replace(stream, lines=measured.lines, calm=measured.calm)
