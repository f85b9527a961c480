"""Two recordings of one motion, each with the limits and low-passes of both, without held samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.vibrations import shared_streams
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Quantity
from stillcal.calib_core.diagnosis.direct.repeated_values import held_rows
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.motion.group_delay import UNSURE
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.sample_changes import clipped, low_passed
from stillcal.replay.formats.trace import Recording

MEAN_S, OFTEN = 5.0, 0.9
"""s of the means of which it is asked what a low-pass leaves unsure, and their quantile: many are at rest."""

NYQUIST = 0.49
"""Part of the sample rate above which no filter has a cutoff."""


@dataclass(frozen=True, slots=True, eq=False)
class AsBoth:
    """Two recordings with limits and low-passes of both, without held samples, so that the rest is judged.

    late: s, the standard error of what the low-passes delay; left: by sensor, up to what sd (3,) means in
    motion may differ by what their cutoffs are not known by.
    """

    recording: Recording
    simulation: Recording
    late: float
    left: Mapping[str, Array]


def as_both(
    both: tuple[Recording, Recording], exams: Sequence[Examination], low_passes: Sequence[Difference]
) -> AsBoth:
    """Make two recordings comparable. low_passes: those that differ."""
    limits = _limits(exams)
    limited = _limited(both[0], limits), _limited(both[1], limits)
    own = _filtered(limited[0], [d.simulated for d in low_passes])
    other = _filtered(limited[1], [d.recorded for d in low_passes])
    rate = 1.0 / sample_period(both[0].accelerometer.t)
    late = [unsure_delay(q, rate) for d in low_passes for q in (d.recorded, d.simulated) if not q.none]
    return AsBoth(*without_held_rows(own, other), max(late, default=0.0), _left(limited, low_passes))


def _left(both: tuple[Recording, Recording], low_passes: Sequence[Difference]) -> dict[str, Array]:
    """Return, by sensor, up to what sd (3,) means in motion differ by what cutoffs are not known by."""
    out: dict[str, Array] = {}
    for one in low_passes:
        for recording, found in zip(both, (one.simulated, one.recorded), strict=True):
            samples = recording.accelerometer if found.sensor == "accel" else recording.gyroscope
            if found.none or samples is None:
                continue
            unsure = replace(found, value=found.value + NORMAL_95 * found.sigma)
            apart = low_passed(samples, unsure).xyz - low_passed(samples, found).xyz
            means = _means(apart, max(round(MEAN_S / sample_period(samples.t)), 1))
            sd = np.sqrt(np.quantile(means**2, OFTEN, axis=0))
            out[found.sensor] = np.hypot(out.get(found.sensor, np.zeros(3)), sd)
    return out


def _means(xyz: Array, size: int) -> Array:
    """Return the means (k, 3) of every `size` of some values (n, 3), of all where they are fewer."""
    size = min(size, len(xyz))
    return np.asarray(xyz[: len(xyz) // size * size].reshape(-1, size, 3).mean(axis=1))


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


def without_held_rows(recording: Recording, simulation: Recording) -> tuple[Recording, Recording]:
    """Return both without the samples that they hold: such a one reads the motion of a moment before.

    The recording lacks those that the simulation holds as well.
    """
    for sensor, (own, other) in shared_streams(recording, simulation).items():
        held = held_rows(own), held_rows(other)
        recording = _changed(recording, sensor, partial(Samples.where, kept=~(held[0] | held[1])))
        simulation = _changed(simulation, sensor, partial(Samples.where, kept=~held[1]))
    return recording, simulation
