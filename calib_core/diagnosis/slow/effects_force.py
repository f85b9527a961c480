"""Effects that follow the input itself: scale against temperature, nonlinearity, g-sensitivity."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.hypothesis import Entry, Hypothesis, Linear, Scene
from stillcal.calib_core.diagnosis.model.residuals import attitudes
from stillcal.calib_core.diagnosis.slow import regressors as drivers

ATTITUDES = 3


def own_force(scene: Scene) -> Array:
    """Gravity on each axis in every bin, (N, 3), m/s^2."""
    assert scene.up is not None
    return np.asarray(scene.gravity * scene.up)


def per_axis(scene: Scene, errors: Array, blind: tuple[str, ...] = ()) -> tuple[Array, ...]:
    """Columns of an error `errors` (N, 3) on each axis, one parameter an axis; none in `blind` views."""
    return tuple(v.project * errors[v.bins][None] * (v.name not in blind) for v in scene.views)


def _scale_temperature(entry: Entry, scene: Scene) -> list[Hypothesis]:
    if scene.up is None:
        return []
    force = own_force(scene)
    return [
        Hypothesis(entry, grid, per_axis(scene, force * t[:, None])) for grid, t in drivers.temperature(scene)
    ]


def _nonlinearity(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """Quadratic and cubic error of each axis about gravity: k2 f^2 + k3 f^3."""
    if scene.up is None or distinct(scene.up) < 10:
        return []
    force = own_force(scene)
    powers = [per_axis(scene, force**p) for p in (2, 3)]
    return [Hypothesis(entry, {}, tuple(np.concatenate(c, axis=2) for c in zip(*powers, strict=True)))]


def _quadratic(entry: Entry, scene: Scene) -> list[Hypothesis]:
    if scene.up is None or distinct(scene.up) < 6:
        return []
    return [Hypothesis(entry, {}, per_axis(scene, own_force(scene) ** 2))]


def _g_sensitivity(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """Each axis' rate by all three components of gravity: parameters row by row."""
    if scene.up is None or distinct(scene.up) < ATTITUDES:
        return []
    force = own_force(scene)
    columns = []
    for v in scene.views:
        rows = v.project[:, :, :, None] * force[v.bins][None, :, None, :]
        columns.append(rows.reshape(*rows.shape[:2], 9))
    return [Hypothesis(entry, {}, tuple(columns))]


def distinct(up: Array, angle: float = 0.2) -> int:
    """Return the number of attitudes further than `angle` (rad) from each other."""
    return int(attitudes(up, angle).max(initial=-1)) + 1


def accelerometer_entries() -> list[Entry]:
    """Return the accelerometer's entries that follow its own input."""
    sentence = "The accelerometer is nonlinear on {axes}."
    return [
        Entry(
            "accel_scale_temperature",
            "accel",
            "temperature x own force",
            _scale_temperature,
            (Linear("slope", "1/K", 3, 1e-3),),
            "The accelerometer's scale changes with temperature on {axes}.",
            ("accel_bias_temperature",),
            "turn the phone over while it is warm",
        ),
        Entry(
            "accel_nonlinearity",
            "accel",
            "own force",
            _quadratic,
            (Linear("quadratic", "1/(m/s^2)", 3, 1e-3),),
            sentence,
            ("accel_saturation",),
            "rest in more attitudes, edges and corners",
        ),
        Entry(
            "accel_nonlinearity",
            "accel",
            "own force",
            _nonlinearity,
            (Linear("quadratic", "1/(m/s^2)", 3, 1e-3), Linear("cubic", "1/(m/s^2)^2", 3, 1e-4)),
            sentence,
            ("accel_saturation",),
            "rest in more attitudes, edges and corners",
        ),
    ]


def gyroscope_entries() -> list[Entry]:
    """Return the gyroscope's entries that follow gravity."""
    return [
        Entry(
            "gyro_g_sensitivity",
            "gyro",
            "attitude",
            _g_sensitivity,
            (Linear("matrix", "(rad/s)/(m/s^2)", 9, 1e-3),),
            "The gyroscope is sensitive to acceleration (g-sensitivity) on {axes}.",
            ("gyro_bias_temperature",),
            "return to the same attitudes at another temperature",
            by_row=True,
        )
    ]
