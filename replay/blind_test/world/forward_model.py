"""The examiner's own forward equations of slow effects, for samples and for bins.

`accel_*` names act on the accelerometer, `gyro_*` on the gyroscope. Parameters have the names and units of
the documented answer layout, so that the model of an answer can be computed too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.world.day import Felt, World, lagged

Parameters = Mapping[str, Any]
Forward = Callable[[Felt, Parameters], Array]


def _spread(course: Array, values: Any) -> Array:
    """Return (n, 3): a course in time (n,) times one value or three."""
    return np.asarray(course[:, None] * np.broadcast_to(np.asarray(values, dtype=np.float64), (3,)))


def _by_temperature(felt: Felt, p: Parameters) -> Array:
    """Return a bias by temperature: a straight line, and any curve or part by the rate of warming."""
    above = felt.temperature - float(p.get("reference_c", 25.0))
    bias = _spread(above, p["slope"])
    for power, name in ((2, "quadratic"), (3, "cubic")):
        if name in p:
            bias = bias + _spread(above**power, p[name])
    if "rate" in p:
        bias = bias + _spread(np.gradient(felt.temperature, felt.t), p["rate"])
    return bias


def _scale_by_temperature(felt: Felt, p: Parameters) -> Array:
    return _spread(felt.temperature - 25.0, p["slope"]) * felt.force


def _gyro_scale_by_temperature(felt: Felt, p: Parameters) -> Array:
    rate = felt.rate if isinstance(felt, World) else np.zeros((felt.t.size, 3))
    return _spread(felt.temperature - 25.0, p["slope"]) * rate


def _warmup(felt: Felt, p: Parameters) -> Array:
    return _spread(1.0 - np.exp(-felt.t / float(p["tau_s"])), p["amplitude"])


def _latent(felt: Felt, p: Parameters) -> Array:
    return _spread(lagged(felt.drive, float(p["tau_s"]), felt.t), p["amplitude"])


def _step(felt: Felt, p: Parameters) -> Array:
    since = felt.t - float(p["at_s"])
    # Of a bin in which the step falls, that part lies after it.
    after = (
        np.heaviside(since, 1.0) if isinstance(felt, World) else np.clip(since / felt.width + 0.5, 0.0, 1.0)
    )
    return _spread(after, p["step"])


def _drift(felt: Felt, p: Parameters) -> Array:
    return _spread(felt.t, p["rate"])


def _charging(felt: Felt, p: Parameters) -> Array:
    return _spread(felt.charging, p["step"])


def _nonlinear(felt: Felt, p: Parameters) -> Array:
    powers = np.stack([felt.force**2, felt.force**3])
    zero = (0.0, 0.0, 0.0)
    coefficients = np.array([p.get("quadratic", zero), p.get("cubic", zero)], dtype=np.float64)
    return np.asarray(np.einsum("kni,ki->ni", powers, coefficients))


def _gyro_nonlinear(felt: Felt, p: Parameters) -> Array:
    if not isinstance(felt, World):
        return np.zeros((felt.t.size, 3))
    zero = (0.0, 0.0, 0.0)
    even, odd = np.asarray(p.get("quadratic", zero)), np.asarray(p.get("cubic", zero))
    return np.asarray(felt.rate**2 * even + felt.rate**3 * odd)


def _g_sensitivity(felt: Felt, p: Parameters) -> Array:
    return np.asarray(np.einsum("ij,nj->ni", np.asarray(p["matrix"], dtype=np.float64), felt.force))


FORWARD: dict[str, Forward] = {
    "accel_bias_temperature": _by_temperature,
    "gyro_bias_temperature": _by_temperature,
    "accel_scale_temperature": _scale_by_temperature,
    "gyro_scale_temperature": _gyro_scale_by_temperature,
    "accel_warmup": _warmup,
    "gyro_warmup": _warmup,
    "thermal_latent": _latent,
    "accel_bias_step": _step,
    "gyro_bias_step": _step,
    "accel_bias_drift": _drift,
    "gyro_bias_drift": _drift,
    "accel_charging_bias": _charging,
    "gyro_charging_bias": _charging,
    "accel_nonlinearity": _nonlinear,
    "gyro_nonlinearity": _gyro_nonlinear,
    "gyro_g_sensitivity": _g_sensitivity,
}
"""What each slow effect adds to its sensor's readings, (n, 3), by name."""


def sensor_of(effect: str, otherwise: str = "accel") -> str:
    """Return the sensor that an effect's name begins with, else `otherwise`."""
    return next(
        (s for s in ("accel", "gyro") if effect.startswith(s + "_") and "_gyro_" not in effect), otherwise
    )


def played(felt: Felt, effect: str, parameters: Parameters) -> Array:
    """Return what an effect adds to its sensor, (n, 3); zeros for effects that are not slow.

    Raises KeyError, TypeError or ValueError where the parameters do not have the documented layout.
    """
    forward = FORWARD.get(effect)
    return np.zeros((felt.t.size, 3)) if forward is None else forward(felt, parameters)
