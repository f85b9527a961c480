"""A new phone's first calibration, from the rests of its recording and the fleet's prior of its model."""

from __future__ import annotations

from typing import Any

from stillcal.calib_core.accelerometer import prior as fleet_prior
from stillcal.calib_core.accelerometer.prior import FleetPrior, PriorFit
from stillcal.calib_core.calibration.candidate import validity_of
from stillcal.calib_core.calibration.record import (
    AccelerometerRecord,
    Acceptance,
    CalibrationRecord,
    Provenance,
    StateRecord,
)
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import (
    ATTITUDE_ANGLE,
    RestState,
    attitude_labels,
    force_uncertainties,
    forces,
)
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import Trace

_REST = "leave the phone lying still for half a minute, in as many attitudes as possible"
_STRANGE = "check --format's unit and --model, or calibrate from its rests alone: stillcal replay"


def first_calibration(trace: Trace, prior: FleetPrior) -> tuple[PriorFit, list[RestState]]:
    """Find a recording's rests and fit them from the prior, with the rests that it stands on.

    Gravity is what the maker claims, else the standard value. Raises NotSupported where the recording has no
    rest, and TraceError where its rests are not those of a phone that the prior speaks of.
    """
    detector, rests = StationaryDetector(), list[RestState]()
    for chunk in trace.chunks():
        rests += detector.feed(chunk.gyroscope, chunk.accelerometer)
    rests += detector.finish()
    if not rests:
        raise NotSupported(f"{trace.path}: no rest was found", (_REST,))
    gravity = trace.claimed_gravity() or STANDARD
    try:
        fit = fleet_prior.fit(forces(rests), force_uncertainties(rests), gravity, prior)
    except NotSupported:
        raise TraceError(trace.path, "the fit did not converge", _STRANGE) from None
    off = fleet_prior.surprise(fit, prior)
    if off.squared > off.limit:
        whose = prior.model or "any model"
        distance = f"{off.parameter} is {off.sds:.1f} standard deviations from its mean"
        what = f"its rests contradict the prior of {whose}: {distance}"
        raise TraceError(trace.path, what, _STRANGE)
    return fit, rests


def record_of(
    fit: PriorFit, rests: list[RestState], prior: FleetPrior, before: CalibrationRecord | None
) -> CalibrationRecord:
    """Return the calibration for a store; a gyroscope's part that was there `before` stays."""
    labels = attitude_labels(forces(rests), ATTITUDE_ANGLE)
    accelerometer = AccelerometerRecord(
        scale=fit.model.scale,
        bias=fit.model.bias,
        parameters=9,
        names=prior.names,
        covariance=fit.covariance,
        rms_residual=rms(fit.residuals),
        n_rests=len(rests),
        n_states=int(labels.max()) + 1,
        gravity=fit.gravity,
        with_prior=True,
    )
    states = (
        StateRecord.of(rest, float(residual), int(label))
        for rest, residual, label in zip(rests, fit.residuals, labels, strict=True)
    )
    whose = f"{prior.model or 'any model'} ({prior.devices} devices)"
    reason = f"from {len(rests)} rests and the prior of {whose}"
    return CalibrationRecord(
        accelerometer=accelerometer,
        gyroscope=None if before is None else before.gyroscope,
        fitted_at=rests[-1].t_end,
        validity=validity_of(rests),
        acceptance=Acceptance(reason=reason),
        provenance=Provenance(t_start=rests[0].t_start, t_end=rests[-1].t_end),
        states=tuple(states),
    )


def document(fit: PriorFit, rests: list[RestState], prior: FleetPrior) -> dict[str, Any]:
    """Return the calibration in the layout of `stillcal replay --json`, with where it comes from."""
    labels = attitude_labels(forces(rests), ATTITUDE_ANGLE)
    accelerometer = {
        "scale": fit.model.scale.tolist(),
        "bias": fit.model.bias.tolist(),
        "gravity": fit.gravity,
        "parameters": 9,
        "names": list(prior.names),
        "covariance": fit.covariance.tolist(),
        "rms_residual": rms(fit.residuals) if rests else None,
        "n_rests": len(rests),
        "n_states": int(labels.max(initial=-1)) + 1,
        "worst_norm_uncertainty": fit.worst_norm_uncertainty,
    }
    source = {"model": prior.model, "devices": prior.devices, "shown_by_rests": fit.shown.tolist()}
    return {"schema": 1, "accelerometer": accelerometer, "prior": source}
