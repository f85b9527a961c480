"""Rotation segments: the gyroscope's samples between two rests, together with the two rests.

Forces and rates stay raw, so that a segment serves any accelerometer model fitted later. Segments are cut and
refused here; estimation from them is in fit.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.maths import rotation
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Samples

MOST_LOST = 5e-4
"""rad (0.03 degrees) by which a thinned segment may differ: a third of what real turns leave unexplained."""

_LEAST_SAMPLES = 32

_USUAL_GAP = 1.5  # median steps between samples; a longer one lacks a sample


class NoSegment(StrEnum):
    """Why two rests and the samples between them make no rotation segment."""

    DISORDERED = "the second rest does not follow the first"
    NO_RATES = "a rest has no gyroscope mean to take the bias from"
    NOT_COVERED = "the gyroscope's samples do not reach from rest to rest"
    GAP = "a gap in the gyroscope's samples"
    TOO_LONG = "too long between the rests"
    TOO_SMALL = "the phone hardly turned"
    UNDERSAMPLED = "the phone turned too fast for the gyroscope's sampling rate"


@dataclass(frozen=True, slots=True)
class RotationSegmentSettings:
    """How rotation segments are cut.

    margin: s, how far into each rest the integration reaches (at most half the rest). max_duration: s, the
    longest segment; in a longer one drift outweighs the rotation. max_gap: s, the longest step between two
    samples, or one and a half of their median step where that is longer. min_angle: rad, the least excursion
    of the integrated rate. max_error: rad, the largest error of the integration itself.
    """

    margin: float = 0.1
    max_duration: float = 60.0
    max_gap: float = 0.1
    min_angle: float = 0.35
    max_error: float = 0.05

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin <= 5.0:
            raise ValueError(f"margin is {self.margin} s: allowed are 0 to 5")
        for name in ("max_duration", "max_gap", "min_angle", "max_error"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} is {getattr(self, name)}: it must be above 0")


@dataclass(frozen=True, slots=True, eq=False)
class RotationSegment:
    """The gyroscope between two rests, from within the first into the second.

    before, after: the rests. t: (n,) s. rates: (n, 3) raw rad/s. thinnest: whether half of the samples are
    known to lose too much.
    """

    before: RestState
    after: RestState
    t: Array
    rates: Array
    thinnest: bool = False

    @property
    def t_start(self) -> float:
        """Stamp of the first sample, within the first rest, s."""
        return float(self.t[0])

    @property
    def t_end(self) -> float:
        """Stamp of the last sample, within the second rest, s."""
        return float(self.t[-1])

    def halved(self) -> RotationSegment:
        """Return the segment with every second sample, smoothed; as the thinnest where that loses too much.

        The trapezoidal sum of the rates stays the same, so a turn about one axis keeps its angle. Where the
        axis changes, the whole may differ by MOST_LOST.
        """
        assert self.before.rate is not None and self.after.rate is not None
        keep = np.append(np.arange(0, self.t.size - 1, 2), self.t.size - 1)
        smooth = self.rates.copy()
        smooth[1:-1] = 0.25 * self.rates[:-2] + 0.5 * self.rates[1:-1] + 0.25 * self.rates[2:]
        t, rates, bias = self.t[keep], smooth[keep], 0.5 * (self.before.rate + self.after.rate)
        if t.size < _LEAST_SAMPLES or _apart(self.t, self.rates - bias, t, rates - bias) > MOST_LOST:
            return replace(self, thinnest=True)
        return RotationSegment(self.before, self.after, frozen(t), frozen(rates))


def cut_rotation_segment(
    before: RestState, after: RestState, gyro: Samples, settings: RotationSegmentSettings | None = None
) -> RotationSegment | NoSegment:
    """Cut the rotation segment between two successive rests out of `gyro`, or say why there is none.

    gyro: raw samples that reach at least from the end of `before` to the start of `after`; others are
    ignored. The segment begins within the first rest and ends within the second, so that the direction of
    gravity at either end is that of the rest.
    """
    settings = settings or RotationSegmentSettings()
    if after.t_start < before.t_end:
        return NoSegment.DISORDERED
    if before.rate is None or after.rate is None:
        return NoSegment.NO_RATES
    t_start = before.t_end - min(settings.margin, 0.5 * before.duration)
    t_end = after.t_start + min(settings.margin, 0.5 * after.duration)
    if t_end - t_start > settings.max_duration:
        return NoSegment.TOO_LONG
    span = gyro.between(t_start, np.nextafter(t_end, np.inf))
    refusal = _refusal(span, before, after, settings)
    return refusal or RotationSegment(before, after, np.array(span.t), np.array(span.xyz))


def excursion(t: Array, rates: Array) -> float:
    """Return the largest angle, rad, of the integral of rates (n, 3), rad/s, at t (n,), s, from its start."""
    angle = np.cumsum(np.diff(t)[:, None] * 0.5 * (rates[1:] + rates[:-1]), axis=0)
    return float(np.sqrt((angle**2).sum(axis=1).max(initial=0.0)))


def integration_error(t: Array, rates: Array) -> float:
    """Estimate the error (rad) of the rotation integrated from rates (n, 3), rad/s, at t (n,), s.

    The rotation from every second sample is compared with that from all: for an integration of fourth order
    (maths/rotation.py) the latter is fifteen times closer to the truth (Richardson extrapolation).
    """
    half = np.append(np.arange(0, t.size - 1, 2), t.size - 1)
    return _apart(t, rates, t[half], rates[half]) / 15.0


def _apart(t: Array, rates: Array, other_t: Array, other_rates: Array) -> float:
    """Return the angle (rad) between the rotations of two runs of samples, at t in s, in rad/s."""
    apart = rotation.rotation(t, rates) @ rotation.rotation(other_t, other_rates).T
    return float(np.arccos(np.clip(0.5 * (np.trace(apart) - 1.0), -1.0, 1.0)))


def _refusal(
    span: Samples, before: RestState, after: RestState, settings: RotationSegmentSettings
) -> NoSegment | None:
    """Return why the samples between two rests make no segment, or None where they do."""
    if len(span) < 3:
        return NoSegment.NOT_COVERED
    steps = np.diff(span.t)
    gap = max(settings.max_gap, _USUAL_GAP * float(np.median(steps)))
    if span.t[0] > before.t_end + gap or span.t[-1] < after.t_start - gap:
        return NoSegment.NOT_COVERED
    if steps.max() > gap:
        return NoSegment.GAP
    assert before.rate is not None and after.rate is not None
    rates = span.xyz - 0.5 * (before.rate + after.rate)
    if excursion(span.t, rates) < settings.min_angle:
        return NoSegment.TOO_SMALL
    return NoSegment.UNDERSAMPLED if integration_error(span.t, rates) > settings.max_error else None
