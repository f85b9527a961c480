"""The gyroscope's part of a calibration's record: from a fit, and with its bias measured anew at rest.

Its bias wanders on after every rest, so that it is kept as uncertain as one rest leaves it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.record import Acceptance, CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gyroscope.bias import BiasEstimate, update_bias
from stillcal.calib_core.gyroscope.fit import GyroscopeFit, Parameters
from stillcal.calib_core.model import SensorModel

_PARAMETER_COUNT = {Parameters.BIAS: 3, Parameters.SCALE3: 6, Parameters.FULL9: 12}
_GYRO_NAMES = (*(f"S_{a}{b}" for a in "xyz" for b in "xyz"), "b_x", "b_y", "b_z")


def gyroscope_record(fit: GyroscopeFit, t: float) -> GyroscopeRecord:
    """Return a fit of the gyroscope as it is recorded. t: s, sample time."""
    turns = len(fit.after) - len(fit.rejected)
    return GyroscopeRecord(
        scale=fit.model.scale,
        bias=fit.model.bias,
        parameters=_PARAMETER_COUNT[fit.parameters],
        names=_GYRO_NAMES,
        covariance=_with_wander(fit.covariance, fit.bias),
        rms_residual=fit.rms_after if turns else None,
        rms_nominal=fit.rms_before if turns else None,
        n_rests=fit.bias.n_rests,
        n_turns=turns,
        rotation_admitted=_bounded(fit.bias.admitted),
        missing=fit.missing,
        zeroed_at=t,
    )


def with_updated_bias(record: CalibrationRecord, recent: Pool, t: float) -> CalibrationRecord | None:
    """Return the record with the gyroscope's bias measured anew at rest (4.7); None without a rate."""
    model = SensorModel.identity() if record.gyroscope is None else record.gyroscope.model
    try:
        new_model, estimate = update_bias(model, recent.rests)
    except NotSupported:
        return None
    known = record.gyroscope or GyroscopeRecord(scale=model.scale, bias=model.bias, parameters=3)
    part = replace(
        known,
        bias=new_model.bias,
        covariance=_with_wander(known.covariance, estimate),
        rotation_admitted=_bounded(estimate.admitted),
        zeroed_at=t,
    )
    reason = f"gyroscope zeroed on {estimate.n_rests} rests"
    acceptance = Acceptance(how="zeroing", reason=reason)
    return replace(record, gyroscope=part, acceptance=acceptance)


def _with_wander(covariance: Array | None, bias: BiasEstimate) -> Array | None:
    """Return a gyroscope's covariance (12, 12) with its bias as uncertain as one rest leaves it.

    The mean over rests is known better, but the bias wanders on, and it is used between the rests.
    """
    if covariance is None or covariance.shape != (12, 12):
        return covariance
    wandering = np.array(covariance)
    wandering[9:, 9:] = bias.covariance + np.diag(bias.wander**2)
    return frozen(wandering)


def _bounded(values: Array) -> Array:
    """Return values with NaN, for unknown, where nothing bounds them."""
    return frozen(np.where(np.isfinite(values), values, np.nan))
