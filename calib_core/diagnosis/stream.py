"""One sensor's samples: what its rests show of noise, steps and spectra, and the effects that values show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.direct import dead_zone, halves, missing_codes
from stillcal.calib_core.diagnosis.direct import repeated_values as repeats
from stillcal.calib_core.diagnosis.direct.quantisation import Steps, quantisation, steps
from stillcal.calib_core.diagnosis.direct.quantities import of_noise
from stillcal.calib_core.diagnosis.direct.saturation import saturation
from stillcal.calib_core.diagnosis.direct.step_changes import step_change
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.model.records import AT_REST, AXES, Claims, Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import SoundPhones, Usual, sound_phones, usual
from stillcal.calib_core.diagnosis.noise import low_pass as spectrum
from stillcal.calib_core.diagnosis.noise import noise_level as noise
from stillcal.calib_core.diagnosis.noise.coloured_noise import (
    Coloured,
    coloured_noise,
    coloured_noise_finding,
    in_band,
    moves_together,
)
from stillcal.calib_core.diagnosis.noise.gathered_noise import (
    gathered_noise,
    gathered_noise_finding,
    without_parts,
)
from stillcal.calib_core.diagnosis.noise.heavy_tails import tails
from stillcal.calib_core.diagnosis.noise.lines.line import COMES_AND_GOES as CHANGING
from stillcal.calib_core.diagnosis.noise.lines.line import is_line, middle_hz, reach_hz
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import AtRest, tones
from stillcal.calib_core.diagnosis.noise.lines.steady_period import steady_period
from stillcal.calib_core.diagnosis.noise.low_pass import LEAST_PIECES, Quiet, Spectra, bandwidth, quiet
from stillcal.calib_core.diagnosis.noise.noise_changes import by_force, changing
from stillcal.calib_core.diagnosis.noise.shared_noise import shared_noise, shared_noise_finding
from stillcal.calib_core.diagnosis.segments.noise_range import loudest
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.diagnosis.sequence.neighbours import without_outliers
from stillcal.calib_core.diagnosis.stamps.clock import timing_findings
from stillcal.calib_core.streams.samples import Samples

LEAST_SAMPLES = 200
"""Samples below which nothing is judged."""

SAME_HZ = 0.05
"""Difference of two sensors' lines that is none: what a stretch of 20 s tells apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """One sensor's samples with what its rests show: steps, spectra and levels (None: too few rests).

    calm: the samples without single outliers, which lines, levels and steps are read from; lines: the
    vibrations found, which are taken off what the rests show of noise (`still`); period: a slower one, not
    looked for where the lines were known; raw: the same rests with the outliers; silent: whether its noise is
    not its own, but was added to a sensor without any (then there are no levels); hidden: whether a dead zone
    takes what it reads at rest (then there are neither spectra nor levels); passing: those of the lines that
    are of what the device lay on for a while; shaken: whether another sensor is shaken at rest, by more than
    any sensor's noise, and this one with it.
    """

    sensor: str
    samples: Samples
    calm: Samples
    bins: Bins
    lines: list[Finding]
    period: Finding | None
    still: Quiet
    raw: Quiet
    steps: Steps
    spectra: Spectra | None
    levels: noise.Levels | None
    silent: bool = False
    hidden: bool = False
    passing: tuple[Finding, ...] = ()
    shaken: bool = False

    @classmethod
    def of(cls, sensor: str, samples: Samples, bins: Bins, lines: list[Finding] | None = None) -> Stream:
        """Measure a sensor's rests; coarse steps hide its noise. lines: if known; None to look for them."""
        calm = without_outliers(samples)
        rests = quiet(calm, bins)
        sd = (
            np.sqrt(np.median([p.var(axis=0) for p in rests.pieces], axis=0)) if rests.pieces else np.zeros(3)
        )
        seen = steps(samples, sd)
        period: Finding | None = None
        passing: tuple[Finding, ...] = ()
        if lines is None and not seen.hides_noise():
            at_rest = AtRest.of(calm, sensor)
            lines, period = tones(calm, sensor, at_rest), steady_period(calm, sensor, at_rest)
            passing = tuple(f for f in lines if at_rest.is_passing(f))
        lines = lines or []
        heard = [middle_hz(f) for f in lines]
        still = quiet(calm, bins, heard) if lines else rests
        raw = still if calm is samples else quiet(samples, bins, heard)
        found = _noise_of(still, seen, sensor)
        return cls(sensor, samples, calm, bins, lines, period, still, raw, seen, *found, passing=passing)

    def is_passing(self, line: Finding) -> bool:
        """Whether one of its lines is of what the device lay on for a while."""
        return any(line is one for one in self.passing)

    @property
    def span(self) -> tuple[float, float]:
        """First and last stamp, s."""
        return float(self.samples.t[0]), float(self.samples.t[-1])

    @property
    def vibrations(self) -> list[float]:
        """Frequencies, a sample, of the vibrations found."""
        return [frequency / self.still.rate for frequency in self.still.lines]

    @property
    def repeats_many(self) -> bool:
        """Whether so many samples repeat the one before that its spectrum is not that of the noise."""
        seen = repeats.Repeats.of(self.samples)
        return seen is not None and seen.share().value >= repeats.MANY

    @property
    def tells_filter(self) -> bool:
        """Whether its noise tells a low-pass, or that there is none."""
        if self.spectra is None or self.levels is None:
            return False
        return self.spectra.low_pass is not None or self.levels.own

    @property
    def hides_filter(self) -> bool:
        """Whether its noise is hidden, by coarse steps or repeated values, and with it any low-pass."""
        return self.steps.hides_noise() or self.repeats_many

    def halves(self) -> list[Stream]:
        """Return the stream before and after its middle, each measured by itself."""
        middle = float(self.samples.t[len(self.samples) // 2])
        k = int(np.searchsorted(self.samples.t, middle))
        end = self.bins.t + self.bins.duration / 2
        start = self.bins.t - self.bins.duration / 2
        parts = ((self.samples[:k], end <= middle), (self.samples[k:], start >= middle))
        return [
            Stream.of(self.sensor, x, self.bins.chosen(np.asarray(rows)), self.lines) for x, rows in parts
        ]

    def without_low_pass(self) -> Stream:
        """Return the stream with its noise taken as it is, behind no low-pass."""
        if self.spectra is None or self.levels is None:
            return self
        flat = replace(self.spectra, low_pass=None)
        own = noise.levels(flat, _floor(self.still, self.steps))
        return replace(self, spectra=flat, levels=replace(own, loud=self.levels.loud))

    def measured(self) -> dict[str, Measured]:
        """Return what its noise at rest measures, on the scales of the populations of sound phones."""
        out = of_noise(self.sensor, self.still, self.steps, self.spectra, self.levels)
        coloured = self.coloured()
        return out if coloured is None else out | {"noise_coloured": coloured.size()}

    def coloured(self, band: tuple[float, float] | None = None) -> Coloured | None:
        """Return the band of its own noise that stands apart most, or what a given one has, Hz.

        None where its noise does not tell: where it is hidden, or what shakes the phone is in that band.
        """
        if self.spectra is None or self.levels is None or self.levels.loud or self.silent or self.shaken:
            return None
        if self.steps.blurs_level() or self.repeats_many:
            return None
        found = coloured_noise(self.spectra) if band is None else in_band(self.spectra, band)
        if found is None or any(_reaches(line, found.band) for line in self.lines):
            return None
        # What makes as much as sound phones have is not asked: spectra of sums take long in a day of rests.
        sound = found.size().value <= sound_phones()["noise_coloured"].highest
        return found if sound or not moves_together(self.still, self.spectra, found) else None

    def coarse_values(self, lsb: float | None, usual: Usual | None) -> Finding | None:
        """Return the step that its values come in, if that is coarse (`quantisation`); None in few rests."""
        if len(self.still.pieces) < LEAST_PIECES:
            return None
        return quantisation(self.samples, self.sensor, self.steps, lsb, usual)

    def with_what_moves(self) -> tuple[Spectra | None, noise.Levels | None]:
        """Return spectra and levels in which a line that is at another frequency in every rest is left.

        Several lines that come and go may be one that moves; a single one has its own frequency.
        """
        changing = [f for f in self.lines if f.where.driver == CHANGING]
        if len(changing) < 2:
            return self.spectra, self.levels
        steady = [middle_hz(f) for f in self.lines if f.where.driver != CHANGING]
        return _noise_of(quiet(self.calm, self.bins, steady), self.steps, self.sensor)


def _noise_of(still: Quiet, seen: Steps, sensor: str) -> tuple[Spectra | None, noise.Levels | None]:
    """Return spectra and noise levels of rests; None where steps hide it or rests are few.

    What is louder than any sensor's noise shakes the phone: its spectrum tells no filter of the sensor.
    """
    floor = _floor(still, seen)
    made = None if seen.hides_noise() else spectrum.judged(still, floor)
    if made is None:
        return None, None
    levels = noise.levels(made, floor)
    if levels.values().min() <= loudest(sensor, still.rate):
        return made, levels
    return replace(made, low_pass=None), replace(levels, loud=True)


def _floor(still: Quiet, seen: Steps) -> float:
    """Return the power that steps add to noise as fine as they are, unit^2/Hz."""
    return seen.largest**2 / (6.0 * still.rate)


def in_step(samples: Samples, streams: Sequence[Stream]) -> Samples:
    """Return a sensor's samples without the delay of axes that a low-pass filters where it leaves others.

    Rates of which one comes late turn the device about other axes than it was turned.
    """
    spectra = next((s.spectra for s in streams if s.samples.sensor == samples.sensor), None)
    found = None if spectra is None else spectra.low_pass
    if found is None or found.on_all:
        return samples
    xyz = samples.xyz.copy()
    for axis in found.axes:
        xyz[:, axis] = np.interp(samples.t + found.late.value, samples.t, xyz[:, axis])
    return replace(samples, xyz=frozen(xyz))


def direct_findings(streams: Sequence[Stream], claims: Claims, sound: SoundPhones) -> list[Finding]:
    """Return what stamps, values and spectra at rest show."""
    found = timing_findings(streams[0].samples, claims, sound)
    levels = {s.sensor: s.levels for s in streams if s.levels is not None}
    factor = noise.convention(levels, claims)
    for stream in streams:
        if len(stream.samples) >= LEAST_SAMPLES:
            others = [s for s in streams if s is not stream]
            found += _of_stream(stream, others, claims, factor, sound)
    return _without_echoes(found)


def _of_stream(
    stream: Stream, others: Sequence[Stream], claims: Claims, factor: float, sound: SoundPhones
) -> list[Finding]:
    """Return what one sensor's samples show; factor: between the claims' densities and one-sided ones."""
    sensor, samples = stream.sensor, stream.samples
    lsb, declared = (
        (claims.accel_lsb, claims.accel_range) if sensor == "accel" else (claims.gyro_lsb, claims.gyro_range)
    )
    held, share = repeats.held(samples, sensor, usual(sound, "held_samples", claims.nominal_rate_hz))
    comb = stream.coarse_values(lsb, sound["step_over_noise"])
    cut_off = saturation(samples, sensor, np.maximum(stream.steps.sd, 1e-9), declared)
    found = [held, comb, cut_off, step_change(samples, sensor)]
    if not stream.steps.hides_noise():
        found += [*(f for f in stream.lines if not stream.is_passing(f)), stream.period]
        if share < repeats.MANY:
            found += _at_rest(stream, others, claims, factor, sound)
    known = without_parts([f for f in found if f is not None])
    known = missing_codes.beside(known, missing_codes.dead_bits(samples, sensor))
    return dead_zone.beside(known, dead_zone.dead_zone(samples, sensor))


def _at_rest(
    stream: Stream, others: Sequence[Stream], claims: Claims, factor: float, sound: SoundPhones
) -> list[Finding | None]:
    """Return what the noise at rest shows."""
    if stream.spectra is None or stream.levels is None:
        return []
    sensor = stream.sensor
    where = Where(*stream.span, (0.0, stream.still.rate / 2.0), AT_REST)
    fine = not stream.steps.blurs_level()
    at_rest = (stream.spectra, stream.levels, sensor, stream.bins)
    other = (changing(*at_rest) or by_force(*at_rest)) if fine else None
    wide = (
        tails(stream.raw, sensor, sound["excess_kurtosis"], where, stream.steps.largest)
        if stream.steps.dithered()
        else None
    )
    claim = noise.claimed(sensor, claims)
    claim = None if claim is None else factor * claim
    moving = None
    gathered, levels = stream.with_what_moves()
    if wide is None and other is None and fine and gathered is not None and levels is not None and levels.own:
        moving = gathered_noise_finding(gathered_noise(gathered), sensor, sound["noise_gathered"], where)
    found: list[Finding | None] = [other, wide, moving]
    if noise.suppressed(stream.levels, claim):
        common = usual(sound, spectrum.population(stream.spectra), claim)
        found.append(bandwidth(stream.spectra, sensor, common, where))
    if wide is None and other is None and moving is None and fine:
        own = stream.levels
        alike = shared_noise(stream.still, stream.spectra) if own.own else None
        if alike is not None:
            shared = shared_noise_finding(alike, sensor, usual(sound, "noise_shared", claim), where)
            found.append(shared)
            own = own if shared is None else own.less(alike.coefficient.value)
        found += [] if stream.shaken else noise.noise_findings(sensor, own, claim, sound, where)
        colour, usual_band = stream.coloured(), sound["noise_coloured"]
        if colour is not None and not any(_has_too(s, colour, usual_band) for s in others):
            found.append(coloured_noise_finding(colour, sensor, usual_band, where))
    if not any(f is not None and halves.quantities_of(f) for f in found):
        return found
    parts = [half.measured() for half in stream.halves()]
    return [f for f in found if f is None or halves.borne_out(f, parts, sound, claim)]


def _has_too(other: Stream, found: Coloured, sound: Usual) -> bool:
    """Whether another sensor has more, or less, in a band as well, and more so than any sound phone.

    What shakes the phone moves both; the noise of one sensor is not in the other.
    """
    band = None if other.spectra is None else in_band(other.spectra, found.band)
    if band is None or band.size().value <= sound.highest:
        return False
    return bool(np.sign(band.log_ratio.value) == np.sign(found.log_ratio.value))


def _reaches(line: Finding, band: tuple[float, float]) -> bool:
    """Whether a line whose frequency is not one and the same reaches into a band, Hz."""
    low, high = middle_hz(line) - reach_hz(line), middle_hz(line) + reach_hz(line)
    return high > low and low < band[1] and high > band[0]


def _without_echoes(found: list[Finding]) -> list[Finding]:
    """Leave out a gyroscope's line at the frequency of one of the accelerometer's, which says so.

    A vibration of the phone that both sensors feel is the force's.
    """
    heard = [f for f in found if is_line(f) and f.sensor == "gyro"]
    echoes: list[Finding] = []
    kept: list[Finding] = []
    for one in found:
        felt = is_line(one) and one.sensor == "accel"
        also = [f for f in heard if felt and of_one_vibration(f, one)]
        echoes += also
        told = " ".join(filter(None, [one.remark, *map(_echo, also)]))
        kept.append(replace(one, remark=told, echoes=tuple(also)) if also else one)
    return [f for f in kept if not any(f is echo for echo in echoes)]


def agreed(streams: Sequence[Stream]) -> list[Stream]:
    """Return streams that agree on what the device lay on: a vibration is there while either sensor shows it.

    The other one may show only its loudest part. What shakes one, by more than any sensor's noise, shakes the
    others.
    """
    lines = [(f, s.is_passing(f)) for s in streams for f in s.lines]

    def passes(line: Finding) -> bool:
        same = [
            (float(np.asarray(f.parameters["fraction"].value)), passing)
            for f, passing in lines
            if f is line or (f.sensor != line.sensor and of_one_vibration(f, line))
        ]
        return max(same)[1]

    shaken = [s for s in streams if s.levels is not None and s.levels.loud and not s.levels.alike]
    return [
        replace(
            s,
            passing=tuple(f for f in s.lines if passes(f)),
            shaken=any(one is not s for one in shaken),
        )
        for s in streams
    ]


def of_one_vibration(one: Finding, other: Finding) -> bool:
    """Whether lines of both sensors are at one frequency."""
    return abs(middle_hz(one) - middle_hz(other)) < SAME_HZ + min(reach_hz(one), reach_hz(other))


def _echo(line: Finding) -> str:
    """Say that the gyroscope has a line too."""
    size = np.atleast_1d(np.asarray(line.parameters["amplitude"].value, dtype=np.float64))
    sizes = ", ".join(f"{a} {size[AXES.index(a)]:.3g}" for a in line.axes)
    return f"The gyroscope has it too, amplitude {sizes} {UNIT[line.sensor]}."
