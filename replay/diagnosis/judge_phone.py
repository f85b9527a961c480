"""A recording compared with a given phone: what the phone already has is not a finding.

The phone's effects that follow from recorded quantities are subtracted from the recording before the
diagnosis. Time stamps, noise and single values are checked on the recording itself, with the phone's values
as claims.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.model.records import Claims, Diagnosis, Finding, verdict_of
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.streams.resample import interpolate, median_rate_hz, temperature_at
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.diagnose import bins_of, claims_of, diagnosis_of
from stillcal.replay.diagnosis.twin import Conditions, conditions_of, effects_output, observable
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.effects.base import Effect, Moment
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.settings import SensorSettings, per_axis

SLOWEST = 0.05
"""Rates below this have no effect through a lever arm, rad/s."""

ON_SAMPLES = (
    "saturation", "quantisation", "noise_level", "noise_unequal_axes", "noise_heavy_tailed", "vibration_tone",
    "clock_skew", "timestamp_jitter", "dropped_samples", "arrival_bursts", "bandwidth", "time_offset",
)  # fmt: skip
"""Findings that are searched for in the recording as it is, by the end of their names."""

SETTINGS = {
    "timestamp_jitter": ("sigma", "jitter_s"),
    "clock_skew": ("relative", "skew"),
    "dropped_samples": ("fraction", "drop_fraction"),
    "arrival_bursts": ("fraction", "burst_fraction"),
    "accel_gyro_time_offset": ("delay", "gyro_delay_s"),
}
"""Findings about the clock: their parameter, and the clock's setting that is the same."""

SAME_RATE = 0.05
"""Relative difference of rates that a clock can have; a larger one is another setting of the rate."""

NEAR = 0.1
"""Relative difference from the phone's value that counts as equal, even outside a narrower interval."""


@dataclass(frozen=True, slots=True)
class PhoneJudgement:
    """The diagnosis of what a phone does not explain.

    already_simulated: findings that the phone has; only_simulated: what the phone has and the recording does
    not show.
    """

    diagnosis: Diagnosis
    already_simulated: list[dict[str, str]] = field(default_factory=list)
    only_simulated: list[dict[str, str]] = field(default_factory=list)
    phone: Phone | None = None

    def plain(self) -> dict[str, Any]:
        """Return what there is beside the findings, as plain values; nothing where no phone was given."""
        if self.phone is None:
            return {}
        return {"already_simulated": self.already_simulated, "only_simulated": self.only_simulated}

    def known(self) -> tuple[Effect, ...]:
        """Return the judged phone's effects that the recording bears out or observes the course of."""
        if self.phone is None:
            return ()
        confirmed = {k["effect"] for k in self.already_simulated}
        return tuple(e for e in self.phone.effects if observable(e) or e.name in confirmed)


def judge_phone(recording: Recording, name: str, phone: Phone) -> PhoneJudgement:
    """Compare a recording with a phone. name: of the recording. Raises NotSupported on too little data."""
    claimed = claims_of(recording)
    rate_hz = median_rate_hz(recording.accelerometer)
    same_rate = abs(phone.accel.rate_hz / rate_hz - 1.0) < SAME_RATE
    claims = _claims(phone, claimed, phone.accel.rate_hz if same_rate else None)
    raw = diagnosis_of(recording, name, claims)
    known = [e for e in phone.effects if observable(e)]
    bins = bins_of(recording)
    if not known or not len(bins):
        remaining = raw
    else:
        remaining = diagnosis_of(without_effects(recording, bins, phone, known), name, claims)
    findings = [f for f in raw.findings if f.effect.endswith(ON_SAMPLES)]
    findings += [f for f in remaining.findings if not f.effect.endswith(ON_SAMPLES)]
    new_findings = [f for f in findings if not _phone_has(phone, f)]
    explained = [f for f in raw.findings if not any(_same(f, g) for g in new_findings)]
    already_simulated = [{"effect": f.effect, "sensor": f.sensor, "why": f.statement} for f in explained]
    diagnosis = replace(raw, findings=new_findings, verdict=verdict_of(new_findings))
    only_simulated = _only_simulated(phone, raw, new_findings)
    if not same_rate:
        why = f"the phone file says {phone.accel.rate_hz:g} Hz, the recording has {rate_hz:.4g} Hz"
        only_simulated.append({"effect": "rate", "why": why})
    return PhoneJudgement(diagnosis, already_simulated, only_simulated, phone)


def _same(one: Finding, other: Finding) -> bool:
    return one.effect == other.effect and one.sensor == other.sensor


def _claims(phone: Phone, claimed: Claims, rate_hz: float | None) -> Claims:
    """Return the phone's own range, step and noise as claims, with a nominal rate and what else is told."""
    own: dict[str, float | None] = {}
    for name, sensor in (("accel", Sensor.ACCELEROMETER), ("gyro", Sensor.GYROSCOPE)):
        settings = phone.sensor(sensor)
        if settings is not None:
            own[f"{name}_range"] = settings.range
            own[f"{name}_lsb"] = settings.lsb or None
            own[f"{name}_noise_density"] = float(np.median(per_axis(settings.noise.white))) or None
    known = {k: v for k, v in own.items() if v is not None}
    return replace(replace(claimed, nominal_rate_hz=rate_hz), **known)


def without_effects(recording: Recording, bins: Bins, phone: Phone, known: Sequence[Effect]) -> Recording:
    """Return the recording without what the phone's observable effects add."""
    conditions = replace(conditions_of(bins), reference_c=phone.heat.reference_c)
    streams: list[Samples | None] = []
    for samples, sensor in (
        (recording.accelerometer, Sensor.ACCELEROMETER),
        (recording.gyroscope, Sensor.GYROSCOPE),
    ):
        if samples is None or not any(e.concerns(sensor) for e in known):
            streams.append(samples)
            continue
        moment = observed_moment(recording, samples.t, phone, conditions)
        rate_hz = median_rate_hz(samples)
        streams.append(
            replace(
                samples, xyz=frozen(samples.xyz - effects_output(known, sensor, moment, conditions, rate_hz))
            )
        )
    accelerometer = streams[0]
    assert accelerometer is not None
    return replace(recording, accelerometer=accelerometer, gyroscope=streams[1])


def observed_moment(recording: Recording, t: Array, phone: Phone, conditions: Conditions) -> Moment:
    """Return the true input at stamps (n,) s, from the readings by the phone's own affine model."""
    accel, gyro = recording.accelerometer, recording.gyroscope
    force = _true_values(t, accel, np.asarray(phone.accel.scale), np.asarray(phone.accel.bias))
    rate = np.zeros_like(force)
    if gyro is not None and phone.gyro is not None:
        rate = _true_values(t, gyro, np.asarray(phone.gyro.scale), np.asarray(phone.gyro.bias))
        rate = np.where(np.linalg.norm(rate, axis=1, keepdims=True) > SLOWEST, rate, 0.0)
    temperature = temperature_at(accel, t)
    warmth = np.zeros(t.size) if temperature is None else temperature - conditions.reference_c
    since = t - conditions.t_start
    dot = np.where(
        rate != 0.0, np.gradient(rate, np.maximum.accumulate(t + 1e-9 * np.arange(t.size)), axis=0), 0.0
    )
    return Moment(since, force, rate, dot, warmth, conditions.surroundings.charging.at(since))


def _true_values(t: Array, samples: Samples, scale: Array, bias: Array) -> Array:
    true = (samples.xyz - bias) @ np.linalg.inv(scale).T
    return interpolate(t, samples.t, true)


def _phone_has(phone: Phone, finding: Finding) -> bool:
    """Whether the phone already has a finding about samples or stamps, with parameters like those found."""
    if not finding.effect.endswith(ON_SAMPLES):
        return False
    own = _own_values(phone, finding)
    shared = [name for name in own if name in finding.parameters]
    return bool(shared) and all(_within(finding, name, own[name]) for name in shared)


def _own_values(phone: Phone, finding: Finding) -> dict[str, Any]:
    """Return the phone's own values of a finding's parameters, from its effects or settings."""
    for effect in phone.effects:
        if effect.name == finding.effect and getattr(effect, "sensor", finding.sensor) in (
            finding.sensor,
            "both",
        ):
            return {k: v for k, v in msgspec.structs.asdict(effect).items() if k != "sensor"}
    if finding.effect in SETTINGS:
        parameter, setting = SETTINGS[finding.effect]
        value = getattr(phone.effective_clock(), setting)
        return {parameter: value} if value else {}
    settings = phone.gyro if finding.sensor == "gyro" else phone.accel
    return {} if settings is None else _values_of_settings(settings).get(finding.effect, {})


def _values_of_settings(settings: SensorSettings) -> dict[str, dict[str, Any]]:
    """Return what a sensor's own settings say in the words of findings."""
    noise, white = settings.noise, per_axis(settings.noise.white)
    values: dict[str, dict[str, Any]] = {
        "noise_unequal_axes": {"ratio": (white / max(float(np.median(white)), 1e-300)).tolist()}
    }
    if settings.cutoff_hz is not None:
        values["bandwidth"] = {"cutoff": settings.cutoff_hz}
    if noise.tail_fraction > 0.0:
        values["noise_heavy_tailed"] = {"ratio": noise.tail_ratio, "fraction": noise.tail_fraction}
    return values


def _within(finding: Finding, name: str, own: Any) -> bool:
    """Whether the phone's value lies in the finding's interval, or within `NEAR` of its value."""
    parameter = finding.parameters[name]
    value = np.atleast_1d(np.asarray(parameter.value, dtype=np.float64))
    low, high = np.moveaxis(np.asarray(parameter.ci95, dtype=np.float64).reshape(*value.shape, 2), -1, 0)
    own_values = np.broadcast_to(np.asarray(own, dtype=np.float64), value.shape)
    tolerance = NEAR * np.abs(value).max()
    return bool(
        (
            (own_values >= np.minimum(low, value - tolerance))
            & (own_values <= np.maximum(high, value + tolerance))
        ).all()
    )


def _only_simulated(phone: Phone, raw: Diagnosis, new_findings: list[Finding]) -> list[dict[str, str]]:
    """Return the phone's effects on samples and stamps that the recording does not show."""
    shown = {f.effect for f in raw.findings} | {f.effect for f in new_findings}
    absent = [e for e in phone.effects if e.name.endswith(ON_SAMPLES) and e.name not in shown]
    absent = [e for e in absent if not e.name.endswith(("saturation", "quantisation", "noise_level"))]
    return [
        {"effect": e.name, "why": f"the phone file has {_settings_text(e)}, the recording does not show it"}
        for e in absent
    ]


def _settings_text(effect: Effect) -> str:
    parameters = {
        k: v
        for k, v in msgspec.structs.asdict(effect).items()
        if not (isinstance(v, float) and math.isinf(v))
    }
    return ", ".join(f"{k} = {v}" for k, v in parameters.items())
