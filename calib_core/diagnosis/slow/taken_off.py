"""What was found at rest, taken off the bins and the turns, before the turns are judged.

A turn is compared with gravity before and after it. Gravity's direction there has the accelerometer's error
in it, and the rate has the gyroscope's, which a sensitivity to acceleration changes while the phone turns.
Left in, they would be taken for a wrong scale of the gyroscope.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid
from stillcal.calib_core.diagnosis.model.moments import Moments, at_samples
from stillcal.calib_core.diagnosis.model.residuals import fit_baseline
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.streams.samples import Samples, Sensor


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """An effect as it was found. moments: the drivers in the bins; value: (k,) its linear parameters, SI."""

    effect: Effect
    grid: Grid
    moments: Moments
    value: Array

    @classmethod
    def among(cls, stated: Iterable[Stated]) -> list[Known]:
        """Return the findings that say what the sensor does at any moment: those with a name of rests."""
        found = []
        for one in stated:
            hypothesis, residuals = one.hypothesis, one.residuals
            if hypothesis is None or residuals is None or residuals.turns or one.finding.effect == "unknown":
                continue
            effect, moments = hypothesis.effect, residuals.moments
            if effect.can_play(moments, hypothesis.grid):
                found.append(cls(effect, hypothesis.grid, moments, one.sizes))
        return found

    def error(self, moments: Moments) -> Array:
        """Return what the effect adds (n, 3) to the sensor's output at some moments, SI."""
        return np.asarray(self.effect.response(moments, self.grid) @ self.value)

    def during(self, samples: Samples, accelerometer: Samples) -> Moments:
        """Return the drivers at samples (n,) of the recording; temperature and charging as between bins."""
        t, bins = samples.t, self.moments
        warm, plugged = (
            None if column is None else np.interp(t, bins.t, column)
            for column in (bins.temperature, bins.charging)
        )
        return at_samples(t, bins.history, (accelerometer, samples.xyz), warm, plugged)


def error_of(samples: Samples, known: Iterable[Known], accelerometer: Samples) -> Array:
    """Return what the known effects of their sensor add to samples (n, 3), SI."""
    added = np.zeros_like(samples.xyz)
    for one in known:
        if one.effect.sensor == ("accel" if samples.sensor is Sensor.ACCELEROMETER else "gyro"):
            added = added + one.error(one.during(samples, accelerometer))
    return added


def off_bins(bins: Bins, known: Sequence[Known]) -> Bins:
    """Return the bins with the sensors' means as they would be without what is known."""
    force, rate = bins.force, bins.rate
    for one in known:
        if one.effect.sensor == "accel":
            force = force - one.error(one.moments)
        elif rate is not None:
            rate = rate - one.error(one.moments)
    return replace(bins, force=force, rate=rate)


@dataclass(frozen=True, slots=True, eq=False)
class OffRates:
    """What is known of the gyroscope, taken off its samples.

    accelerometer: its samples; scale (3, 3), bias (3,): the force is scale (sample - bias).
    """

    known: Sequence[Known]
    accelerometer: Samples
    scale: Array
    bias: Array

    @classmethod
    def of(cls, known: Sequence[Known], accelerometer: Samples, bins: Bins, gravity: float) -> OffRates:
        """Return that of the gyroscope's effects alone. bins: those that show the accelerometer's errors."""
        own = [k for k in known if k.effect.sensor == "gyro"]
        if not own:
            return cls(own, accelerometer, np.eye(3), np.zeros(3))
        fitted = fit_baseline(bins.force, bins.force_variance, bins.rest, gravity)
        return cls(own, accelerometer, fitted.scale, fitted.bias)

    def __call__(self, samples: Samples) -> Array:
        """Return the rate (n, 3) of some of the gyroscope's samples, rad/s."""
        rate = np.asarray(samples.xyz)
        for one in self.known:
            made = one.during(samples, self.accelerometer)
            assert made.force is not None, "of an accelerometer"
            rate = rate - one.error(replace(made, force=(made.force - self.bias) @ self.scale.T))
        return rate
