"""What rests show of a sensor's bias, as the regression wants it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.bias_curve.learnt import is_thermal
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.terms import drivers_at, offsets, terms_uncertainty
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.breaks import HIDDEN
from stillcal.calib_core.temperature.memory import Memory
from stillcal.calib_core.temperature.regression import (
    Observations,
)
from stillcal.calib_core.temperature.wander import Spans

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Row and column of the scale's entries, in the order of a record's nine parameters."""

_RATE_SPREAD, _FORCE_SPREAD, _SCALE_SPREAD = 0.05, 0.1, 0.01
"""Standard deviations before any rest: of the bias about the rests' median, rad/s, and of a fit that knows
nothing of temperature from the true bias, m/s^2, and scale."""


_FIRST = 8
"""Oldest rests, whose median says how far the bias was from that of now when the memory begins."""


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What rests show of one sensor's bias.

    memory: the rests. seen: the same as observations of the bias less `middle`, (3,) m/s^2 or rad/s.
    """

    sensor: Sensor
    memory: Memory
    seen: Observations
    middle: Array


def shown_by_gyroscope(memory: Memory, record: CalibrationRecord) -> Shown | None:
    """Return what rests show of the gyroscope's bias, None where none has a rate. record: in use."""
    memory = memory.where(np.asarray(np.isfinite(memory.rate).all(axis=1)))
    if not len(memory):
        return None
    memory = _without_others(memory, record, Sensor.GYROSCOPE)
    middle = frozen(np.median(memory.rate, axis=0))
    level, level_sd = np.ones((len(memory), 1)), np.array([_RATE_SPREAD])
    sd = memory.rate_sd.mean(axis=1)
    known = (memory.t, memory.celsius, memory.rate - middle, sd, level, level_sd)
    return Shown(Sensor.GYROSCOPE, memory, Observations(*known, spans=Spans(memory.t)), middle)


def shown_by_accelerometer(memory: Memory, model: SensorModel, record: CalibrationRecord | None) -> Shown:
    """Return what rests show of the accelerometer's bias.

    model: a calibration near the true one. A rest shows the bias along gravity only: the norm of its
    calibrated force less local gravity, linear in small changes of bias, scale and curve. record: the
    calibration in use, None before the first.
    """
    if record is not None:
        memory = _without_others(memory, record, Sensor.ACCELEROMETER)
    value, level, towards = _norms(np.zeros((len(memory), 3)), memory, model)
    level_sd = _level_spread(record, value)
    sd = np.linalg.norm(towards * memory.force_sd, axis=1)
    linear = partial(_norms, memory=memory, model=model)
    known = (memory.t, memory.celsius, value, sd, level, level_sd, towards)
    seen = Observations(*known, linear=linear, spans=Spans(memory.t))
    return Shown(Sensor.ACCELEROMETER, memory, seen, model.bias)


def _without_others(memory: Memory, record: CalibrationRecord, sensor: Sensor) -> Memory:
    """Return rests without those terms of a sensor that are not learnt here, as uncertain as these are."""
    others = replace(record, terms=tuple(term for term in record.terms if not is_thermal(term, sensor)))
    at = drivers_at(record, sensor, memory)
    offset, doubt = offsets(others, sensor, at), terms_uncertainty(others, sensor, at)
    if sensor is Sensor.GYROSCOPE:
        less = frozen(memory.rate - offset)
        return replace(memory, rate=less, rate_sd=frozen(np.hypot(memory.rate_sd, doubt)))
    less = frozen(memory.force - offset)
    return replace(memory, force=less, force_sd=frozen(np.hypot(memory.force_sd, doubt)))


def _norms(biases: Array, memory: Memory, model: SensorModel) -> tuple[Array, Array, Array]:
    """Return what rests show of a calibration that is near a model with biases (n, 3) in excess of its own.

    The result is local gravity less the calibrated norm, (n, 1), linear in the bias in excess; its
    derivatives by bias and scale, (n, 9); and those by the bias alone, (n, 3).
    """
    shifted = memory.force - model.bias - biases
    calibrated = shifted @ model.scale.T
    norm = np.linalg.norm(calibrated, axis=1)
    up = calibrated / norm[:, None]
    towards = -up @ model.scale
    by_scale = [up[:, a] * shifted[:, b] + (up[:, b] * shifted[:, a] if a != b else 0.0) for a, b in _PAIRS]
    value = memory.gravity - norm + (towards * biases).sum(axis=1)
    return value[:, None], np.column_stack((towards, *by_scale)), towards


def _level_spread(record: CalibrationRecord | None, value: Array) -> Array:
    """Return how far the parameters of a calibration in use may be off, (9,), bias first.

    value: (n, 1) what rests show, oldest first. One that a prior entered is known badly along some
    directions, and says so.
    """
    shown = HIDDEN * float(np.median(np.abs(value[:_FIRST])))
    usual = np.array([max(_FORCE_SPREAD, shown)] * 3 + [_SCALE_SPREAD] * 6)
    part = None if record is None else record.accelerometer
    if part is None or not part.with_prior or part.covariance is None:
        return usual
    return np.asarray(np.maximum(usual, np.sqrt(np.diag(part.covariance))))


def scale_of(entries: Array) -> Array:
    """Return the symmetric matrix (3, 3) of a scale's six entries, in the order of a record's parameters."""
    scale = np.zeros((3, 3))
    for (a, b), value in zip(_PAIRS, entries, strict=True):
        scale[a, b] = scale[b, a] = value
    return scale
