"""The step that values come in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import blocks
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    HeldOut,
    Measured,
    direct_finding,
    of_fit,
    of_measured,
)
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.segments.value_grid import (
    COMB_SAMPLES,
    ROUNDED,
    UNIT,
    step_at_rest,
)
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.streams.samples import Samples

FINEST, COARSEST = 0.01, 100.0
"""Steps over the noise below and above which no more is told: such a step is no step, such noise is none."""

STEP_ERROR = 0.05
"""Relative error of the noise beneath a step, which single rests show to some per cent."""

PRINTED = 0.5
DITHERED = 2.2
HIDDEN = 3.5
FINE = 1.6
"""Steps, in standard deviations of the noise, up to which single samples show its tails: the fourth moment of
normal noise is then off by 0.001 (the first harmonic, exp(-2 pi^2 / 1.6^2))."""

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

    def still_at_rest(self) -> bool:
        """Whether values at rest stay on one step, or between two: they are half a step off at most."""
        return self.largest > 0.0 and bool((self.sd <= self._of_each / 2.0).all())

    def most_hidden(self) -> Array:
        """Return the sd (3,) of noise beside which it is as good as none that values stay on so few steps.

        Noise of that size would move them from one step. Between two there may be a third of a step of it,
        which adds 5 % to three times as much.
        """
        return np.where(self.sd > 0.0, self._of_each, self._of_each / DITHERED)

    @property
    def _of_each(self) -> Array:
        """The step of each axis, the largest where none is seen."""
        return np.where(self.step > 0.0, self.step, self.largest)

    def left_in_mean(self) -> Array:
        """Return the sd (3,) of the error that steps leave in a mean at most; 0 where noise dithers them."""
        return self.step / ROUNDED if self.blurs_level() else np.zeros(3)

    def dithered(self) -> bool:
        """Whether single samples show the noise's tails (`FINE`)."""
        least = float(self.sd.min())
        return least > 0.0 and self.largest < FINE * least


def steps(samples: Samples, sd: Array) -> Steps:
    """Measure the steps of one sensor; sd: (3,) of its samples at rest."""
    return Steps(np.array([step_at_rest(samples.xyz[:, a]) or 0.0 for a in range(3)]), sd)


def quantisation(
    samples: Samples, sensor: str, seen: Steps, lsb: float | None, usual: Usual | None
) -> Finding | None:
    """Find a step coarser than the declared one, or, where none is declared, than the noise.

    A power of ten is how values are printed, and no finding unless it is half of the noise. The step of 16
    bits at a usual range is one as soon as it does more to the values than to add to their variance. usual:
    of the logarithm of the step over the noise, where no step is declared; None: whatever sound phones have.
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
    grid, held_out = grid_evidence(samples.xyz[:, axes[0]])
    judged = DirectEvidence(grid, held_out)
    if usual is not None and not lsb:
        unusual = of_measured(relative_step(seen), usual)
        # Both must hold: there is a grid, and it is coarser than that of sound phones.
        judged = DirectEvidence(min(grid, unusual.log_bayes_factor), held_out, unusual.unusual)
    return direct_finding(
        f"{sensor}_quantisation", sensor, axes, where, parameter, statement=say, seen=judged
    )


def relative_step(seen: Steps) -> Measured:
    """Return the logarithm of the coarsest step over the standard deviation at rest, `FINEST` at least."""
    ratio = max(float((seen.step / np.maximum(seen.sd, 1e-300)).max()), FINEST)
    return Measured(float(np.log(min(ratio, COARSEST))), STEP_ERROR)


def _power_of_ten(step: float) -> bool:
    return bool(abs(np.log10(step) - np.rint(np.log10(step))) < 1e-3)


def _usual(step: float, sensor: str) -> bool:
    return bool(np.abs(step / USUAL[sensor] - 1.0).min() < LIKE)


def grid_evidence(values: Array) -> tuple[float, HeldOut]:
    """Return nats for a grid, and what values left out say of it.

    Values (n,) are spread evenly over a step without one; with it 999 in 1000 lie within its width, evenly.
    """
    thin = values[:: max(1, values.size // COMB_SAMPLES)]
    fold, gain, before, after = blocks(thin.size), 0.0, [], []
    for k in np.unique(fold):
        train, test = thin[fold != k], thin[fold == k]
        step = step_at_rest(train)
        if step is None:
            continue
        off, width = _off_grid(train, test, step)
        gain += _log_ratio(off, width)
        before.append(step / np.sqrt(12.0))
        after.append(step * rms(off))
    step = step_at_rest(thin)
    whole = -np.inf if step is None else _log_ratio(*_off_grid(thin, thin, step))
    # Three numbers were fitted: step, phase and width.
    return of_fit(float(whole), 3.0, float(thin.size)), HeldOut(
        gain, rms(np.array(before)), rms(np.array(after))
    )


def _off_grid(train: Array, test: Array, step: float) -> tuple[Array, float]:
    """Return how far values `test` are off the grid that `train` lies on, and its width, in steps."""
    phase = float(np.angle(np.exp(2j * np.pi * train / step).mean())) / (2.0 * np.pi)
    own, off = train / step - phase, test / step - phase
    width = float(np.clip(4.0 * rms(own - np.rint(own)), 1e-3, 1.0))
    return off - np.rint(off), width


def _log_ratio(off: Array, width: float) -> float:
    inside = np.asarray(np.abs(off) < width / 2.0)
    return float(inside.sum() * np.log(0.999 / width) + (~inside).sum() * np.log(1e-3))
