"""Component-plus-residual curves of slow findings: bias against its driver, axis by axis.

A point is the finding's own term plus the residual, divided by the share of that axis in the residual
(Ezekiel, JASA 19, 1924). The held-out term is fitted without the fifth of the recording in which it is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.followed import follows_temperature
from stillcal.calib_core.diagnosis.inference.cross_validation import FOLDS
from stillcal.calib_core.diagnosis.model.records import AXES, SLOW_BAND, Finding
from stillcal.calib_core.diagnosis.model.residuals import View, norm_view
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.diagnosis.phone.phone_effects import MappedFinding
from stillcal.replay.diagnosis.phone.twin import AffinePhone, Conditions, at_bins, effects_output, observable

LEAST_SHARE = 0.5
"""An axis is drawn from bins in which the residual has at least this share of it."""

SENSOR = {"accel": Sensor.ACCELEROMETER, "gyro": Sensor.GYROSCOPE}


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """The component and residual of one finding on one axis, at n static bins.

    unit: of the values. x: (n,) what the finding is drawn against, named `x_name`. t: (n,) s since the start.
    point: (n,) component plus residual. held_out: (n,) the component with its size fitted to the other fifths
    of the recording; None where no term is known. edges: s, the boundaries of the fifths. span: s, start and
    end of the finding. partial_point, partial_component: (n,) point and component with only the part that x
    causes, so that the component is a curve over x; named `y_name`. period: s, by which x is folded; None
    where the finding has no period.
    """

    axis: str
    unit: str
    x_name: str
    x: Array
    t: Array
    point: Array
    held_out: Array | None
    edges: Array
    span: tuple[float, float]
    y_name: str
    partial_point: Array
    partial_component: Array | None
    period: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """A slow residual of a sensor: y (n,), its derivative by each axis (n, 3), baseline columns (n, p)."""

    y: Array
    project: Array
    baseline: Array


def is_slow(finding: Finding) -> bool:
    """Whether a finding is about the bias of static bins, and so has a curve."""
    return (
        finding.sensor in SENSOR
        and finding.where.band_hz[1] <= SLOW_BAND[1]
        and finding.where.driver != "value"
    )


def residuals(
    sensor: str, bins: Bins, affine: AffinePhone, gravity: float, pair: Sequence[View] = ()
) -> list[Residual]:
    """Return the residuals of gravity's norm, or of the three rates at rest.

    pair: the residuals of the three axes against another sensor of the same motion, where there is one.
    """
    if pair:
        baselines = [
            v.baseline[0] if v.absorbed is None else np.hstack([v.baseline[0], v.absorbed]) for v in pair
        ]
        return [Residual(v.y[0], v.project[0], b) for v, b in zip(pair, baselines, strict=True)]
    if sensor == "accel":
        view = norm_view(bins, affine.baseline, gravity)
        # The baseline was fitted with what is known taken off; the residual is wanted with it in.
        y = view.y[0] + np.einsum("na,na->n", view.project[0], affine.accel)
        return [Residual(np.asarray(y), view.project[0], affine_columns(affine.baseline.up))]
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


def unexplained_residual(part: Residual, explained: Array) -> Array:
    """Return a residual (n,) without the baseline and the errors `explained` (n, 3)."""
    y = part.y - np.einsum("na,na->n", part.project, explained)
    return np.asarray(y - part.baseline @ np.linalg.lstsq(part.baseline, y, rcond=None)[0])


def curves_of(
    mapped: MappedFinding,
    bins: Bins,
    conditions: Conditions,
    affine: AffinePhone,
    gravity: float,
    *,
    absent: bool = False,
    pair: Sequence[View] = (),
) -> list[Curve]:
    """Return the finding's curves, one a named axis.

    affine: the phone with all that is known. absent: draw the same of a recording without the finding. pair:
    as in `residuals`.
    """
    finding = mapped.finding
    if not is_slow(finding) or (finding.sensor == "gyro" and bins.rate is None):
        return []
    component = None if absent else _component(mapped, bins, conditions, affine, gravity)
    if component is None and finding.effect != "unknown" and not absent:
        return []
    explained = affine.accel if finding.sensor == "accel" else affine.gyro
    parts = residuals(finding.sensor, bins, affine, gravity, pair)
    drawn = [
        _curve(
            finding, "xyz".index(axis), parts, component, explained, bins=bins, affine=affine, absent=absent
        )
        for axis in finding.axes
    ]
    return [curve for curve in drawn if curve is not None]


def _component(
    mapped: MappedFinding, bins: Bins, conditions: Conditions, affine: AffinePhone, gravity: float
) -> Array | None:
    effect = mapped.effect
    if effect is None or not observable(effect) or not is_slow(mapped.finding):
        return None
    moment = at_bins(bins, conditions, affine.baseline.up, gravity)
    return effects_output([effect], SENSOR[mapped.finding.sensor], moment, conditions, 0.1)


def _curve(
    finding: Finding,
    axis: int,
    parts: list[Residual],
    term: Array | None,
    explained: Array,
    *,
    bins: Bins,
    affine: AffinePhone,
    absent: bool,
) -> Curve | None:
    part = parts[0] if len(parts) == 1 else parts[axis]
    share = part.project[:, axis]
    visible = np.abs(share) >= LEAST_SHARE
    if visible.sum() < 5:
        return None
    residual = unexplained_residual(part, explained)
    component = np.zeros(len(bins)) if term is None else term[:, axis]
    if term is not None and not np.ptp(component) > 0.0:
        return None
    t = bins.t - bins.span[0]
    edges = np.linspace(0.0, bins.span[1] - bins.span[0], FOLDS + 1)
    held_out = (
        None if term is None else _held_out_component(part, explained, component, axis, t=t, edges=edges)
    )
    period = period_of(finding)
    x_name, x = _driver(finding, bins, axis, affine)
    point = component[visible] + residual[visible] / share[visible]
    y_name, partial_point, partial_component = _partial(
        finding, axis, point, component[visible], up=affine.baseline.up[visible]
    )
    wave = None if absent or term is not None or period is None else _wave(finding, axis, x[visible], period)
    return Curve(
        "xyz"[axis],
        UNIT[finding.sensor],
        x_name,
        x[visible],
        t[visible],
        point,
        None if held_out is None else held_out[visible],
        edges,
        (finding.where.t_start - bins.span[0], finding.where.t_end - bins.span[0]),
        y_name,
        partial_point,
        wave if term is None else partial_component,
        period,
    )


def period_of(finding: Finding) -> float | None:
    """Return the period of a finding without a name, s; None where it has none."""
    period = finding.parameters.get("period_s")
    return None if period is None else float(np.ravel(period.value)[0])


def _wave(finding: Finding, axis: int, x: Array, period: float) -> Array | None:
    """Return the wave that was fitted, at times x (n,) s within the period; None without one."""
    size = finding.parameters.get("amplitude")
    if size is None or np.size(size.value) != 2 * len(AXES):
        return None
    sine, cosine = np.reshape(size.value, (2, len(AXES)))[:, axis]
    phase = 2.0 * np.pi * x / period
    return np.asarray(sine * np.sin(phase) + cosine * np.cos(phase))


def _partial(
    finding: Finding, axis: int, point: Array, component: Array, *, up: Array
) -> tuple[str, Array, Array]:
    """Return what is drawn over the driver, its name, and the part of the component that the driver makes."""
    if finding.effect.endswith("scale_temperature"):
        return "error at 1 g,", point / up[:, axis], component / up[:, axis]
    matrix = finding.parameters.get("matrix")
    if matrix is None or not component.any():
        return "bias", point, component
    other = _strongest_axis(finding, axis)
    line = np.asarray(matrix.value)[axis, other] * STANDARD * up[:, other]
    return "bias", point - component + line, line


def _held_out_component(
    part: Residual, explained: Array, component: Array, axis: int, *, t: Array, edges: Array
) -> Array:
    """Return the component with its size from the other fifths, (n,)."""
    column = part.project[:, axis] * component
    y = part.y - np.einsum("na,na->n", part.project, explained) + column
    held_out = component.copy()
    for first, last in pairwise(edges):
        test = (t >= first) & (t <= last)
        if (~test).sum() > 5 and test.any():
            held_out[test] = component[test] * _size(y[~test], column[~test], part.baseline[~test])
    return held_out


def _size(y: Array, column: Array, baseline: Array) -> float:
    """Return the least-squares factor of a column beside the baseline; 1 where the part does not show it."""
    design = np.column_stack([column, baseline])
    independent = column - baseline @ np.linalg.lstsq(baseline, column, rcond=None)[0]
    if float(independent @ independent) < 1e-3 * float(column @ column):
        return 1.0
    return float(np.linalg.lstsq(design, y, rcond=None)[0][0])


def _driver(finding: Finding, bins: Bins, axis: int, affine: AffinePhone) -> tuple[str, Array]:
    """Return the name and the values (n,) of what a finding is drawn against."""
    follows = finding.where.driver
    if follows_temperature(follows) and bins.temperature is not None:
        return "temperature, °C", bins.temperature
    if follows in ("own force", "attitude", "attitude, nonlinearly"):
        other = axis if finding.sensor == "accel" else _strongest_axis(finding, axis)
        return f"gravity along {'xyz'[other]}, m/s^2", np.asarray(STANDARD * affine.baseline.up[:, other])
    if (period := period_of(finding)) is not None:
        return f"time within the period of {period:.4g} s", np.asarray((bins.t - bins.span[0]) % period)
    if follows == "vibration power":
        return "vibration, (m/s^2)^2", bins.vibration
    return "time, min", np.asarray((bins.t - bins.span[0]) / 60.0)


def _strongest_axis(finding: Finding, axis: int) -> int:
    """Return the component of force that an axis follows most."""
    matrix = finding.parameters.get("matrix")
    return axis if matrix is None else int(np.argmax(np.abs(np.asarray(matrix.value)[axis])))


def running_median(x: Array, y: Array, count: int = 15) -> tuple[Array, Array]:
    """Return the medians of x and y in `count` groups of equally many points, by rising x."""
    order: NDArray[np.int64] = np.argsort(x).astype(np.int64)
    parts = [p for p in np.array_split(order, min(count, max(1, x.size // 3))) if p.size]
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])
