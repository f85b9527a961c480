"""The whole diagnosis of one recording: arrays in, findings out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct import dead_zone, halves, missing_codes
from stillcal.calib_core.diagnosis.direct import repeated_values as repeats
from stillcal.calib_core.diagnosis.direct.axis_exchange import garbled, outside
from stillcal.calib_core.diagnosis.direct.quantisation import Steps, quantisation, steps
from stillcal.calib_core.diagnosis.direct.quantities import of_noise
from stillcal.calib_core.diagnosis.direct.saturation import saturation
from stillcal.calib_core.diagnosis.direct.step_changes import step_change
from stillcal.calib_core.diagnosis.direct.stuck import stuck
from stillcal.calib_core.diagnosis.model.hypothesis import Scene
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.model.records import Claims, Diagnosis, Finding, Where
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned, aligned
from stillcal.calib_core.diagnosis.model.scenes import scenes
from stillcal.calib_core.diagnosis.model.sound_phones import SoundPhones, sound_phones, usual
from stillcal.calib_core.diagnosis.motion.group_delay import FilterDelay
from stillcal.calib_core.diagnosis.motion.time_offset import Shown, shown_in_motion
from stillcal.calib_core.diagnosis.noise import low_pass as spectrum
from stillcal.calib_core.diagnosis.noise import noise_level as noise
from stillcal.calib_core.diagnosis.noise.gathered_noise import (
    gathered_noise,
    gathered_noise_finding,
    without_parts,
)
from stillcal.calib_core.diagnosis.noise.heavy_tails import tails
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet, Spectra, bandwidth, quiet
from stillcal.calib_core.diagnosis.noise.noise_changes import by_force, changing
from stillcal.calib_core.diagnosis.noise.shared_noise import shared_noise, shared_noise_finding
from stillcal.calib_core.diagnosis.noise.spectral_line import tones
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut
from stillcal.calib_core.diagnosis.segments.vibration_gate import steady
from stillcal.calib_core.diagnosis.sequence.findings import beside_names, sequence_findings
from stillcal.calib_core.diagnosis.sequence.stamps import judged
from stillcal.calib_core.diagnosis.slow.findings import Stated, slow_statements, turn_statements
from stillcal.calib_core.diagnosis.slow.taken_off import Known, OffRates, off_bins
from stillcal.calib_core.diagnosis.slow.turn_residuals import turn_scene
from stillcal.calib_core.diagnosis.stamps.clock import timing_findings
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.streams.course import Course
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples

__all__ = ["Claims", "Diagnosis", "diagnose"]

LEAST_SAMPLES = 200
LEAST_SECONDS = 10.0
CLEAR = 4.0
"""Standard deviations of the noise that a mean must be below a limit."""

SAME_HZ = 0.05
"""Difference of two sensors' lines that is none: what a stretch of 20 s tells apart."""

MEASURED, SEARCHED = 0.15, 0.9
"""Share of the work that is done once single samples are judged, and once slow effects are searched for; on
recordings of five minutes to two hours these took 5 to 17 % and 90 to 97 % of the time."""


@dataclass(frozen=True, slots=True, eq=False)
class Examination:
    """A recording with all that its diagnosis was read from.

    bins: the static bins that slow effects are judged on; streams: each sensor's noise, steps and spectra;
    scenes: each sensor's slow residuals; turns: the rotation between rests (None where there is too little);
    aligned: both sensors' affine parameters (None without a gyroscope or rests); statements: the findings
    with the hypotheses they state. timed: whether it is known when what was recorded.
    exchanged: the sensor whose axes were exchanged for a while, of which nothing slow is searched for.
    delay: s, of the gyroscope behind the accelerometer; None where motion does not tell one.
    """

    accelerometer: Samples
    gyroscope: Samples | None
    claims: Claims
    bins: Bins
    streams: list[Stream]
    scenes: list[Scene]
    aligned: Aligned | None
    turns: Scene | None
    statements: list[Stated]
    timed: bool = True
    exchanged: str = ""
    delay: Measured | None = None

    def diagnosis(self, recording: str) -> Diagnosis:
        """Return the findings. recording: the name it is known by."""
        return Diagnosis(recording, [s.finding for s in self.statements])

    @property
    def is_table(self) -> bool:
        """Whether it is a table of rests, which has no samples."""
        return len(self.accelerometer) == 0


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
    covariates: Mapping[str, Course] | None = None,
    search: bool = True,
    overview: Overview | None = None,
    delivered_twice: int = 0,
    progress: Callable[[float], None] = lambda _share: None,
) -> Examination:
    """Measure a recording and find its effects; parameters and errors are those of `diagnose`.

    covariates: further logged columns by name, which a bias may follow. search: whether slow effects are
    searched for, which takes most of the time; a simulation that was made with known ones needs only to be
    measured. overview: every second of the recording, where the samples are only some of it; None where they
    are all. delivered_twice: samples that came twice and are here once. progress: is called with the share
    of the work that is done.
    """
    _refuse_too_little(accelerometer)
    claims, sound = claims or Claims(), sound or sound_phones()
    accelerometer, twice = repeats.without_doubles(accelerometer)
    gyroscope = None if gyroscope is None else repeats.without_doubles(gyroscope)[0]
    bins = still_bins(accelerometer, gyroscope, events, overview)
    sensors = [(s, x) for s, x in (("accel", accelerometer), ("gyro", gyroscope)) if x]
    lost = [f for s, x in sensors if (f := stuck(x, s))]
    spoiled = (
        None if gyroscope is None else garbled(accelerometer, gyroscope, _outside(bins, lost), claims.gravity)
    )
    gone = [*lost, spoiled] if spoiled else lost
    clear = _outside(bins, gone)
    streams = [Stream.of(s, x, clear, claims) for s, x in sensors]
    doubled = repeats.doubled(accelerometer, twice + delivered_twice, _seen_in_all(accelerometer, overview))
    nameless = [f for s in streams for f in sequence_findings(s.samples, s.sensor, clear)]
    named = judged(direct_findings(streams, claims, sound), accelerometer, [x for _, x in sensors])
    direct = [*gone, *([doubled] if doubled else []), *beside_names(nameless, named)]
    slow = _roughened(_unlimited(clear, direct, streams[0]), {s.sensor: s.steps for s in streams})
    residuals = scenes(slow, claims.gravity, covariates, gyroscope) if len(slow) else []
    stated = [Stated(f) for f in direct]
    searched = [r for r in residuals if search and not _is_of(spoiled, r.sensor)]
    progress(MEASURED)
    for done, scene in enumerate(searched, 1):
        stated += slow_statements(scene, without)
        progress(MEASURED + (SEARCHED - MEASURED) * done / len(searched))
    affine, turns, motion = None, None, Shown([])
    if gyroscope is not None:
        most = min(_limits_of("gyro_saturation", direct), default=np.inf)
        known = Known.among(stated)
        bare, rates = off_bins(slow, known), OffRates.of(known, accelerometer)
        affine = aligned(gyroscope, bare, claims.gravity, most, rates) if len(slow) else None
        windows = [f.where for f in gone]
        filters = FilterDelay.of({s.sensor: s.spectra for s in streams if s.spectra is not None})
        motion = shown_in_motion(
            accelerometer, gyroscope, affine, claims.gravity, sound["time_offset"],
            spoiled=windows, filters=filters,
        )  # fmt: skip
        known_filters = {(f.effect, f.sensor) for f in direct}
        stated += [Stated(f) for f in motion.findings if (f.effect, f.sensor) not in known_filters]
        if affine is not None and spoiled is None:
            turns = turn_scene(affine, bare, claims.gravity)
            stated += turn_statements(turns, without) if search else []
    stated = [replace(s, finding=_named(s.finding, without)) for s in stated]
    exchanged = spoiled.sensor if spoiled else ""
    return Examination(
        accelerometer, gyroscope, claims, slow, streams, residuals, affine, turns, stated,
        exchanged=exchanged, delay=motion.delay,
    )  # fmt: skip


def _seen_in_all(accelerometer: Samples, overview: Overview | None) -> float:
    """Return how many samples the recording has, also those that are not held."""
    return float(len(accelerometer) if overview is None else overview.force.count.sum())


def _refuse_too_little(accelerometer: Samples) -> None:
    if len(accelerometer) < LEAST_SAMPLES:
        raise NotSupported(
            f"{len(accelerometer)} samples of the accelerometer", (f"at least {LEAST_SAMPLES}",)
        )
    span = float(accelerometer.t[-1] - accelerometer.t[0])
    if span < LEAST_SECONDS:
        raise NotSupported(f"{span:.4g} s of recording", (f"at least {LEAST_SECONDS:.0f} s",))


def still_bins(
    accelerometer: Samples,
    gyroscope: Samples | None,
    events: Sequence[Charging] = (),
    overview: Overview | None = None,
) -> Bins:
    """Return the bins in which the phone lay still, a vehicle's turns left out; overview: as in `cut`."""
    return steady(cut(accelerometer, gyroscope, events, overview=overview))


def _outside(bins: Bins, found: Sequence[Finding]) -> Bins:
    """Return the bins that do not touch the time of any of the findings."""
    for f in found:
        bins = outside(bins, f.where.t_start, f.where.t_end)
    return bins


def _is_of(spoiled: Finding | None, sensor: str) -> bool:
    """Whether axes of a sensor were found exchanged: when exactly is known too roughly for more of it."""
    return spoiled is not None and spoiled.sensor == sensor


def _named(found: Finding, without: Collection[str]) -> Finding:
    """Take the name off a finding that the catalogue does not have."""
    if found.effect not in without:
        return found
    say = f"Unknown effect ({found.sensor}); it follows {found.where.driver}."
    return replace(found, effect="unknown", alternatives=[], statement=say)


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """One sensor's samples with what its rests show: steps, spectra and levels (None: too few rests)."""

    sensor: str
    samples: Samples
    bins: Bins
    still: Quiet
    steps: Steps
    spectra: Spectra | None
    levels: noise.Levels | None

    @classmethod
    def of(cls, sensor: str, samples: Samples, bins: Bins, claims: Claims) -> Stream:
        """Measure a sensor's rests; coarse steps hide its noise."""
        still = quiet(samples, bins)
        sd = (
            np.sqrt(np.median([p.var(axis=0) for p in still.pieces], axis=0)) if still.pieces else np.zeros(3)
        )
        seen = steps(samples, sd)
        floor = seen.largest**2 / (6.0 * still.rate)
        made = None if seen.hides_noise() else spectrum.judged(still, floor)
        return cls(
            sensor, samples, bins, still, seen, made, None if made is None else noise.levels(made, floor)
        )

    def halves(self, claims: Claims) -> list[Stream]:
        """Return the stream before and after its middle, each measured by itself."""
        middle = float(self.samples.t[len(self.samples) // 2])
        k = int(np.searchsorted(self.samples.t, middle))
        end = self.bins.t + self.bins.duration / 2
        start = self.bins.t - self.bins.duration / 2
        parts = ((self.samples[:k], end <= middle), (self.samples[k:], start >= middle))
        return [Stream.of(self.sensor, x, self.bins.chosen(np.asarray(rows)), claims) for x, rows in parts]

    def measured(self) -> dict[str, Measured]:
        """Return what its noise at rest measures, on the scales of the populations of sound phones."""
        return of_noise(self.sensor, self.still, self.steps, self.spectra, self.levels)


def direct_findings(streams: Sequence[Stream], claims: Claims, sound: SoundPhones) -> list[Finding]:
    """Return what stamps, values and spectra at rest show."""
    found = timing_findings(streams[0].samples, claims, sound)
    levels = {s.sensor: s.levels for s in streams if s.levels is not None}
    factor = noise.convention(levels, claims)
    for stream in streams:
        if len(stream.samples) >= LEAST_SAMPLES:
            found += _of_stream(stream, claims, factor, sound)
    return _without_echoes(found)


def _of_stream(stream: Stream, claims: Claims, factor: float, sound: SoundPhones) -> list[Finding]:
    """Return what one sensor's samples show; factor: between the claims' densities and one-sided ones."""
    sensor, samples = stream.sensor, stream.samples
    lsb, declared = (
        (claims.accel_lsb, claims.accel_range) if sensor == "accel" else (claims.gyro_lsb, claims.gyro_range)
    )
    held, share = repeats.held(samples, sensor, usual(sound, "held_samples", claims.nominal_rate_hz))
    comb = (
        quantisation(samples, sensor, stream.steps, lsb, sound["step_over_noise"])
        if len(stream.still.pieces) >= 3
        else None
    )
    cut_off = saturation(samples, sensor, np.maximum(stream.steps.sd, 1e-9), declared)
    found = [held, comb, cut_off, step_change(samples, sensor)]
    if not stream.steps.hides_noise():
        found += tones(samples, sensor)
        if share < repeats.MANY:
            found += _at_rest(stream, claims, factor, sound)
    known = without_parts([f for f in found if f is not None])
    known = missing_codes.beside(known, missing_codes.dead_bits(samples, sensor))
    return dead_zone.beside(known, dead_zone.dead_zone(samples, sensor))


def _at_rest(stream: Stream, claims: Claims, factor: float, sound: SoundPhones) -> list[Finding | None]:
    """Return what the noise at rest shows."""
    if stream.spectra is None or stream.levels is None:
        return []
    samples, sensor = stream.samples, stream.sensor
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, stream.still.rate / 2.0), "noise at rest")
    fine = not stream.steps.blurs_level()
    at_rest = (stream.spectra, stream.levels, sensor, stream.bins)
    other = (changing(*at_rest) or by_force(*at_rest)) if fine else None
    wide = (
        tails(stream.still, sensor, sound["excess_kurtosis"], where, stream.steps.largest)
        if stream.steps.dithered()
        else None
    )
    claim = noise.claimed(sensor, claims)
    claim = None if claim is None else factor * claim
    moving = None
    if wide is None and other is None and fine and stream.levels.own:
        moving = gathered_noise_finding(
            gathered_noise(stream.spectra), sensor, sound["noise_gathered"], where
        )
    found: list[Finding | None] = [other, wide, moving]
    if noise.suppressed(stream.levels, claim):
        found.append(bandwidth(stream.spectra, sensor, usual(sound, "bandwidth", claim), where))
    if wide is None and other is None and moving is None and fine:
        own, alike = stream.levels, shared_noise(stream.still) if stream.levels.own else None
        if alike is not None:
            shared = shared_noise_finding(alike, sensor, usual(sound, "noise_shared", claim), where)
            found.append(shared)
            own = own if shared is None else own.less(alike.coefficient.value)
        found += noise.noise_findings(sensor, own, claim, sound, where)
    if not any(f is not None and f.effect in halves.QUANTITIES for f in found):
        return found
    parts = [half.measured() for half in stream.halves(claims)]
    return [f for f in found if f is None or halves.borne_out(f, parts, sound, claim)]


def _without_echoes(found: list[Finding]) -> list[Finding]:
    """Leave out a gyroscope's line at the frequency of one of the accelerometer's.

    A vibration of the phone that both sensors feel is the force's.
    """
    tones = [f for f in found if f.effect == "vibration_tone"]
    felt = [_middle_hz(f) for f in tones if f.sensor == "accel"]
    echoes = [f for f in tones if f.sensor == "gyro" and any(abs(_middle_hz(f) - x) < SAME_HZ for x in felt)]
    return [f for f in found if not any(f is echo for echo in echoes)]


def _middle_hz(found: Finding) -> float:
    return float(np.mean(found.where.band_hz))


def _limits_of(effect: str, found: Sequence[Finding | None]) -> list[float]:
    said = [f for f in found if f is not None and f.effect == effect]
    return [float(np.min(f.parameters["limit"].value)) for f in said]


def _unlimited(bins: Bins, found: Sequence[Finding], force: Stream) -> Bins:
    """Return the bins whose force is clear of a limit that was found: what is cut off shifts the mean."""
    limits = _limits_of("accel_saturation", found)
    if not limits or not len(bins):
        return bins
    clear = limits[0] - CLEAR * force.steps.sd
    return bins.chosen(np.asarray((np.abs(bins.force) < clear).all(axis=1)))


def _roughened(bins: Bins, seen: dict[str, Steps]) -> Bins:
    """Return bins whose means are no surer than steps that hide the noise allow, however many lie as one."""
    for sensor, values, variances in (
        ("accel", "force", "force_variance"),
        ("gyro", "rate", "rate_variance"),
    ):
        mean = getattr(bins, values)
        if len(bins) and mean is not None and sensor in seen and seen[sensor].blurs_level():
            wide = _shared_error(mean, bins, seen[sensor])
            bins = replace(bins, **{variances: getattr(bins, variances) + wide})
    return bins


def _shared_error(mean: Array, bins: Bins, seen: Steps) -> Array:
    """Return variances (n, 3): the steps' error, which all bins share whose means round alike."""
    cells = np.rint(mean / max(seen.largest, 1e-300))
    _, which, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    return np.asarray(seen.mean_error() ** 2 * count[which.ravel()][:, None], dtype=np.float64)
