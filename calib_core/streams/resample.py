"""Samples at other times: the median rate, linear interpolation, and the temperature at a moment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.samples import Samples

GAP = 3.0
"""Usual intervals without a sample from where on a spline swings too wide."""


def median_rate_hz(samples: Samples) -> float:
    """Return the samples a second by the median interval; 0 with fewer than two samples."""
    return 1.0 / float(np.median(np.diff(samples.t))) if len(samples) > 1 else 0.0


def interpolate(t: Array, known: Array, values: Array) -> Array:
    """Return values (k, 3) at times `known` (k,) s, interpolated linearly at t (n,) s; shape (n, 3).

    Before the first and after the last time, the first and last value hold.
    """
    if t.size:
        # Only what is about t: numpy copies all that it interpolates in.
        first = int(np.searchsorted(known, t.min(), side="left"))
        near = slice(max(first - 1, 0), int(np.searchsorted(known, t.max(), side="right")) + 1)
        known, values = known[near], values[near]
    return np.stack([np.interp(t, known, values[:, axis]) for axis in range(3)], axis=1)


def read_later(samples: Samples, delay: float | Array, t: Array | None = None) -> Samples:
    """Return samples that read at the same times what was true `delay` s earlier; (3,) for each axis its own.

    t: the times (n,) s, if not their own; without temperature and times of arrival then.

    By a cubic spline: a straight line between two samples would take 1 % off a step's fifth overtone.
    """
    at = samples.t if t is None else t
    by_axis = [read_at(samples, at - late).xyz for late in np.ravel(delay)]
    xyz = by_axis[0] if len(by_axis) == 1 else np.stack([x[:, a] for a, x in enumerate(by_axis)], axis=1)
    return replace(samples, xyz=frozen(xyz)) if t is None else Samples(samples.sensor, frozen(t), frozen(xyz))


def read_at(samples: Samples, t: Array) -> Samples:
    """Return samples, stamped t (n,) s, of what was read then, by a cubic spline.

    Across a gap of `GAP` usual intervals it is a straight line. Before the first and after the last sample,
    the first and last value hold. Temperature and times of arrival are left out.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - the daemon stays light

    known, first = np.unique(samples.t, return_index=True)
    values, steps = samples.xyz[first], np.diff(known)
    xyz = CubicSpline(known, values)(np.clip(t, known[0], known[-1]))
    gap = (steps > GAP * np.median(steps))[np.clip(np.searchsorted(known, t) - 1, 0, steps.size - 1)]
    xyz[gap] = interpolate(t[gap], known, values)
    return Samples(samples.sensor, frozen(t), frozen(xyz))


def means_over(samples: Samples, step: float) -> Samples:
    """Return the means of readings over `step` s each, one beside the other, stamped by their middle.

    Between samples the readings are taken for straight lines. No samples where they are shorter than a step.
    """
    t, first = np.unique(samples.t, return_index=True)
    xyz = samples.xyz[first]
    rises = np.diff(t)[:, None] * (xyz[1:] + xyz[:-1]) / 2.0
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(rises, axis=0)])
    edges = t[0] + step * np.arange(int((t[-1] - t[0]) / step) + 1)
    means = np.diff(interpolate(edges, t, total), axis=0) / step
    return Samples(samples.sensor, frozen(edges[:-1] + step / 2.0), frozen(means))


def temperature_at(samples: Samples, t: Array) -> Array | None:
    """Return the temperature at t (n,) s, degC, interpolated linearly; None where none is known."""
    if samples.temperature is None:
        return None
    known = np.isfinite(samples.temperature)
    if not known.any():
        return None
    return np.interp(t, samples.t[known], samples.temperature[known])
