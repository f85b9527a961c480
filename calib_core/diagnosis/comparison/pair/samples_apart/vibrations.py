"""Vibrations of two recordings of one motion: those of the motion itself are alike in both.

What the one reads less the other holds no motion. So it tells a vibration of one of the two where neither has
rests to show it, and that a vibration which one of them alone seems to have shakes both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.stated import Sole
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.noise.lines.line import TONE, middle_hz, reach_hz
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import AtRest, tones
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.maths.sines import without_vibrations
from stillcal.calib_core.streams.samples import Samples

IN_MOTION = "motion"
"""Driver of what two recordings of one motion show against each other."""

NOTHING = 1e-9
"""Part of the largest reading that is as good as none: rounding of double precision leaves less."""

STRETCH = 5.0
"""s of the stretches in which a vibration's power is compared."""

OWN, AROUND = 2, 8
"""Frequencies on either side of a line that have its power, and that have none of it."""

SHARED = 0.25
"""Part of a vibration's power below which there is none of it: half of its size."""


class BothSensors(Protocol):
    """What holds the samples of two sensors, a recording or an examination of one."""

    @property
    def accelerometer(self) -> Samples:
        """The accelerometer's samples."""

    @property
    def gyroscope(self) -> Samples | None:
        """The gyroscope's; None without one."""


def shared_streams(one: BothSensors, other: BothSensors) -> dict[str, tuple[Samples, Samples]]:
    """Return the samples of both by the name of each sensor that both have."""
    shared = {"accel": (one.accelerometer, other.accelerometer)}
    if one.gyroscope is not None and other.gyroscope is not None:
        shared["gyro"] = one.gyroscope, other.gyroscope
    return shared


def sample_by_sample(exams: tuple[Examination, Examination]) -> dict[str, tuple[Samples, Samples]]:
    """Return the samples of both by sensor, of those that both have as many of."""
    return {s: both for s, both in shared_streams(*exams).items() if len(both[0]) == len(both[1])}


def shakes_both(line: Finding, exams: tuple[Examination, Examination]) -> bool:
    """Whether a vibration that one of the two is told to have is one of the motion that both read."""
    both = sample_by_sample(exams).get(line.sensor)
    if both is None:
        return False
    apart = _power(line, both[0], _less(*both))
    return apart < SHARED * min(_power(line, both[0], one.xyz) for one in both)


def of_the_difference(
    exams: tuple[Examination, Examination], sensor: str, known: Sequence[float]
) -> tuple[list[Sole], list[Finding]] | None:
    """Return the steady vibrations of a sensor in what one reads less the other, with whose they are.

    Those that both read are returned beside them: they have another phase or size in the other, or one of the
    two reads a vibration of the motion late or behind a filter. known: Hz, of those that are taken off
    before. None where they cannot be told.
    """
    both = sample_by_sample(exams).get(sensor)
    if both is None:
        return None
    first, second = both
    apart = _less(first, second)
    if not (apart.std(axis=0) > NOTHING * np.abs(first.xyz).max()).all():
        return None
    left = replace(first, xyz=frozen(without_vibrations(apart, first.t, known)))
    rests = AtRest.of(left, sensor)
    if rests.coherent is None:
        return None
    alone, of_both = list[Sole](), list[Finding]()
    for line in tones(left, sensor, rests):
        if line.effect != TONE:
            continue
        told = replace(line, where=replace(line.where, driver=IN_MOTION))
        own, other, less = (_power(line, first, xyz, np.inf) for xyz in (first.xyz, second.xyz, apart))
        if min(own, other) > SHARED * min(less, max(own, other)):
            of_both.append(told)
        else:
            alone.append((told, own > other))
    return alone, of_both


def _less(first: Samples, second: Samples) -> Array:
    """Return what one sensor reads less what the other does, with the bias and the scale that fit best."""
    columns = np.column_stack([np.ones(len(second)), second.xyz])
    return np.asarray(first.xyz - columns @ np.linalg.lstsq(columns, first.xyz, rcond=None)[0])


def _power(line: Finding, samples: Samples, xyz: Array, stretch: float = STRETCH) -> float:
    """Return the power of a line, while it lasts, above what is about it. xyz: (n, 3), at the stamps.

    stretch: s, the longer it is the less of motion is about a line that keeps its phase.
    """
    period = sample_period(samples.t)
    rows = (samples.t >= line.where.t_start) & (samples.t <= line.where.t_end)
    size = int(min(stretch / period, float(rows.sum())))
    if size <= 2 * AROUND:
        return 0.0
    cut = xyz[rows][: rows.sum() // size * size].reshape(-1, size, 3)
    power = (
        np.abs(np.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * np.hanning(size)[:, None], axis=1)) ** 2
    )
    whole, f = power.sum(axis=(0, 2)), np.fft.rfftfreq(size, period)
    away = np.abs(f - middle_hz(line)) - reach_hz(line)
    own, about = away < OWN * f[1], (away >= OWN * f[1]) & (away < AROUND * f[1])
    return float((whole[own] - whole[about].mean()).sum()) if own.any() and about.any() else 0.0
