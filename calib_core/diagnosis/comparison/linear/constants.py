"""Constant bias, scale and misalignment: what they do to residuals, and as quantities of one recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.noise_models import of_same_noise
from stillcal.calib_core.diagnosis.model.effect import Linear, on_axes
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Parameters, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Where
from stillcal.calib_core.diagnosis.model.residuals import (
    BIAS_SIZE,
    MISALIGNMENT_SIZE,
    PRIOR,
    SCALE_SIZE,
    View,
)
from stillcal.calib_core.diagnosis.model.rotation_alignment import GYRO_SCALE_SIZE
from stillcal.calib_core.diagnosis.stamps.clock import rate_against_host

RATE_BIAS_SIZE = 0.05
"""Prior size of a gyroscope's bias, rad/s: 3 deg/s, three times the zero-rate offset of consumer parts."""

LOCAL_GRAVITY = 0.002
"""Relative standard deviation of gravity where nobody gave it: it runs from 9.780 to 9.832 m/s^2 at sea level
(WGS 84), and a common scale looks the same."""

ALIKE_BIAS = {"accel": 2e-3, "gyro": 1e-4}
"""Bias, m/s^2 and rad/s, that two recordings of one phone may differ by and nothing is wrong: 0.2 mg and
0.006 deg/s, what a rest of some minutes leaves uncertain by slow noise in the parts of consumer phones."""

ALIKE_SCALE = 2e-4
"""Scale and misalignment, relative, for which the same holds."""

CONSTANTS = {
    "accel": (
        Linear("bias", "m/s^2", 3, BIAS_SIZE),
        Linear("scale", "1", 3, SCALE_SIZE),
        Linear("misalignment", "rad", 3, MISALIGNMENT_SIZE),
    ),
    "gyro": (Linear("bias", "rad/s", 3, RATE_BIAS_SIZE),),
    "turn": (Linear("scale", "1", 9, GYRO_SCALE_SIZE),),
}
"""Constant parameters of the accelerometer's bins, the gyroscope's bins, and the turns between rests."""


def freed(view: View, gravity: float) -> View:
    """Return a view whose constants are no longer projected out, since they are fitted; it is made once."""
    if "freed" not in view.memo:
        view.memo["freed"] = _constants_free(view, gravity)
    made: View = view.memo["freed"]
    return made


def _constants_free(view: View, gravity: float) -> View:
    if view.name == "norm":
        local = np.full((view.t.size, 1), LOCAL_GRAVITY * gravity)
        return replace(view, baseline=view.baseline[:, :, :0], absorbed=local)
    if view.name == "turn" or view.name.startswith("rate"):
        return of_same_noise(replace(view, baseline=view.baseline[:, :, :0]), view)
    return view


def constants(kind: str, residuals: SensorResiduals) -> Hypothesis:
    """Return the constant parameters as a hypothesis: what they do to the residuals of a faultless phone."""
    parameters = Parameters("constants", residuals.sensor, CONSTANTS[kind])
    if kind == "accel":
        columns = tuple(_of_constants(v) for v in residuals.views)
    elif kind == "turn":
        columns = tuple(v.baseline for v in residuals.views)
    else:
        columns = residuals.columns_of(on_axes(np.ones(len(residuals.bins))))
    return Hypothesis(parameters, {}, columns)


def _of_constants(view: View) -> Array:
    """Return what the accelerometer's nine constants do to a view, (b, n, 9).

    The norm view holds it per standard deviation of the prior (`absorbed`); within a rest they do nothing.
    """
    if view.absorbed is None:
        return np.zeros((*view.y.shape, len(PRIOR)))
    return np.asarray(-(view.absorbed @ PRIOR)[None])


def constant_quantities(
    exam: Examination, kind: str, value: Array, covariance: Array, reference: Mapping[str, float]
) -> list[Quantity]:
    """Return bias and scale, or of turns the scale, as quantities of their own.

    A clock that runs fast by a part makes every turn too large by that part: the scale is that at the host's
    time, where it is known. reference: what they are stated at.
    """
    where = Where(*exam.bins.span, SLOW_BAND, "nothing")
    if kind == "turn":
        assert exam.aligned is not None, "turns come from an alignment"
        error = value[:9].reshape(3, 3)
        clock, one = rate_against_host(exam.gyroscope), np.eye(3)
        scale = (exam.aligned.mapping - error @ exam.aligned.mapping) * (1.0 + clock.value)
        value = (scale - one).ravel()
        covariance = covariance[:9, :9] + clock.error**2 * np.outer(one, one)
    sensor = "gyro" if kind == "turn" else kind
    out, first = [], 0
    for name, of in _by_effect(CONSTANTS[kind]).items():
        count = sum(p.count for p in of)
        rows = np.arange(first, first + count)
        first += count
        out.append(
            Quantity(
                f"{sensor}_{name}",
                sensor,
                tuple(Part(p.name, p.unit, p.count) for p in of),
                value[rows],
                covariance[np.ix_(rows, rows)],
                np.concatenate([np.full(p.count, p.size) for p in of]),
                np.full(count, ALIKE_BIAS[sensor] if name == "bias" else ALIKE_SCALE),
                np.repeat(np.arange(3), 3) if kind == "turn" else np.arange(count) % 3,
                reference={k: v for k, v in reference.items() if k != SETTLED or name == "bias"},
                where=where,
            )
        )
    return out


def _by_effect(constants: Sequence[Linear]) -> dict[str, list[Linear]]:
    """Group constants by the effect they are stated as: misalignment goes with scale."""
    out: dict[str, list[Linear]] = {}
    for one in constants:
        out.setdefault("bias" if one.name == "bias" else "scale", []).append(one)
    return out
