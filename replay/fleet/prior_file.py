"""Reading a prior from a fleet's report, and refusing one that cannot be right."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from stillcal.calib_core.accelerometer.parameters import basis, names
from stillcal.calib_core.accelerometer.prior import FleetPrior
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.formats.errors import TraceError

_SCHEMA = 1
_SCALES = (0.5, 2.0)
"""A phone's accelerometer stands within this factor of true; columns in another order or unit do not."""

FEW, FEW_OF_MODEL = 20, 5
"""Devices below which a prior is warned of: one from 16 real devices was no better than a data sheet."""

_SINGULAR = 1e-10  # eigenvalue of a correlation matrix below which rounding decides its sign
_ROUNDED = 1e-3  # how far printed sd may stand off the covariance, relative
_REMEDY = "make the report again: stillcal fleet-report RESULTS --json FILE"


class _Written(msgspec.Struct):
    """A prior as report.py writes it."""

    model: str
    devices: int
    mean: list[float]
    covariance: list[list[float]]
    scatter: float
    of_model: int = 0
    names: tuple[str, ...] = names(9)
    sd: list[float] | None = None


class _Report(msgspec.Struct):
    """Of a report, what is read here."""

    priors: list[_Written]
    schema: int = _SCHEMA


def read_prior(path: Path, model: str | None = None, claimed: str | None = None) -> FleetPrior:
    """Read from a fleet's report (JSON) the prior of `model`.

    Where no model is asked for, it is that of the model `claimed`, or of any model where that is not there.
    Raises TraceError where the file holds no such prior, or one that cannot be right.
    """
    try:
        report = msgspec.json.decode(path.read_bytes(), type=_Report)
    except OSError as error:
        raise TraceError(path, f"cannot be read ({error.strerror})", "check the path") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise TraceError(
            path,
            f"not a report of stillcal fleet-report: {error}",
            "make one with stillcal fleet-report RESULTS --json FILE",
        ) from None
    if report.schema != _SCHEMA:
        raise TraceError(path, f"its schema is {report.schema}, but only {_SCHEMA} can be read", _REMEDY)
    if not report.priors:
        raise TraceError(path, "holds no prior", "calibrate at least five devices first")
    own = _chosen(path, report.priors, model, claimed)
    wrong = _wrong(own)
    if wrong is not None:
        raise TraceError(path, f"the prior of {own.model or 'any model'} is not valid: {wrong}", _REMEDY)
    mean, covariance = frozen(own.mean), frozen(own.covariance)
    return FleetPrior(mean, covariance, own.scatter, own.devices, own.model, own.of_model)


def few_devices(prior: FleetPrior) -> str | None:
    """Return a warning where a prior stands on few devices, None where it does not."""
    of_model = f", {prior.of_model} of them of this model" if prior.model and prior.of_model else ""
    learnt = f"the prior of {prior.model or 'any model'} was learnt from {prior.devices} devices{of_model}"
    if prior.devices < FEW:
        return f"{learnt}: below {FEW} it may be no better than a data sheet (docs/fleet.md)"
    if prior.model and 0 < prior.of_model < FEW_OF_MODEL:
        return f"{learnt}: its mean leans on the other models"
    return None


def _chosen(path: Path, priors: list[_Written], model: str | None, claimed: str | None) -> _Written:
    """Return the one prior that is meant. Raises TraceError where there is none, or more than one."""
    models = [p.model for p in priors]
    twice = next((m for m in models if models.count(m) > 1), None)
    if twice is not None:
        raise TraceError(path, f"holds more than one prior of {twice or 'any model'}", _REMEDY)
    by_model = {p.model: p for p in priors}
    known = ", ".join(repr(m) for m in models if m) or "none"
    if model:
        if model not in by_model:
            remedy = f"give one of its models ({known}) or leave --model out"
            raise TraceError(path, f"holds no prior of {model!r}", remedy)
        return by_model[model]
    prior = by_model.get(claimed or "", by_model.get(""))
    if prior is None:
        which = f"of {claimed!r} nor of any model" if claimed else "of any model"
        raise TraceError(path, f"holds no prior {which}", f"choose one of its models with --model: {known}")
    return prior


def _wrong(prior: _Written) -> str | None:
    """Return what is wrong with a prior, in words; None where nothing is."""
    if prior.names != names(9):
        return f"its parameters are {', '.join(prior.names)}, not {', '.join(names(9))}"
    if len(prior.mean) != 9:
        return f"its mean has {len(prior.mean)} numbers, not 9"
    if len(prior.covariance) != 9 or any(len(row) != 9 for row in prior.covariance):
        return "its covariance is not 9 by 9"
    if prior.devices < 0:
        return f"it was learnt from {prior.devices} devices"
    if not prior.scatter > 0.0:
        return f"its scatter is {prior.scatter:g} m/s^2, which is not above 0"
    return _spread(np.array(prior.covariance), prior.sd) or _mean(np.array(prior.mean))


def _spread(covariance: Array, sd: list[float] | None) -> str | None:
    variances = np.diag(covariance)
    if variances.min() <= 0.0:
        worst = int(variances.argmin())
        return f"its variance of {names(9)[worst]} is {variances[worst]:g}, which is not above 0"
    root = np.sqrt(variances)
    correlation = covariance / root / root[:, None]
    if not np.allclose(correlation, correlation.T, rtol=0.0, atol=1e-6):
        return "its covariance is not symmetric"
    if np.linalg.eigvalsh(correlation).min() < _SINGULAR:
        return "its covariance is not positive definite"
    if sd is not None and not (len(sd) == 9 and np.allclose(sd, root, rtol=_ROUNDED, atol=0.0)):
        return "its standard deviations do not agree with its covariance"
    return None


def _mean(mean: Array) -> str | None:
    twelve = basis(9) @ mean
    if np.linalg.norm(twelve[:3]) > STANDARD:
        return f"its bias is {np.linalg.norm(twelve[:3]):.3g} m/s^2, more than gravity"
    scales = np.linalg.eigvalsh(twelve[3:].reshape(3, 3))
    if scales.min() < _SCALES[0] or scales.max() > _SCALES[1]:
        return f"its scale is {scales.min():.3g} to {scales.max():.3g}, but a phone's is about 1"
    return None
