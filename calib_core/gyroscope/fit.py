"""The gyroscope's scale and misalignment, fitted from rest to rest (Grammenos et al. 2018, Eq. 9-15).

Gravity as the calibrated accelerometer measures it at one rest is propagated by the gyroscope to the next
rest and compared there. The paper disregards the bias. Here each rotation segment takes its bias from the
rests around it and from the force during it (bias_trajectory.py), with their covariance, and one shift common
to all segments is estimated along with the scale. Rotation about the vertical does not move gravity, so the
phone must be turned about every axis while that axis is level. The frame is the accelerometer's.

Rotations are integrated in maths/rotation.py, residuals and slopes computed in gravity_propagation.py, the
minimum found in solver.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gyroscope.bias import BiasEstimate, bias_from_rests
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.gyroscope.solver import (
    NOMINAL,
    TURN_ABOUT,
    GyroscopeSettings,
    Parameters,
    Problem,
    Solution,
    nominal,
    solve,
)
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState

__all__ = ["GyroscopeFit", "GyroscopeSettings", "Parameters", "fit", "residuals"]


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeFit:
    """A fitted gyroscope: calibrated = model.scale @ (raw - model.bias).

    covariance: (12, 12) of the scale, row by row, then the bias (rad/s); zero for fixed parameters. bias: the
    bias from rests; it is the model's bias. shift, shift_uncertainty: (3,) rad/s, bias during rotation less
    that at rest. g_sensitivity, g_sensitivity_uncertainty: (3, 3) (rad/s)/(m/s^2), what force adds to the
    bias, as the rests show it. before, after: (K,) rad, angle between gravity propagated and measured, with
    the nominal and with the fitted scale, the bias taken off in both. rms_before, rms_after: rad, their root
    mean squares over the segments used; gravity_rms_before, gravity_rms_after: the same in m/s^2. rejected:
    indices of segments left out. turned: (3,) rad, path about each axis over the segments used.
    variance_factor: squared residuals over what their uncertainties promise. missing: what to gather for a
    larger model.
    """

    model: SensorModel
    parameters: Parameters
    covariance: Array
    bias: BiasEstimate
    shift: Array
    shift_uncertainty: Array
    g_sensitivity: Array
    g_sensitivity_uncertainty: Array
    before: Array
    after: Array
    rms_before: float
    rms_after: float
    gravity_rms_before: float
    gravity_rms_after: float
    rejected: tuple[int, ...]
    turned: Array
    variance_factor: float
    iterations: int
    missing: tuple[str, ...] = ()

    @property
    def scale_uncertainty(self) -> Array:
        """Standard uncertainty of each scale element, (3, 3)."""
        return np.sqrt(np.diag(self.covariance)[:9]).reshape(3, 3)


def fit(
    segments: Sequence[RotationSegment],
    accel: SensorModel,
    gravity: float,
    *,
    rests: Sequence[RestState] = (),
    parameters: Parameters | None = None,
    settings: GyroscopeSettings | None = None,
) -> GyroscopeFit:
    """Fit the gyroscope to rotation segments under the accelerometer's model; gravity in m/s^2.

    rests: further rests for the bias. parameters: what to estimate; None takes the largest model that the
    segments support and says in `missing` what a larger one needs. Raises NotSupported where the segments do
    not support the parameters asked for, or where no rest has a gyroscope mean. Without any segment the bias
    alone is estimated:

    >>> sd = np.full(3, 1e-4)
    >>> rates = {"rate": np.array([0.01, -0.02, 0.0]), "rate_sd": sd, "rate_uncertainty": sd}
    >>> rest = RestState(0.0, 10.0, 500, np.array([0, 0, 9.8]), sd, sd, 1e-3, **rates)
    >>> result = fit([], SensorModel.identity(), gravity=9.81, rests=[rest])
    >>> result.model.bias.tolist(), len(result.missing)  # rotations needed before a scale can be estimated
    ([0.01, -0.02, 0.0], 3)
    """
    bias = bias_from_rests(_distinct(segments, rests))
    if not segments:
        return _bias_alone(bias, parameters)
    problem = Problem.of(segments, accel, settings or GyroscopeSettings())
    missing: tuple[str, ...] = ()
    for choice in (parameters,) if parameters else (Parameters.FULL9, Parameters.SCALE3):
        try:
            posed, solution = solve(problem, choice)
            return _result(posed, solution, choice, bias=bias, gravity=gravity, missing=missing)
        except NotSupported as refusal:
            if parameters:
                raise
            missing = missing or refusal.missing
    return _result(problem, nominal(problem), Parameters.BIAS, bias=bias, gravity=gravity, missing=missing)


def residuals(
    segments: Sequence[RotationSegment], accel: SensorModel, scale: Array, shift: Array | None = None
) -> Array:
    """Return the angles between gravity propagated through each segment and measured, (K,) rad (Eq. 15).

    scale: (3, 3). The bias is that of the rests around each segment and the force during it, plus `shift`,
    (3,) rad/s.
    """
    theta = np.concatenate((scale.ravel(), np.zeros(3) if shift is None else shift))
    problem = Problem.of(segments, accel, GyroscopeSettings()).along(theta)
    return problem.at(theta, 0.0).propagated.angle


def _distinct(segments: Sequence[RotationSegment], rests: Sequence[RestState]) -> list[RestState]:
    """Return all rests once each, in time order."""
    ends = (r for segment in segments for r in (segment.before, segment.after))
    by_time = {(r.t_start, r.t_end): r for r in (*rests, *ends)}
    return [by_time[key] for key in sorted(by_time)]


def _bias_alone(bias: BiasEstimate, parameters: Parameters | None) -> GyroscopeFit:
    """Return a fit of the bias alone. Raises NotSupported where a scale was asked for."""
    missing = tuple(TURN_ABOUT.format(axis=axis) for axis in "xyz")
    if parameters not in {None, Parameters.BIAS}:
        raise NotSupported("there is no rotation between two rests", missing)
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = bias.covariance
    return GyroscopeFit(
        model=SensorModel.of(np.eye(3), bias.bias),
        parameters=Parameters.BIAS,
        covariance=covariance,
        bias=bias,
        shift=np.zeros(3),
        shift_uncertainty=np.full(3, np.nan),
        g_sensitivity=np.zeros((3, 3)),
        g_sensitivity_uncertainty=np.full((3, 3), np.nan),
        before=np.zeros(0),
        after=np.zeros(0),
        rms_before=np.nan,
        rms_after=np.nan,
        gravity_rms_before=np.nan,
        gravity_rms_after=np.nan,
        rejected=(),
        turned=np.zeros(3),
        variance_factor=np.nan,
        iterations=0,
        missing=missing,
    )


def _result(
    problem: Problem,
    solution: Solution,
    choice: Parameters,
    *,
    bias: BiasEstimate,
    gravity: float,
    missing: tuple[str, ...],
) -> GyroscopeFit:
    """Return a solution as the fit that users get."""
    scale, shift = solution.theta[:9].reshape(3, 3), solution.theta[9:]
    covariance = solution.covariance.copy()
    covariance[9:], covariance[:, 9:] = 0.0, 0.0
    covariance[9:, 9:] = bias.covariance
    before = problem.along(NOMINAL).at(NOMINAL, 0.0).propagated.angle
    after = problem.at(solution.theta, 0.0).propagated.angle
    used = solution.used
    rms_before, rms_after = (rms(a[used]) for a in (before, after))
    return GyroscopeFit(
        model=SensorModel.of(scale, bias.bias),
        parameters=choice,
        covariance=covariance,
        bias=bias,
        shift=shift,
        shift_uncertainty=np.sqrt(np.diag(solution.covariance)[9:]),
        g_sensitivity=problem.bias.sensitivity,
        g_sensitivity_uncertainty=problem.bias.sensitivity_uncertainty(),
        before=before,
        after=after,
        rms_before=rms_before,
        rms_after=rms_after,
        gravity_rms_before=gravity * rms_before,
        gravity_rms_after=gravity * rms_after,
        rejected=tuple(np.flatnonzero(~used).tolist()),
        turned=problem.bundle.path()[used].sum(axis=0),
        variance_factor=solution.variance_factor,
        iterations=solution.iterations,
        missing=missing,
    )
