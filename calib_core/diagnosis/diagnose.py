"""The whole diagnosis of one recording: arrays in, findings out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.clear_bins import (
    limits_of,
    outside_of,
    roughened,
    still_bins,
    unlimited,
)
from stillcal.calib_core.diagnosis.direct import repeated_values as repeats
from stillcal.calib_core.diagnosis.direct.axis_exchange import garbled, other_axes, turns_between
from stillcal.calib_core.diagnosis.direct.dead_zone import dead_zone, hides_rest, is_zone
from stillcal.calib_core.diagnosis.direct.quantities import grid_of
from stillcal.calib_core.diagnosis.direct.stuck import dead, stuck
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Claims, Diagnosis, Finding, only_unknown
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned, Unsteady, aligned
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.model.sound_phones import SoundPhones, sound_phones
from stillcal.calib_core.diagnosis.motion.group_delay import FilterDelay
from stillcal.calib_core.diagnosis.motion.time_offset import Shown, shown_in_motion
from stillcal.calib_core.diagnosis.motion.turning_windows import RateNoise, Span
from stillcal.calib_core.diagnosis.motion.unseen_tilt import unseen_tilt
from stillcal.calib_core.diagnosis.noise.coloured_noise import is_end_of_wander
from stillcal.calib_core.diagnosis.noise.lines.line import WANDERS, middle_hz
from stillcal.calib_core.diagnosis.segments.noiseless import audible
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.static_bins import Bins, overview_of
from stillcal.calib_core.diagnosis.segments.turns import Rates
from stillcal.calib_core.diagnosis.sequence.findings import beside_names, sequence_findings
from stillcal.calib_core.diagnosis.sequence.stamps import judged
from stillcal.calib_core.diagnosis.slow.about_force import about_nonlinearity, searched
from stillcal.calib_core.diagnosis.slow.findings import slow_statements, turn_statements
from stillcal.calib_core.diagnosis.slow.relinearised import about_effects
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.taken_off import Known, OffRates, off_bins
from stillcal.calib_core.diagnosis.slow.turns.turn_errors import turn_errors
from stillcal.calib_core.diagnosis.slow.turns.turn_residuals import turn_residuals
from stillcal.calib_core.diagnosis.slow.turns.unsure_tilt import beyond, unsure_tilt
from stillcal.calib_core.diagnosis.slow.wander import NO_DRIVER, sizes_along_gravity
from stillcal.calib_core.diagnosis.stream import LEAST_SAMPLES, Stream, agreed, direct_findings, in_step
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.maths.sines import without_vibrations
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples
from stillcal.calib_core.streams.time_series import TimeSeries

__all__ = ["Claims", "Diagnosis", "diagnose"]

LEAST_SECONDS = 10.0
MEASURED, SEARCHED = 0.15, 0.9
"""Share of the work that is done once single samples are judged, and once slow effects are searched for; on
recordings of five minutes to two hours these took 5 to 17 % and 90 to 97 % of the time."""

OTHER_AXES = "the axes of one of its sensors are exchanged"
"""Why no delay and no lever arm are looked for: what the gyroscope turns gravity by is wrong then."""


def diagnose(
    accelerometer: Samples,
    gyroscope: Samples | None,
    events: Sequence[Charging] = (),
    claims: Claims | None = None,
    recording: str = "",
    *,
    without: Collection[str] = (),
    sound: SoundPhones | None = None,
) -> Diagnosis:
    """Find where a recording differs from a simulated ideal sensor, and what physics was left out.

    without: effects of which the catalogue knows nothing, to try what their cases are then called.
    sound: what sound phones commonly show, by default the populations that come with the package.
    Raises NotSupported where not even the stamps can be judged (fewer than 200 samples, less than 10 s).
    """
    return examine(accelerometer, gyroscope, events, claims, without=without, sound=sound).diagnosis(
        recording
    )


def examine(
    accelerometer: Samples,
    gyroscope: Samples | None,
    events: Sequence[Charging] = (),
    claims: Claims | None = None,
    *,
    without: Collection[str] = (),
    sound: SoundPhones | None = None,
    covariates: Mapping[str, TimeSeries] | None = None,
    sought: Sequence[Hypothesis] | None = None,
    of_turns: Sequence[Stated] = (),
    within: Bins | None = None,
    overview: Overview | None = None,
    delivered_twice: int = 0,
    progress: Callable[[float], None] = lambda _share: None,
) -> Examination:
    """Measure a recording and find its effects; parameters and errors are those of `diagnose`.

    covariates: further logged columns by name, which a bias may follow. sought: the slow effects of rests
    that may be there; None: all of them, those of turns and what has no name are searched for, which takes
    most of the time. A simulation that was made with known ones needs only to be measured; of_turns: those of
    the rate of turn, about which its turns are then measured. within: the rests of the recording whose motion
    it was made of, outside which none is taken: noise is there twice, the recorded and the simulated one.
    overview: every second of the recording, where the samples are only some of it; None where they are all.
    delivered_twice: samples that came twice and are here once. progress: is called with the share of the work
    that is done. A sensor without any noise is judged with that of a quiet one (`audible`).
    """
    refuse_too_little(accelerometer)
    claims, sound = claims or Claims(), sound or sound_phones()
    accelerometer, twice = repeats.without_doubles(accelerometer)
    gyroscope = None if gyroscope is None else repeats.without_doubles(gyroscope)[0]
    doubled = repeats.doubled(accelerometer, twice + delivered_twice, _seen_in_all(accelerometer, overview))
    seconds = overview or overview_of(accelerometer, gyroscope)
    as_read = {"accel": accelerometer, "gyro": gyroscope}
    accelerometer, gyroscope, seconds, silent = audible(accelerometer, gyroscope, seconds)
    # The noise that is put in hides the gap about the value that a sensor reads at rest.
    zones = [f for s, x in as_read.items() if s in silent and x is not None and (f := dead_zone(x, s))]
    bins = still_bins(accelerometer, gyroscope, events, seconds)
    bins = bins if within is None else bins.within(within)
    made = _of_samples(accelerometer, gyroscope, bins, claims, sound=sound, doubled=doubled, silent=silent)
    made = _hidden_by_zones(replace(made, statements=[*map(Stated, zones), *made.statements]))
    progress(MEASURED)
    made = _without_ends(_with_slow(made, covariates, without, sought, progress))
    made = _with_motion(made, without, sound, in_turns=sought is None, of_turns=of_turns)
    made = _with_tilts(made, seconds) if sought is None else made
    return replace(made, statements=[replace(s, finding=_named(s.finding, without)) for s in made.statements])


def _hidden_by_zones(exam: Examination) -> Examination:
    """Return an examination whose streams say which of them a dead zone hides at rest.

    The edges of such a zone are jumps, and may look like anything that has no name.
    """
    found = [s.finding for s in exam.statements]

    def hidden(stream: Stream) -> bool:
        taken = any(is_zone(f) and f.sensor == stream.sensor for f in found)
        return taken and (stream.silent or hides_rest(found, stream.sensor, stream.raw.pieces))

    hides = [replace(s, levels=None, spectra=None, hidden=True) if hidden(s) else s for s in exam.streams]
    taken = {s.sensor for s in hides if s.hidden}
    kept = [
        s
        for s, f in zip(exam.statements, found, strict=True)
        if f.effect != "unknown" or is_zone(f) or f.sensor not in taken
    ]
    return replace(exam, streams=hides, statements=kept)


WALK = "bias_random_walk"


def _without_ends(exam: Examination) -> Examination:
    """Return an examination without bands of noise that are the end of a bias' wander, which is told."""
    told = [s.finding for s in exam.statements]
    wanders = {f.sensor for f in told if f.where.driver == NO_DRIVER or f.effect.endswith(WALK)}
    spectra = {s.sensor: s.spectra for s in exam.streams if s.sensor in wanders and s.spectra is not None}

    def is_end(finding: Finding) -> bool:
        return finding.sensor in spectra and is_end_of_wander(finding, spectra[finding.sensor])

    return replace(exam, statements=[s for s in exam.statements if not is_end(s.finding)])


def _of_samples(
    accelerometer: Samples,
    gyroscope: Samples | None,
    bins: Bins,
    claims: Claims,
    *,
    sound: SoundPhones,
    doubled: Finding | None,
    silent: frozenset[str],
) -> Examination:
    """Return an examination with what single samples show, and the bins that slow effects are judged on.

    bins: all that are still; doubled: the finding of samples that came twice; silent: the sensors without
    noise of their own, whose level is none; the others are those of `examine`.
    """
    sensors = [(s, x) for s, x in (("accel", accelerometer), ("gyro", gyroscope)) if x]
    spoiled = [f for s, x in sensors if (f := stuck(x, s))]
    between = turns_between(gyroscope, outside_of(bins, spoiled), claims.gravity)
    turned = other_axes(between)
    exchanged = None if turned else garbled(between)
    spoiled += [exchanged] if exchanged else []
    clear = outside_of(bins, spoiled)
    streams = agreed([Stream.of(s, x, clear) for s, x in sensors])
    streams = [replace(s, levels=None, silent=True) if s.sensor in silent else s for s in streams]
    nameless = [
        f for s in streams for f in sequence_findings(s.samples, s.calm, s.sensor, clear, s.vibrations)
    ]
    named = judged(direct_findings(streams, claims, sound), accelerometer, [x for _, x in sensors])
    flat = [f for s, x in sensors if (f := dead(x, s))]
    whole = [f for f in (doubled, turned) if f]
    found = [*spoiled, *flat, *whole, *beside_names(nameless, named)]
    return Examination(
        accelerometer,
        gyroscope,
        claims,
        roughened(unlimited(clear, found, streams[0]), {s.sensor: s.steps for s in streams}),
        streams,
        sensors=[],
        aligned=None,
        turns=None,
        statements=[Stated(f) for f in found],
        exchanged=next((f.sensor for f in (exchanged, turned) if f), ""),
        other_axes=turned,
        spoiled=[(f.where.t_start, f.where.t_end) for f in spoiled],
    )


def _with_slow(
    exam: Examination,
    covariates: Mapping[str, TimeSeries] | None,
    without: Collection[str],
    sought: Sequence[Hypothesis] | None,
    progress: Callable[[float], None],
) -> Examination:
    """Return an examination with the slow effects that each sensor's rests show; arguments of `examine`.

    Of a sensor whose axes were exchanged for a while nothing is searched for: when exactly is known too
    roughly.
    """
    if not len(exam.bins):
        return exam
    search = partial(slow_statements, without=without, sought=sought)
    rates = None if exam.gyroscope is None else in_step(exam.gyroscope, exam.streams)
    every = by_sensor(exam.bins, exam.claims.gravity, covariates, rates)
    sensors = about_nonlinearity([r for r in every if r.sensor != "gyro" or not exam.zone_at_rest])
    stated = list(exam.statements)
    garbled_one = "" if exam.other_axes else exam.exchanged
    for i, residuals in enumerate(sensors):
        if (sought is None or sought) and residuals.sensor != garbled_one:
            sensors[i], found = searched(residuals, search)
            stated += found
        progress(MEASURED + (SEARCHED - MEASURED) * (i + 1) / len(sensors))
    return replace(exam, sensors=sensors, statements=stated)


def _with_motion(
    exam: Examination,
    without: Collection[str],
    sound: SoundPhones,
    *,
    in_turns: bool,
    of_turns: Sequence[Stated],
) -> Examination:
    """Return an examination with what motion and the turns between rests show, where there is a gyroscope.

    in_turns: whether effects of turns are searched for; the others are those of `examine`.
    """
    if exam.gyroscope is None:
        return exam
    direct = [s.finding for s in exam.statements]
    known, affine = Known.among(exam.statements), None
    bare = off_bins(exam.bins, known)
    gravity = exam.claims.gravity
    most = min(limits_of("gyro_saturation", direct), default=np.inf)
    rates = OffRates.of(known, exam.accelerometer, bare, gravity)
    unsteady = _unsteady(exam, exam.gyroscope)
    moved = [in_step(s, exam.streams) for s in (exam.accelerometer, exam.gyroscope)]
    turned = partial(_turned, repeats.without_held(moved[1]), bare, gravity, most, unsteady=unsteady)
    turns = None
    if len(exam.bins):
        affine, turns = turned(rates)
    filters = FilterDelay.of({s.sensor: s.spectra for s in exam.streams if s.spectra and s.tells_filter})
    if exam.other_axes is None:
        force, rate = _without_lines(exam.streams, *moved)
        motion = shown_in_motion(
            force, rate, affine, gravity, sound["time_offset"],
            spoiled=[*exam.spoiled, *exam.on_limits], filters=filters,
            untold=[s.sensor for s in exam.streams if s.hides_filter],
            noise=_rate_noise(exam.streams),
        )  # fmt: skip
    else:
        motion = Shown([], why_none=OTHER_AXES)
    said = {(f.effect, f.sensor) for f in direct}
    stated = [*exam.statements, *(Stated(f) for f in motion.findings if (f.effect, f.sensor) not in said)]
    turns, about = None if exam.turns_untold else turns, None
    if affine is not None and turns is not None:
        searched_for = turn_statements(turns, without) if in_turns else of_turns
        found, about = about_effects(searched_for, (affine, turns), rates, turned)
        lasts = rms([t.duration for t in turns.turns])
        stated += beyond(unsure_tilt(stated, gravity, lasts), found) if in_turns else []
    return replace(
        exam,
        aligned=affine,
        turns=turns,
        about_turns=about,
        statements=stated,
        delay=motion.delay,
        why_no_delay=motion.why_none,
    )


def _rate_noise(streams: Sequence[Stream]) -> RateNoise | None:
    """Return the gyroscope's noise in the typical rest; None where rests do not show it."""
    found = next((s.spectra for s in streams if s.sensor == "gyro"), None)
    return None if found is None else RateNoise.of(found.f, found.power)


def _without_lines(streams: Sequence[Stream], *sensors: Samples) -> list[Samples]:
    """Return samples without the vibrations of any sensor: they shake each in a phase of its own.

    Beside a turn of the same frequency that would be an arm, or a delay, that no other turn shows.
    """
    lines = [middle_hz(line) for s in streams for line in s.lines if line.where.driver != WANDERS]
    return [replace(s, xyz=frozen(without_vibrations(s.xyz, s.t, lines))) for s in sensors]


def _with_tilts(exam: Examination, seconds: Overview) -> Examination:
    """Return an examination with what gravity's direction does that the gyroscope does not, unless explained.

    What a sensor is found to do without a name may be the cause, and is stated already: the accelerometer's
    bias where gravity jumps, the gyroscope too where turns are missed. A step that has a name, or a bias
    while charging, explains the jumps at its moments, which are told to a bin.
    """
    nameless = [s.finding for s in exam.statements if s.finding.effect == "unknown"]
    slow = {f.sensor for f in nameless if f.where.band_hz == SLOW_BAND}
    if "accel" in slow or exam.exchanged or exam.gyroscope is None:
        return exam
    found = unseen_tilt(
        seconds,
        (exam.bins.force_rounding, exam.bins.rate_rounding),
        exam.claims.gravity,
        [*exam.spoiled, *exam.on_limits, *_of_steps(exam)],
    )
    if found is None and all(f.sensor != "gyro" for f in nameless):
        found = _turn_errors(exam)
    return exam if found is None else replace(exam, statements=[*exam.statements, Stated(found)])


def _of_steps(exam: Examination) -> list[Span]:
    """Return when steps of the accelerometer's bias are, s, a bin on either side."""
    own = [s.hypothesis for s in exam.statements if s.finding.sensor == "accel" and s.hypothesis is not None]
    told, switches = float(exam.bins.duration.max(initial=0.0)), exam.bins.charging_switches
    moments = [h.grid["t_start"] for h in own if "t_start" in h.grid]
    if switches is not None and any(h.effect.follows == "charging" for h in own):
        moments += switches[1:, 0].tolist()  # the first is the start of the recording
    return [(t - told, t + told) for t in moments]


def _turn_errors(exam: Examination) -> Finding | None:
    """Return turns that no gyroscope with the effects found explains."""
    if exam.aligned is None or exam.turns_untold:
        return None
    known = off_bins(exam.bins, Known.among(exam.statements))
    found = [s.hypothesis for s in exam.statements if s.hypothesis and s.residuals and s.residuals.turns]
    return turn_errors(exam.aligned, known, exam.claims.gravity, found)


def _turned(
    gyroscope: Samples, bins: Bins, gravity: float, limit: float, rates: Rates, *, unsteady: Unsteady
) -> tuple[Aligned, SensorResiduals | None]:
    """Return both sensors' affine parameters and the turns under them.

    unsteady: what turns are allowed besides noise; the other arguments are those of `aligned`.
    """
    affine = replace(aligned(gyroscope, bins, gravity, limit, rates), unsteady=unsteady)
    return affine, turn_residuals(affine, bins, gravity)


def _unsteady(exam: Examination, gyroscope: Samples) -> Unsteady:
    """Return how the accelerometer's bias moves beside what was found of it, and the stamps' jitter."""
    sizes = [
        sizes_along_gravity(
            residuals, [s.hypothesis for s in exam.statements if s.hypothesis and s.residuals is residuals]
        )
        for residuals in exam.sensors
        if residuals.sensor == "accel"
    ]
    grid = grid_of(gyroscope)
    jitter = None if grid is None else grid.jitter()
    return Unsteady(*(sizes[0] if sizes else (0.0, 0.0)), 0.0 if jitter is None else jitter.value)


def _seen_in_all(accelerometer: Samples, overview: Overview | None) -> float:
    """Return how many samples the recording has, also those that are not held."""
    return float(len(accelerometer) if overview is None else overview.force.count.sum())


def refuse_too_little(accelerometer: Samples) -> None:
    """Raise NotSupported where not even the stamps can be judged."""
    if len(accelerometer) < LEAST_SAMPLES:
        needed = (f"at least {LEAST_SAMPLES}", "or the format rest, if each row is the mean of a rest")
        raise NotSupported(f"{len(accelerometer)} samples of the accelerometer", needed)
    span = float(accelerometer.t[-1] - accelerometer.t[0])
    if span < LEAST_SECONDS:
        raise NotSupported(f"{span:.4g} s of recording", (f"at least {LEAST_SECONDS:.0f} s",))


def _named(found: Finding, without: Collection[str]) -> Finding:
    """Take the name off a finding that the catalogue does not have."""
    if found.effect not in without:
        return found
    say = only_unknown(f"({found.sensor})", found.where.driver)
    return replace(found, effect="unknown", alternatives=[], statement=say)
