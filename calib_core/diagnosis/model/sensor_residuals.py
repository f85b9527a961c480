"""From still bins to the two sensors' residuals: baseline fitted, views built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.model import rates
from stillcal.calib_core.diagnosis.model import residuals as views
from stillcal.calib_core.diagnosis.model.earth import ON_AVERAGE, RATE, ground, shared_rate
from stillcal.calib_core.diagnosis.model.effect import Linear
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Parameters, SensorResiduals
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.streams.samples import Samples
from stillcal.calib_core.streams.time_series import TimeSeries

EARTH = Parameters("earth", "gyro", (Linear("rate", "rad/s", 3, ON_AVERAGE * RATE),))


def by_sensor(
    bins: Bins,
    gravity: float,
    covariates: Mapping[str, TimeSeries] | None = None,
    gyroscope: Samples | None = None,
) -> list[SensorResiduals]:
    """Return the accelerometer's residuals and, where there is a gyroscope, its own.

    covariates: further logged columns by name, which a bias may follow. gyroscope: its samples, by which the
    phone's heading is followed from rest to rest; None where there are only means.
    """
    logged = covariates or {}
    baseline = views.fit_baseline(bins.force, bins.force_variance, bins.rest, gravity)
    found = [of_force(bins, baseline, gravity, logged)]
    if bins.rate is None or bins.rate_variance is None:
        return found
    motion = rates.tilt_rate(bins, views.tilted(bins.force, baseline.parameters)[0])
    over = ground(gyroscope, bins, baseline.up)
    turning = tuple(rates.rate_views(bins, baseline.up, motion, over))
    residuals = SensorResiduals("gyro", bins, turning, gravity, baseline.up, covariates=logged)
    columns = residuals.columns_of(shared_rate(baseline.up, over))
    return [*found, replace(residuals, shared=Hypothesis(EARTH, {}, columns))]


def of_force(
    bins: Bins, baseline: views.Baseline, gravity: float, logged: Mapping[str, TimeSeries]
) -> SensorResiduals:
    """Return the accelerometer's residuals about a baseline; logged: further logged columns by name."""
    norm = views.norm_view(bins, baseline, gravity)
    tangent = views.tangent_view(bins, baseline)
    seen = (norm,) if tangent is None else (norm, tangent)
    sensed = gravity * baseline.up @ np.linalg.inv(baseline.scale).T
    return SensorResiduals("accel", bins, seen, gravity, baseline.up, covariates=logged, sensed=sensed)
