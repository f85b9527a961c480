"""What the values themselves say: the step they come in, and where they stop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.left_out import blocks, of_counts, rms
from stillcal.calib_core.diagnosis.model.measurement import Seen, direct_finding
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.segments.value_grid import COMB_SAMPLES, UNIT, comb_step
from stillcal.calib_core.streams.samples import Samples

LEAST_LIMIT = {"accel": 11.3, "gyro": 0.5}
PRINTED = 0.5
DITHERED = 2.2
HIDDEN = 3.5
HARMONICS = 8
USUAL = {
    "accel": 9.80665 * 2.0 ** np.arange(1, 5) / 32768.0,
    "gyro": np.deg2rad(np.outer([125.0 / 32768.0, 4.375e-3], 2.0 ** np.arange(5))).ravel(),
}
"""Steps of 16 bits at the usual ranges, 2 to 16 g and 125 to 2000 deg/s (Bosch BMI160, TDK ICM-20948), and
STMicroelectronics' sensitivities (LSM6DSO)."""
LIKE = 3e-3


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The step that values of a sensor come in by axis, 0 for none seen: (3,). sd.

    (3,) of samples at rest.
    """

    step: Array
    sd: Array

    @property
    def largest(self) -> float:
        """The coarsest of the steps."""
        return float(self.step.max())

    def over_noise(self) -> float:
        """Return the coarsest step over the noise beneath it."""
        noise = np.sqrt(np.maximum(self.sd**2 - self.step**2 / 12.0, 0.0))
        return float((self.step / np.maximum(noise, 1e-300)).max())

    def blurs_level(self) -> bool:
        """Whether variance is no longer that of the noise and step^2 / 12.

        Up to 2.2 standard deviations it is, to some per cent (Widrow's condition, first harmonic
        exp(-2 pi^2 sd^2 / step^2) < 2 %).
        """
        return self.over_noise() > DITHERED

    def hides_noise(self) -> bool:
        """Whether the noise does not even dither the steps, so that its spectrum cannot be seen."""
        return self.over_noise() > HIDDEN

    def mean_error(self) -> Array:
        """Return the rms error (3,) that steps leave in the mean of a rest: no time averages it away."""
        noise = np.sqrt(np.maximum(self.sd**2 - self.step**2 / 12.0, 0.0))
        k = np.arange(1, HARMONICS + 1)[:, None]
        fading = np.exp(-2.0 * (np.pi * k * noise / np.maximum(self.step, 1e-300)) ** 2)
        return np.asarray(self.step * np.sqrt(0.5 * ((fading / (np.pi * k)) ** 2).sum(axis=0)))


def steps(samples: Samples, sd: Array) -> Steps:
    """Measure the steps of one sensor; sd: (3,) of its samples at rest."""
    return Steps(np.array([comb_step(samples.xyz[:, a]) or 0.0 for a in range(3)]), sd)


def quantisation(samples: Samples, sensor: str, seen: Steps, lsb: float | None) -> Finding | None:
    """Find a step coarser than the declared one, or, where none is declared, than the noise.

    A power of ten is how values are printed, and no finding unless it is half of the noise. The step of 16
    bits at a usual range is one as soon as it does more to the values than to add to their variance.
    """
    limit = [1.5 * lsb if lsb else float(seen.sd[a]) for a in range(3)]
    axes = [
        a
        for a in range(3)
        if seen.step[a] > limit[a]
        and not (_power_of_ten(seen.step[a]) and seen.step[a] < PRINTED * seen.sd[a])
        and (lsb or seen.blurs_level() or not _usual(seen.step[a], sensor))
    ]
    if not axes:
        return None
    step = float(np.median(seen.step[axes]))
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), "value")
    half = max(step * 1e-3, 1e-7)
    size = f"{step:.4g} {UNIT[sensor]}"
    say = f"The {NAME[sensor]}'s values come in steps of {size}, coarser than declared or than its noise."
    parameter = {"step": Parameter(step, [step - half, step + half], UNIT[sensor])}
    evidence = _on_grid(samples.xyz[:, axes[0]])
    return direct_finding(
        f"{sensor}_quantisation", sensor, axes, where, parameter, statement=say, seen=evidence
    )


def _power_of_ten(step: float) -> bool:
    return bool(abs(np.log10(step) - np.rint(np.log10(step))) < 1e-3)


def _usual(step: float, sensor: str) -> bool:
    return bool(np.abs(step / USUAL[sensor] - 1.0).min() < LIKE)


def _on_grid(values: Array) -> Seen:
    """Predict values left out: on the grid of the others, or anywhere."""
    thin = values[:: max(1, values.size // COMB_SAMPLES)]
    fold, gain, before, after = blocks(thin.size), 0.0, [], []
    for k in np.unique(fold):
        train, test = thin[fold != k], thin[fold == k]
        step = comb_step(train)
        if step is None:
            continue
        phase = float(np.angle(np.exp(2j * np.pi * train / step).mean())) / (2.0 * np.pi)
        off = test / step - phase
        off = off - np.rint(off)
        width = float(np.clip(4.0 * rms(train / step - phase - np.rint(train / step - phase)), 1e-3, 1.0))
        inside = np.asarray(np.abs(off) < width / 2.0)
        gain += float(inside.sum() * np.log(0.999 / width) + (~inside).sum() * np.log(1e-3))
        before.append(step / np.sqrt(12.0))
        after.append(step * rms(off))
    return Seen(30.0, gain, rms(np.array(before)), rms(np.array(after)))


def saturation(samples: Samples, sensor: str, noise: Array, declared: float | None) -> Finding | None:
    """Find a value short of the declared range that nothing exceeds and on which samples pile up."""
    size = np.abs(samples.xyz)
    flat = {
        a: _hard_stop(samples.xyz[:, a], float(noise[a]))
        or _flat_top(size[:, a], float(noise[a]), LEAST_LIMIT[sensor])
        for a in range(3)
    }
    tops = {a: t for a, t in flat.items() if t is not None and (not declared or t[0] < 0.97 * declared)}
    if not tops:
        return None
    axes = list(tops)
    limit = float(np.median([t[0] for t in tops.values()]))
    error = max([1e-4 * limit, *(t[1] for t in tops.values())])
    width = 4.0 * error + 4.0 * noise[axes]
    on = np.asarray((size[:, axes] > limit - width).any(axis=1), dtype=np.bool_)
    rows = np.flatnonzero(on)
    where = Where(float(samples.t[rows[0]]), float(samples.t[rows[-1]]), (0.0, 0.0), "own input")
    share = rows.size / size.shape[0]
    faster = "larger acceleration" if sensor == "accel" else "faster rotation"
    say = (
        f"The {NAME[sensor]} saturates at {limit:.4g} {UNIT[sensor]} ({rows.size} samples, {share:.2%});"
        f" {faster} is clipped."
    )
    parameter = {"limit": Parameter(limit, [limit - 1.96 * error, limit + 1.96 * error], UNIT[sensor])}
    near = (size[:, axes] > limit - 3.0 * width).any(axis=1)
    parts = [p for p in np.array_split(np.flatnonzero(near), 40) if p.size]
    hits, of = np.array([float(on[p].sum()) for p in parts]), np.array([float(p.size) for p in parts])
    seen = of_counts(hits, of, 0.5, 30.0)
    return direct_finding(f"{sensor}_saturation", sensor, axes, where, parameter, statement=say, seen=seen)


MOST_PILED = 0.5
"""Part of the samples above which what they lie on is no limit, but a width taken from what was no rest."""

LEAST_LEVELS = 5
"""Different values that must lie within three standard deviations below a limit."""


def _hard_stop(values: Array, noise: float) -> tuple[float, float] | None:
    """Return limit and its error where samples lie on the very largest value, of either sign, time and again.

    Clipped after its noise, a sensor returns one value; noise would have spread over the steps below it. Only
    where steps are finer than the noise, so that no rest ends on the largest value by itself.
    """
    step = comb_step(values) or 0.0
    found = []
    for signed in (values, -values):
        top = float(signed.max())
        width = max(1e-6 * abs(top), 0.1 * step)
        on = signed >= top - width
        under = signed[(signed > top - 3.0 * noise) & ~on]
        below, runs = under.size, int((on[1:] & ~on[:-1]).sum())
        # Values of few levels end on their highest by themselves, evenly spaced or not.
        if np.unique(under).size < LEAST_LEVELS:
            continue
        # By chance on the top step, or, where there are no steps, within `width` of the top of a sine.
        share = step / (3.0 * noise) if step else np.sqrt(width / (3.0 * noise))
        if on.sum() >= max(thresholds.LEAST_PILE, 5.0 * (below * share + 1.0)) and runs >= 3:
            found.append(abs(top))
    if not found or step > noise:
        return None
    return max(found), max(step / np.sqrt(12.0), 1e-6 * max(found))


def _flat_top(size: Array, noise: float, least: float) -> tuple[float, float] | None:
    """Return limit and its standard error where the largest values pile up as no motion would make them."""
    top = float(size.max())
    width = max(4.0 * noise, 1e-4 * top)
    if top < least:
        return None
    pile = size > top - 2.0 * width
    below = int(((size > top - 6.0 * width) & ~pile).sum())
    runs = int((pile[1:] & pile[:-1]).sum())
    few = pile.sum() < thresholds.LEAST_PILE or runs < 3 or pile.sum() < 3.0 * (below + 1)
    if few or pile.mean() > MOST_PILED:
        return None
    values = size[pile]
    return float(np.median(values)), float(values.std() / np.sqrt(values.size))
