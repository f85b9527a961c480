"""The thermometer withheld: the slow curve that the sensors share, beside the temperature that was hidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.replay.diagnosis.judged import bins_of
from stillcal.replay.real_data.sources import Source, without_thermometer

LEAST_BINS = 6
"""Fewer still bins than this have no curve."""


@dataclass(frozen=True, slots=True)
class Withheld:
    """One recording's comparison. span: K, of the withheld temperature over still bins.

    share: part of the channels' variance that the curve carries, of white channels about 1 / channels.
    correlation: with temperature. chance: part of its circular shifts that correlate as well. others: with
    other recordings' temperatures, stretched to this one's length.
    """

    name: str
    bins: int
    span: float
    share: float
    correlation: float
    chance: float
    others: tuple[float, ...]


def withheld(source: Source, others: list[Source]) -> Withheld | None:
    """Compare; None where too little lies still. What the curve is made of has no temperature in it."""
    measured, hidden = bins_of(source.recording), bins_of(without_thermometer(source.recording))
    if measured.temperature is None or len(hidden) < LEAST_BINS:
        return None
    curve, share = shared_curve(hidden)
    truth = measured.temperature
    own = correlation(curve, truth)
    shifts = [abs(correlation(curve, np.roll(truth, k))) for k in range(1, truth.size)]
    return Withheld(
        source.name,
        len(hidden),
        float(np.ptp(truth)),
        share,
        own,
        float(np.mean(np.array(shifts) >= abs(own))),
        tuple(correlation(curve, _stretched(o, truth.size)) for o in others),
    )


def shared_curve(bins: Bins) -> tuple[Array, float]:
    """Return the curve (n,) that the channels share most of, and its part of their variance, 0 of none.

    Channels are the rate, and the specific force about its rest's mean, in units of their white noise.
    """
    force = np.empty_like(bins.force)
    for rest in np.unique(bins.rest):
        rows = bins.rest == rest
        force[rows] = bins.force[rows] - bins.force[rows].mean(axis=0)
    channels = [force / np.sqrt(bins.force_variance)]
    if bins.rate is not None and bins.rate_variance is not None:
        channels.append((bins.rate - bins.rate.mean(axis=0)) / np.sqrt(bins.rate_variance))
    stacked = np.concatenate(channels, axis=1)
    u, s, _ = np.linalg.svd(stacked - stacked.mean(axis=0), full_matrices=False)
    whole = float((s**2).sum())
    return np.asarray(u[:, 0] * s[0]), float(s[0] ** 2) / whole if whole else 0.0


def correlation(a: Array, b: Array) -> float:
    """Return Pearson's correlation of two curves (n,); 0 where one does not move."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else 0.0


def _stretched(source: Source, size: int) -> Array:
    warm = source.recording.accelerometer.temperature
    assert warm is not None
    return np.interp(np.linspace(0.0, 1.0, size), np.linspace(0.0, 1.0, warm.size), warm)
