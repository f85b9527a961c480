"""What a recording's effects, motion and conditions are, for whatever is simulated in its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.direct import HELD, held_as_compared
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import OF_DENSITY
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.direct.repeated_values import without_held
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.rotation_alignment import aligned
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.taken_off import Known, error_of, off_bins
from stillcal.calib_core.streams.resample import median_rate_hz
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.phone.phone_effects import MappedFinding, map_findings
from stillcal.replay.diagnosis.phone.phone_file import phone_of
from stillcal.replay.diagnosis.phone.resimulate import Motion, added_to, motion_of, resimulate
from stillcal.replay.diagnosis.phone.twin import (
    AffinePhone,
    Conditions,
    conditions_of,
    fit_affine,
    observable,
    skew_of,
)
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.effects.base import Effect
from stillcal.replay.phone.effects.on_input import VibrationTone
from stillcal.replay.phone.effects.on_settings import GyroSaturation
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.sensor_chain import LowPass
from stillcal.replay.phone.settings import SensorSettings

SEED = 2
"""Of what is simulated."""

LEAST_GAIN = 1e-3
"""Of a low-pass, to undo it for a vibration: at half the rate a digital one leaves nothing."""

ROUNDS = 3
"""Times that the gyroscope's scale is fitted about the effects of the rate, which go with the true one."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A recording with what an ideal sensor lacks of it.

    mapped: the findings, each with its effect in a phone file. beside: those of them that a phone file cannot
    have, such as a bias that follows a logged column; the bins are without what these add. affine: the
    constants fitted with all of them. cutoffs: Hz, of the low-passes that the noise shows, by sensor, also of
    those that sound phones have. orders: theirs; a phone file's are of the second. held: shares of samples
    that repeat the one before, by sensor, also of as many as sound phones hold.
    """

    recording: Recording
    bins: Bins
    gravity: float
    conditions: Conditions
    mapped: tuple[MappedFinding, ...]
    beside: tuple[Known, ...]
    affine: AffinePhone
    cutoffs: Mapping[str, float]
    orders: Mapping[str, int]
    held: Mapping[str, float]

    def phone(self) -> Phone:
        """Return the phone that the recording shows, with the effects found. Needs static bins."""
        known = (self.recording, self.bins, self.effects, self.affine)
        made = phone_of(*known, conditions=self.conditions, gravity=self.gravity)
        accel = self._as_sampled(made.accel, "accel")
        gyro = made.gyro and self._as_sampled(made.gyro, "gyro")
        effects = tuple(_as_felt(effect, accel, gyro) for effect in made.effects)
        return msgspec.structs.replace(made, accel=accel, gyro=gyro, effects=effects)

    def _as_sampled(self, settings: SensorSettings, sensor: str) -> SensorSettings:
        """Return the settings of a sensor with the low-pass and the held samples that it shows."""
        found = any((m.finding.effect, m.finding.sensor) == (HELD, sensor) for m in self.mapped)
        share = 0.0 if found else self.held.get(sensor, 0.0)
        return msgspec.structs.replace(settings, cutoff_hz=self.cutoffs.get(sensor), held_fraction=share)

    def played(self, phone: Phone, conditions: Conditions | None = None) -> Recording:
        """Return what a phone would have recorded of this recording's motion, beside the same columns.

        conditions: other than the recording's own, whose reference temperature is its mean.
        """
        bare = with_errors(_fresh(self.recording), self.beside, -1.0)
        motion = motion_of(bare, self.bins, self.affine, self.effects, self.conditions, gravity=self.gravity)
        motion = self._before_low_passes(motion)
        made = resimulate(self.recording, motion, conditions or self.conditions, phone, seed=SEED)
        return replace(made, covariates=self.recording.covariates)

    def _before_low_passes(self, motion: Motion) -> Motion:
        """Return a motion before the recording's low-passes delayed it: a phone's own do so anew."""

        def late(samples: Samples, sensor: str) -> float:
            cutoff = self.cutoffs.get(sensor)
            if cutoff is None:
                return 0.0
            return LowPass(cutoff, median_rate_hz(samples), self.orders[sensor]).delay_s

        force_t = motion.force_t - late(self.recording.accelerometer, "accel")
        if motion.rate_t is None or self.recording.gyroscope is None:
            return replace(motion, force_t=force_t)
        return replace(motion, force_t=force_t, rate_t=motion.rate_t - late(self.recording.gyroscope, "gyro"))

    @property
    def effects(self) -> list[Effect]:
        """The effects found that a phone file can have."""
        return [m.effect for m in self.mapped if m.effect is not None]

    def not_in_phone(self) -> list[str]:
        """Return the effects found that a phone file cannot have, without those of a density."""
        return [
            m.finding.effect for m in self.mapped if m.effect is None and m.finding.effect not in OF_DENSITY
        ]


def _as_felt(effect: Effect, accel: SensorSettings, gyro: SensorSettings | None) -> Effect:
    """Return an effect; a vibration as the sensor feels it: what it reads, before its scale and low-pass."""
    settings = accel if effect.concerns(Sensor.ACCELEROMETER) else gyro
    if not isinstance(effect, VibrationTone) or settings is None:
        return effect
    felt = np.linalg.solve(np.asarray(settings.scale), np.asarray(effect.amplitude))
    if settings.cutoff_hz is not None and effect.frequency < settings.rate_hz / 2.0:
        felt /= max(LowPass(settings.cutoff_hz, settings.rate_hz).gain(effect.frequency), LEAST_GAIN)
    x, y, z = felt.tolist()
    return msgspec.structs.replace(effect, amplitude=(x, y, z))


def _fresh(recording: Recording) -> Recording:
    """Return a recording without the samples that are held, which are no motion: a phone holds its own."""
    gyro = recording.gyroscope
    accel = without_held(recording.accelerometer)
    return replace(recording, accelerometer=accel, gyroscope=gyro and without_held(gyro))


def case_of(recording: Recording, exam: Examination, against_ideal: Comparison) -> Case:
    """Return a recording's case. against_ideal: its comparison with an ideal sensor."""
    conditions, gravity, bins = conditions_of(exam.bins), exam.claims.gravity, exam.bins
    stated = [d.recorded for d in against_ideal.discrepancies if d.recorded is not None]
    findings = [one for f in stated for one in (f, *f.echoes)]
    mapped = tuple(map_findings(findings, bins, conditions))
    effects = [m.effect for m in mapped if m.effect is not None]
    foreign = {id(m.finding) for m in mapped if m.effect is None}
    beside = tuple(Known.among(s for s in exam.statements if id(s.finding) in foreign))
    # What these add is known, and no slow noise, bias or motion.
    bare, bins = with_errors(recording, beside, -1.0), off_bins(bins, beside)
    affine = fit_affine(bins, effects, conditions, gravity)
    if exam.aligned is not None:
        affine = replace(affine, rate_mapping=exam.aligned.mapping * (1.0 + skew_of(effects)))
    if any(observable(e) and e.concerns(Sensor.GYROSCOPE) for e in effects):
        for _ in range(ROUNDS):
            affine = _about_effects(bare, bins, affine, effects, conditions, gravity=gravity)
    spectra = {s.sensor: s.spectra for s in exam.streams if s.spectra is not None}
    seen = {s: low for s, one in spectra.items() if (low := one.low_pass) and low.on_all}
    cutoffs = {s: float(f"{one.cutoff.value:.4g}") for s, one in seen.items()}
    orders = {s: one.order for s, one in seen.items()}
    held = held_as_compared(exam)
    return Case(recording, bins, gravity, conditions, mapped, beside, affine, cutoffs, orders, held)


def with_errors(recording: Recording, known: Sequence[Known], times: float = 1.0) -> Recording:
    """Return a recording with so many times what the known effects add put into its samples."""
    accelerometer, gyroscope = recording.accelerometer, recording.gyroscope

    def changed(samples: Samples) -> Samples:
        added = error_of(samples, known, accelerometer)
        return replace(samples, xyz=frozen(samples.xyz + times * added)) if added.any() else samples

    return replace(
        recording, accelerometer=changed(accelerometer), gyroscope=gyroscope and changed(gyroscope)
    )


def _about_effects(
    recording: Recording,
    bins: Bins,
    affine: AffinePhone,
    effects: Sequence[Effect],
    conditions: Conditions,
    *,
    gravity: float,
) -> AffinePhone:
    """Return the phone with the mapping of rates fitted again to turns without what effects add to these.

    What goes with the rate of turn itself, such as a nonlinearity, else looks like a part of the scale.
    """
    gyroscope, added = recording.gyroscope, added_to(recording, affine, effects, conditions)[1]
    if gyroscope is None or added is None or bins.rate is None:
        return affine

    def rates(part: Samples) -> Array:
        first = int(np.searchsorted(gyroscope.t, part.t[0]))
        return np.asarray(part.xyz - added[first : first + len(part)])

    bare = replace(bins, force=bins.force - affine.accel, rate=bins.rate - affine.gyro)
    limit = min((e.limit for e in effects if isinstance(e, GyroSaturation)), default=np.inf)
    mapping = aligned(gyroscope, bare, gravity, limit, rates).mapping
    return replace(affine, rate_mapping=mapping * (1.0 + skew_of(effects)))
