"""The phone file: constant errors and noise measured on a recording, with the effects found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.direct import stamps_as_compared
from stillcal.calib_core.diagnosis.comparison.sample_rate import rate as counted_rate
from stillcal.calib_core.diagnosis.model.earth import ground, shared_rate
from stillcal.calib_core.diagnosis.noise.low_pass import quiet
from stillcal.calib_core.diagnosis.noise.noise_level import density
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.value_grid import comb_step
from stillcal.calib_core.noise.allan import FLOOR
from stillcal.calib_core.noise.covariance import NoiseModel, fit_noise
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.phone.phone_effects import MappedFinding
from stillcal.replay.diagnosis.phone.twin import AffinePhone, Conditions
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.effects.base import Effect
from stillcal.replay.phone.effects.on_input import VibrationTone
from stillcal.replay.phone.phone import Claims, Phone, dump_phone
from stillcal.replay.phone.settings import (
    ClockSettings,
    HeatSettings,
    Matrix,
    Noise,
    SensorSettings,
    Vector,
    Wandering,
)

LEAST_BINS = 8
"""Fewer static bins than this show no slow noise."""

MOST_BINS = 48
"""Slow noise is fitted to at most this many bins; with more, neighbours in a rest are merged."""

TAUS = (240.0,)
"""Correlation times of the Gauss-Markov part that are tried, s."""


def phone_of(
    recording: Recording,
    bins: Bins,
    effects: Sequence[Effect],
    affine: AffinePhone,
    *,
    conditions: Conditions,
    gravity: float,
) -> Phone:
    """Return the phone that would have made the recording, as far as it shows. bins: at least one."""
    wander = _force_wander(bins, affine, gravity)
    return Phone(
        description=f"{recording.claims.device or 'a phone'}, as a recording shows it",
        accel=_sensor(
            recording.accelerometer,
            bins,
            effects,
            bias=affine.baseline.bias,
            scale=np.asarray(np.linalg.inv(affine.baseline.scale), dtype=np.float64),
            slow=[wander] * 3,
            limit=recording.claims.accel_range,
            claimed=recording.claims.accel_noise_density,
        ),
        gyro=_gyroscope(recording, bins, effects, affine),
        clock=_clock(recording, effects),
        heat=_heat(recording.accelerometer, conditions),
        claims=_claims(recording),
        effects=tuple(effects),  # type: ignore[arg-type]  # every member of the registry
    )


def _clock(recording: Recording, effects: Sequence[Effect]) -> ClockSettings:
    """Return the stamps' clock, with their scatter, losses and bursts unless effects have these."""
    names = {e.name for e in effects}
    seen = stamps_as_compared(recording.accelerometer)
    return ClockSettings(
        shared=_same_stamps(recording.accelerometer, recording.gyroscope),
        jitter_s=0.0 if "timestamp_jitter" in names else float(f"{seen.jitter_s:.4g}"),
        drop_fraction=0.0 if "dropped_samples" in names else float(f"{seen.missing:.3g}"),
        burst_fraction=0.0 if "arrival_bursts" in names else float(f"{seen.bursts:.3g}"),
    )


def sample_rate(samples: Samples) -> float:
    """Return the rate, Hz, at which samples were taken, those that are missing among them."""
    return float(np.exp(counted_rate(samples).value[0]))


def _claims(recording: Recording) -> Claims:
    """Return the maker's claims; a phone takes missing ones from its settings."""
    return msgspec.convert(msgspec.to_builtins(recording.claims.without_counts()), Claims)


def _gyroscope(
    recording: Recording, bins: Bins, effects: Sequence[Effect], affine: AffinePhone
) -> SensorSettings | None:
    samples = recording.gyroscope
    if samples is None:
        return None
    slow: list[NoiseModel | None] = [None] * 3
    bias = affine.rate_bias
    if bins.rate is not None:
        # What walks has no mean: a simulated walk sets out from where the recorded one did.
        bias = (bins.rate - affine.gyro)[0] if _walks(samples, effects) else bias
        up = affine.baseline.up
        earth = shared_rate(up, ground(samples, bins, up))
        slow = [_wander(bins, bins.rate[:, a] - affine.gyro[:, a], earth[:, a]) for a in range(3)]
    return _sensor(
        samples,
        bins,
        effects,
        bias=bias,
        scale=np.asarray(np.linalg.inv(affine.rate_mapping)),
        slow=slow,
        limit=recording.claims.gyro_range,
        claimed=recording.claims.gyro_noise_density,
    )


def _sensor(
    samples: Samples,
    bins: Bins,
    effects: Sequence[Effect],
    *,
    bias: Array,
    scale: Array,
    slow: Sequence[NoiseModel | None],
    limit: float | None,
    claimed: float | None,
) -> SensorSettings:
    rate = sample_rate(samples)
    steps = [s for s in (comb_step(samples.xyz[:, a]) for a in range(3)) if s is not None]
    coarse = any(e.name.endswith("quantisation") and e.concerns(samples.sensor) for e in effects)
    # Noise below a coarse step cannot be measured: only the maker's claim is left.
    rounding = max([0.0, *steps]) ** 2 / (6.0 * rate)
    level = np.full(3, claimed) if coarse and claimed else _density(samples, bins, effects, rounding)
    lsb = float(np.median(steps)) if steps and not coarse else 0.0
    return SensorSettings(
        rate_hz=round(rate, 6),
        bias=_vector(bias),
        scale=_matrix(scale),
        # What wanders is the walk, where one was found: other slow noise fitted to it would come on top.
        noise=_noise(samples, effects, level, [None] * 3 if _walks(samples, effects) else slow),
        lsb=lsb,
        range=limit,
    )


def _noise(
    samples: Samples,
    effects: Sequence[Effect],
    level: Array,
    slow: Sequence[NoiseModel | None],
) -> Noise:
    """Return the noise that, with the effects on it, has the measured density `level` (3,)."""
    white = level / np.sqrt(_tail_power(samples, effects))
    known = [m or NoiseModel(0.0) for m in slow]
    sigma = [m.gauss_markov for m in known]
    taus = [m.tau for m, s in zip(known, sigma, strict=True) if s > 0.0]
    wandering = Wandering(sigma=_vector(np.array(sigma)), tau_s=float(np.median(taus))) if taus else None
    return Noise(
        white=_vector(white),
        flicker=_vector(np.array([m.flicker for m in known]) / FLOOR),
        gauss_markov=() if wandering is None else (wandering,),
        random_walk=_vector(np.array([m.walk for m in known])),
    )


def _walks(samples: Samples, effects: Sequence[Effect]) -> bool:
    """Whether a random walk of the sensor's bias is among the effects."""
    return any(e.name.endswith("bias_random_walk") and e.concerns(samples.sensor) for e in effects)


def _density(samples: Samples, bins: Bins, effects: Sequence[Effect], rounding: float) -> Array:
    """Return the density (3,) of single samples' noise inside rests, below any cutoff; 0 without rests.

    Below a low cutoff are few frequencies: a vibration would be most of their noise. rounding: what the step
    of the values adds to its square.
    """
    tones = [e for e in effects if isinstance(e, VibrationTone) and e.concerns(samples.sensor)]
    still = quiet(samples, bins, [e.frequency for e in tones])
    if len(still.pieces) < 3:
        return np.zeros(3)
    return density(still, rounding)


def _tail_power(samples: Samples, effects: Sequence[Effect]) -> float:
    """Return by how much heavy tails raise the power of the noise."""
    for effect in effects:
        if effect.name == "noise_heavy_tailed" and effect.concerns(samples.sensor):
            settings = msgspec.to_builtins(effect)
            return 1.0 + float(settings.get("fraction", 0.02)) * (float(settings["ratio"]) ** 2 - 1.0)
    return 1.0


def _force_wander(bins: Bins, affine: AffinePhone, gravity: float) -> NoiseModel | None:
    """Return the slow noise of gravity's norm, assumed equal on the axes.

    Bias and scale were fitted to the same norm, and took in what wanders in their directions.
    """
    up, scale = affine.baseline.up, affine.baseline.scale
    corrected = (bins.force - affine.accel - affine.baseline.bias) @ scale.T
    products = up[:, [0, 1, 2, 0, 0, 1]] * up[:, [0, 1, 2, 1, 2, 2]]
    return _wander(bins, np.einsum("na,na->n", up, corrected) - gravity, np.hstack([up, products]))


def _wander(bins: Bins, values: Array, free: Array) -> NoiseModel | None:
    """Fit coloured noise to residuals (n,) of the bins, a few neighbours together where there are many.

    free: (n, p), what else may be in them. None where there is too little beside it.
    """
    group_size = max(1, round(len(bins) / MOST_BINS))
    cuts = np.flatnonzero((np.arange(len(bins)) % group_size == 0) | (np.diff(bins.rest, prepend=-1) != 0))
    weight = np.add.reduceat(bins.duration, cuts)
    t, value, *columns = (
        np.add.reduceat(x * bins.duration, cuts) / weight for x in (bins.t, values, *free.T)
    )
    if t.size - np.linalg.matrix_rank(free) < LEAST_BINS:
        return None
    return _bounded(fit_noise(t, weight, value, TAUS, np.stack(columns, axis=1)), bins, values)


def _bounded(model: NoiseModel, bins: Bins, values: Array) -> NoiseModel:
    """Return the model with its slow noise bounded by the difference of neighbouring bins of one rest.

    Flicker noise changes as much between neighbours as over any time. A residual that changes more between
    rests than inside them is therefore not flicker noise.
    """
    inside = np.diff(bins.rest) == 0
    if inside.sum() < LEAST_BINS:
        return model
    step = float(np.sqrt(np.mean(np.diff(values)[inside] ** 2) / 2.0))
    decay = 1.0 - np.exp(-float(np.median(bins.duration)) / model.tau)
    return replace(
        model,
        flicker=min(model.flicker, step),
        gauss_markov=min(model.gauss_markov, step / float(np.sqrt(decay))),
        walk=min(model.walk, step / float(np.sqrt(np.median(bins.duration)))),
    )


def _same_stamps(one: Samples, other: Samples | None) -> bool:
    return other is None or bool(np.array_equal(one.t, other.t))


def _heat(samples: Samples, conditions: Conditions) -> HeatSettings:
    warm = samples.temperature
    known = np.empty(0) if warm is None else warm[np.isfinite(warm)]
    step = comb_step(known) if known.size else None
    return HeatSettings(
        reference_c=conditions.reference_c, thermometer=bool(known.size), thermometer_lsb_c=step or 0.0
    )


def _vector(values: Array) -> Vector:
    x, y, z = (float(f"{v:.6g}") for v in values)
    return (x, y, z)


def _matrix(values: Array) -> Matrix:
    x, y, z = (_vector(row) for row in values)
    return (x, y, z)


def phone_text(phone: Phone, mapped: Sequence[MappedFinding], name: str) -> str:
    """Return the phone as TOML; findings that have no effect in a phone file become comments."""
    lines = [f"# A phone with the errors of {name}, measured by `stillcal diagnose`; see docs/report.md."]
    for m in mapped:
        if m.effect is None:
            lines += [f"# Not in this file: {m.finding.effect} ({m.finding.sensor}): {m.why}."]
            lines += [f"#   {m.finding.statement}"]
    plain = [" ".join(line.split()) for line in lines]
    return "\n".join(plain) + "\n" + dump_phone(phone)
