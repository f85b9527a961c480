"""Component and residual of every slow finding: what a bias does against what it follows, axis by axis.

A point is the finding's own term plus what nothing explains, divided by how much of that axis the residual
sees (component-plus-residual plots, Ezekiel, JASA 19, 1924). The held-out term is fitted without the fifth of
the recording that it is drawn in.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.cross_validation import FOLDS
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Finding
from stillcal.calib_core.diagnosis.model.residuals import norm_view
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.diagnosis.report.phone_effects import Mapped
from stillcal.replay.diagnosis.twin import Affine, Lived, added, at_bins, observable

SEEN = 0.5
"""An axis is drawn from bins in which the residual shows at least this part of it."""

UNIT = {"accel": "m/s^2", "gyro": "rad/s"}
SENSOR = {"accel": Sensor.ACCELEROMETER, "gyro": Sensor.GYROSCOPE}


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One axis of one finding. x: (n,) driver in `x_name`; t: (n,) s since the start; values in `unit`.

    point: component plus residual; held: the component from the other fifths, None where no term is known;
    edges: s, where the fifths meet; span: s, where the finding is. alone, line: point and component with only
    what x itself does left in, so that the component is a curve over x; both are of `y_name`.
    """

    axis: str
    unit: str
    x_name: str
    x: Array
    t: Array
    point: Array
    held: Array | None
    edges: Array
    span: tuple[float, float]
    y_name: str
    alone: Array
    line: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """A slow residual of a sensor. y: (n,), project: (n, 3), baseline: (n, p)."""

    y: Array
    project: Array
    baseline: Array


def slow(finding: Finding) -> bool:
    """Whether a finding is about a bias of the still bins, and so has a curve."""
    return (
        finding.sensor in SENSOR
        and finding.where.band_hz[1] <= SLOW_BAND[1]
        and finding.where.driver != "value"
    )


def residuals(sensor: str, bins: Bins, below: Affine, gravity: float) -> list[Residual]:
    """Return the residuals of gravity's norm, or of the three rates at rest."""
    if sensor == "accel":
        view = norm_view(bins, below.baseline, gravity)
        # The baseline was fitted with what is known taken off; the residual is wanted with it in.
        y = view.y[0] + np.einsum("na,na->n", view.project[0], below.accel)
        return [Residual(np.asarray(y), view.project[0], affine_columns(below.baseline.up))]
    assert bins.rate is not None
    ones = np.ones((len(bins), 1))
    return [Residual(bins.rate[:, a], np.tile(np.eye(3)[a], (len(bins), 1)), ones) for a in range(3)]


def affine_columns(up: Array) -> Array:
    """Return what an affine accelerometer's errors may do to gravity's norm, (n, 9). up: (n, 3).

    Offset, bias, scale and misalignment over gravity's direction alone. In columns over the measured force
    the three scales less the offset would be the residual itself, and free to take it all away.
    """
    x, y, z = up.T
    return np.column_stack([np.ones_like(x), x, y, z, x * x, y * y, x * y, y * z, z * x])


def left_over(part: Residual, explained: Array) -> Array:
    """Return what the baseline and errors `explained` (n, 3) leave of a residual, (n,)."""
    y = part.y - np.einsum("na,na->n", part.project, explained)
    return np.asarray(y - part.baseline @ np.linalg.lstsq(part.baseline, y, rcond=None)[0])


def curves_of(one: Mapped, bins: Bins, about: Lived, below: Affine, gravity: float) -> list[Curve]:
    """Return the finding's curves, one a named axis. below: the phone with all that is known."""
    finding = one.finding
    if not slow(finding) or (finding.sensor == "gyro" and bins.rate is None):
        return []
    own = _term(one, bins, about, below, gravity)
    if own is None and finding.effect != "unknown":
        return []
    everything = below.accel if finding.sensor == "accel" else below.gyro
    parts = residuals(finding.sensor, bins, below, gravity)
    return [
        curve
        for axis in finding.axes
        if (curve := _curve(finding, "xyz".index(axis), parts, own, everything, bins=bins, below=below))
        is not None
    ]


def _term(one: Mapped, bins: Bins, about: Lived, below: Affine, gravity: float) -> Array | None:
    effect = one.effect
    if effect is None or not observable(effect) or not slow(one.finding):
        return None
    moment = at_bins(bins, about, below.baseline.up, gravity)
    return added([effect], SENSOR[one.finding.sensor], moment, about, 0.1)


def _curve(
    finding: Finding,
    axis: int,
    parts: list[Residual],
    own: Array | None,
    everything: Array,
    *,
    bins: Bins,
    below: Affine,
) -> Curve | None:
    part = parts[0] if len(parts) == 1 else parts[axis]
    share = part.project[:, axis]
    seen = np.abs(share) >= SEEN
    if seen.sum() < 5:
        return None
    rest = left_over(part, everything)
    component = np.zeros(len(bins)) if own is None else own[:, axis]
    if own is not None and not np.ptp(component) > 0.0:
        return None
    t = bins.t - bins.span[0]
    edges = np.linspace(0.0, bins.span[1] - bins.span[0], FOLDS + 1)
    held = None if own is None else _held(part, everything, component, axis, t=t, edges=edges)
    x_name, x = _driver(finding, bins, axis, below)
    point = component[seen] + rest[seen] / share[seen]
    y_name, alone, line = _alone(finding, axis, point, component[seen], up=below.baseline.up[seen])
    return Curve(
        "xyz"[axis],
        UNIT[finding.sensor],
        x_name,
        x[seen],
        t[seen],
        point,
        None if held is None else held[seen],
        edges,
        (finding.where.t_start - bins.span[0], finding.where.t_end - bins.span[0]),
        y_name,
        alone,
        None if own is None else line,
    )


def _alone(
    finding: Finding, axis: int, point: Array, component: Array, *, up: Array
) -> tuple[str, Array, Array]:
    """Return what is drawn over the driver, its name, and the part of the component that the driver makes."""
    if finding.effect.endswith("scale_temperature"):
        return "error at 1 g,", point / up[:, axis], component / up[:, axis]
    matrix = finding.parameters.get("matrix")
    if matrix is None:
        return "bias", point, component
    other = _strongest(finding, axis)
    line = np.asarray(matrix.value)[axis, other] * STANDARD * up[:, other]
    return "bias", point - component + line, line


def _held(part: Residual, everything: Array, component: Array, axis: int, *, t: Array, edges: Array) -> Array:
    """Return the component with its size from the other fifths, (n,)."""
    column = part.project[:, axis] * component
    y = part.y - np.einsum("na,na->n", part.project, everything) + column
    out = component.copy()
    for first, last in pairwise(edges):
        test = (t >= first) & (t <= last)
        if (~test).sum() > 5 and test.any():
            out[test] = component[test] * _size(y[~test], column[~test], part.baseline[~test])
    return out


def _size(y: Array, column: Array, baseline: Array) -> float:
    """Return the least-squares factor of a column beside the baseline; 1 where the part does not show it."""
    design = np.column_stack([column, baseline])
    left = column - baseline @ np.linalg.lstsq(baseline, column, rcond=None)[0]
    if float(left @ left) < 1e-3 * float(column @ column):
        return 1.0
    return float(np.linalg.lstsq(design, y, rcond=None)[0][0])


def _driver(finding: Finding, bins: Bins, axis: int, below: Affine) -> tuple[str, Array]:
    """Return what a finding is drawn against."""
    follows = finding.where.driver
    if "temperature" in follows and bins.temperature is not None:
        return "temperature, degC", bins.temperature
    if follows in ("own force", "attitude", "attitude, nonlinearly"):
        other = axis if finding.sensor == "accel" else _strongest(finding, axis)
        return f"gravity along {'xyz'[other]}, m/s^2", np.asarray(STANDARD * below.baseline.up[:, other])
    if follows == "vibration power":
        return "vibration, (m/s^2)^2", bins.vibration
    return "time, min", np.asarray((bins.t - bins.span[0]) / 60.0)


def _strongest(finding: Finding, axis: int) -> int:
    """Return the component of force that an axis follows most."""
    matrix = finding.parameters.get("matrix")
    return axis if matrix is None else int(np.argmax(np.abs(np.asarray(matrix.value)[axis])))


def running_median(x: Array, y: Array, count: int = 15) -> tuple[Array, Array]:
    """Return middles and medians of `count` stretches of equally many points, by rising x."""
    order: NDArray[np.int64] = np.argsort(x).astype(np.int64)
    parts = [p for p in np.array_split(order, min(count, max(1, x.size // 3))) if p.size]
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])
