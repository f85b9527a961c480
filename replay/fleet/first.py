"""A new phone's first calibration: whatever rests its recording has, and what the fleet says of its model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core import fleet_prior
from stillcal.calib_core.fleet_prior import FleetPrior, PriorFit
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.rests import RestState, attitude_labels, force_uncertainties, forces
from stillcal.calib_core.samples import frozen
from stillcal.calib_core.stationary import StationaryDetector
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.trace import Trace


class _Written(msgspec.Struct):
    """A prior as report.py writes it."""

    model: str
    devices: int
    mean: list[float]
    covariance: list[list[float]]
    scatter: float


class _Report(msgspec.Struct):
    """Of a report, what is read here."""

    priors: list[_Written]


def read_prior(path: Path, model: str | None = None) -> FleetPrior:
    """Read the prior of a model from a fleet's report (JSON), or that of any model where it is not there.

    Raises TraceError where the file holds no prior.
    """
    try:
        priors = msgspec.json.decode(path.read_bytes(), type=_Report).priors
    except OSError as error:
        raise TraceError(path, f"cannot be read ({error.strerror})", "check the path") from None
    except msgspec.DecodeError as error:
        raise TraceError(path, f"no fleet's report: {error}", "make one: stillcal fleet-report") from None
    if not priors:
        raise TraceError(path, "holds no prior", "calibrate at least five devices first")
    own = next((p for p in priors if p.model == model), priors[0])
    return FleetPrior(frozen(own.mean), frozen(own.covariance), own.scatter, own.devices, own.model)


def first_calibration(trace: Trace, prior: FleetPrior) -> tuple[PriorFit, list[RestState]]:
    """Find a recording's rests and fit them from the prior, with the rests that it stands on.

    Gravity is what the maker claims, else the standard value.
    """
    detector, rests = StationaryDetector(), list[RestState]()
    for chunk in trace.chunks():
        rests += detector.feed(chunk.gyroscope, chunk.accelerometer)
    rests += detector.finish()
    gravity = trace.claimed_gravity() or STANDARD
    return fleet_prior.fit(forces(rests), force_uncertainties(rests), gravity, prior), rests


def document(fit: PriorFit, rests: list[RestState], prior: FleetPrior) -> dict[str, Any]:
    """Return the calibration in the layout of `stillcal replay --json`, with where it comes from."""
    labels = attitude_labels(forces(rests), fleet_prior.ATTITUDE_ANGLE)
    accelerometer = {
        "scale": fit.model.scale.tolist(),
        "bias": fit.model.bias.tolist(),
        "gravity": fit.gravity,
        "parameters": 9,
        "names": list(prior.names),
        "covariance": fit.covariance.tolist(),
        "rms_residual": float(np.sqrt(np.mean(fit.residuals**2))) if rests else None,
        "n_rests": len(rests),
        "n_states": int(labels.max(initial=-1)) + 1,
        "worst_norm_uncertainty": fit.worst_norm_uncertainty,
    }
    source = {"model": prior.model, "devices": prior.devices, "shown_by_rests": fit.shown.tolist()}
    return {"schema": 1, "accelerometer": accelerometer, "prior": source}
