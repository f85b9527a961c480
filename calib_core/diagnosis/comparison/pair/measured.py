"""What was found between two sensors as numbers, beside bias, scale and misalignment of one to the other.

These constants are nuisances of the search, and are measured with what it found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.linear.constants import ALIKE_BIAS, ALIKE_SCALE, RATE_BIAS_SIZE
from stillcal.calib_core.diagnosis.comparison.linear.quantities import effect_quantity
from stillcal.calib_core.diagnosis.comparison.linear.reference_point import (
    agree,
    apart,
    crossing_temperatures,
)
from stillcal.calib_core.diagnosis.comparison.linear.shifts import BIAS_SHIFTED, at_reference
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import GAIN_SIZES
from stillcal.calib_core.diagnosis.comparison.quantity import Key, Part, Quantity
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED, Warmup
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.likelihood import fit_hypothesis, reduce_residuals
from stillcal.calib_core.diagnosis.model.effect import Linear, on_axes
from stillcal.calib_core.diagnosis.model.hypothesis import (
    Hypothesis,
    Parameters,
    SensorResiduals,
    rows_of,
    together,
)
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Finding, Where
from stillcal.calib_core.diagnosis.model.residuals import BIAS_SIZE
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.diagnosis.slow.statement import Stated

SHIFTED = {
    "accel_bias_temperature": BIAS_SHIFTED,
    "gyro_bias_temperature": BIAS_SHIFTED,
    "accel_scale_temperature": ((3, 7, 11), 1.0),
}
"""Which constants of a pair effects of temperature move, by axis: what a sensor reads of its input grows."""

BIAS = {"accel": Linear("bias", "m/s^2", 3, BIAS_SIZE), "gyro": Linear("bias", "rad/s", 3, RATE_BIAS_SIZE)}


@dataclass(frozen=True, slots=True)
class Reference:
    """What bias and scale are stated at: degC (None without a thermometer); settled: after settling."""

    temperature_c: float | None
    settled: bool = False


Fitted = tuple[list[Hypothesis], Array, Array]
"""Constants and everything found, with their values (k,) and covariance (k, k), in their units."""

Sizes = tuple[list[Quantity], list[tuple[Finding, Quantity]]]
"""Bias and scale, and the named effects with their findings."""


def measured_in_pair(exam: Examination, residuals: SensorResiduals) -> Sizes:
    """Return bias and scale, and every named effect found in a sensor's residuals with its finding.

    They are of the one sensor less the other. An effect may come twice: each step has its own moment. Where
    bias or scale follow temperature, they are those at the temperature where both agree best, if they do
    agree there; where the bias settles, it is that of the start or the settled one.
    """
    fit = _fitted(exam, residuals)
    return _sizes_at(exam, residuals, fit, _reference(exam, residuals, fit))


@dataclass(frozen=True, slots=True, eq=False)
class Alone:
    """A constant as it is if the other is alike in both.

    nats: for it; fit: those of how much better it fits than none; both: nats for a difference of the two.
    """

    quantity: Quantity
    nats: float
    fit: float
    both: float


def each_alone(exam: Examination, residuals: SensorResiduals) -> list[Alone]:
    """Return bias and scale, each as if the other were alike in both.

    In a few attitudes neither is known beside the other, however sure it is that one of them differs. The
    nats are of the normal model with the priors of the fit (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995).
    """
    fit = _fitted(exam, residuals)
    reference = _reference(exam, residuals, fit)
    turned = _turned(residuals, fit[0], reference)[:12]
    sizes = np.concatenate([np.full(3, BIAS[residuals.sensor].size), GAIN_SIZES.ravel()])
    alike = np.concatenate([np.full(3, ALIKE_BIAS[residuals.sensor]), np.full(9, ALIKE_SCALE)])
    value, spread = turned @ fit[1] / sizes, turned @ fit[2] @ turned.T / np.outer(sizes, sizes)
    precision = np.linalg.inv(spread + np.diag((alike / sizes) ** 2))
    whole = 0.5 * float(value @ precision @ value - np.linalg.slogdet(precision)[1])
    out = []
    for kind, rows in enumerate((slice(0, 3), slice(3, 12))):
        known, told = precision[rows, rows], precision[rows] @ value
        alone, covariance = np.zeros(12), np.zeros((12, 12))
        alone[rows], covariance[rows, rows] = np.linalg.solve(known, told), np.linalg.inv(known)
        fits = 0.5 * float(told @ alone[rows])
        stated = _constants_of(residuals, alone * sizes, covariance * np.outer(sizes, sizes), reference, {})
        out.append(Alone(stated[kind], fits - 0.5 * float(np.linalg.slogdet(known)[1]), fits, whole))
    return out


def none_of(quantity: Quantity) -> Quantity:
    """Return the other sensor's part: nothing, for it is what the one is measured against."""
    k = quantity.value.size
    return replace(quantity, value=np.zeros(k), covariance=np.zeros((k, k)))


def _reference(exam: Examination, residuals: SensorResiduals, fit: Fitted) -> Reference:
    """Return where bias and scale of both agree best: elsewhere they only repeat what temperature does."""
    sensor = residuals.sensor
    bias, best = (f"{sensor}_bias", sensor), Reference(residuals.moments.history.reference_c)
    if best.temperature_c is not None:
        mean = {sensor: best.temperature_c}
        crossing = crossing_temperatures(_moved(exam, residuals, fit, best), mean, SHIFTED) or mean
        there = Reference(crossing[sensor])
        sides = _moved(exam, residuals, fit, there)
        constants = [(effect.removesuffix("_temperature"), sensor) for effect in SHIFTED]
        best = there if all(agree(sides, constant) for constant in constants) else best
    if any(isinstance(h.effect, Warmup) for h in fit[0]):
        later = replace(best, settled=True)
        best = min(best, later, key=lambda at: apart(_moved(exam, residuals, fit, at), bias))
    return best


def _moved(
    exam: Examination, residuals: SensorResiduals, fit: Fitted, reference: Reference
) -> tuple[dict[Key, Quantity], dict[Key, Quantity]]:
    """Return bias, and scale if temperature moves it, with what that does, of the one and of the other."""
    constants, effects = _sizes_at(exam, residuals, fit, reference)
    followed = {q.effect for _, q in effects} & SHIFTED.keys()
    kept = {f"{residuals.sensor}_bias"} | followed | {e.removesuffix("_temperature") for e in followed}
    own = [q for q in (*constants, *(q for _, q in effects)) if q.effect in kept]
    one, other = ({(q.effect, q.sensor): q for q in side} for side in (own, map(none_of, own)))
    return one, other


def _sizes_at(exam: Examination, residuals: SensorResiduals, fit: Fitted, reference: Reference) -> Sizes:
    """Return what was measured, the constants as they are at a reference."""
    every, value, covariance = fit
    turned = _turned(residuals, every, reference)
    value, covariance = turned @ value, turned @ covariance @ turned.T
    counted = [_counted(h, reference) for h in every[1:]]
    settling = {SETTLED: float(reference.settled)} if any(SETTLED in h.grid for h in counted) else {}
    constants = _constants_of(residuals, value, covariance, reference, settling)
    at, out = _at(reference), []
    findings = [s.finding for s in _found(exam, residuals)]
    for finding, hypothesis, rows in zip(findings, counted, rows_of(every)[1:], strict=True):
        if hypothesis.effect.name != "unknown":
            one = effect_quantity(
                residuals.bins.span, hypothesis, value[rows], covariance[np.ix_(rows, rows)]
            )
            warm = at if one.effect.endswith("_temperature") else {}
            out.append((finding, replace(one, reference={**one.reference, **warm})))
    return constants, out


def _at(reference: Reference) -> dict[str, float]:
    """Return the temperature that constants are stated at, if there is one."""
    return {} if reference.temperature_c is None else {"temperature_c": reference.temperature_c}


def _constants_of(
    residuals: SensorResiduals,
    value: Array,
    covariance: Array,
    reference: Reference,
    settling: dict[str, float],
) -> list[Quantity]:
    """Return bias and scale of the first numbers of a fit."""
    where, at = Where(*residuals.bins.span, SLOW_BAND, "nothing"), _at(reference)
    # What turns between rests show is not sought, so a gyroscope's scale is one for all temperatures.
    warm = at if residuals.sensor == "accel" else {}
    return [
        _bias(residuals.sensor, value, covariance, where, at | settling),
        _scale(residuals.sensor, value, covariance, where, warm),
    ]


def _counted(hypothesis: Hypothesis, reference: Reference) -> Hypothesis:
    """Return a settling that says which bias its amplitude counts from; anything else as it is."""
    if not isinstance(hypothesis.effect, Warmup):
        return hypothesis
    return replace(hypothesis, grid={**hypothesis.grid, SETTLED: float(reference.settled)})


def _turned(residuals: SensorResiduals, every: Sequence[Hypothesis], reference: Reference) -> Array:
    """Return the matrix that takes values about mean temperature and start to those about a reference."""
    matrix = at_reference(residuals, every, reference.temperature_c, residuals.column_means, SHIFTED)
    for hypothesis, rows in zip(every, rows_of(every), strict=True):
        if reference.settled and isinstance(hypothesis.effect, Warmup):
            matrix[:3, rows] += np.eye(3)
    return matrix


def _found(exam: Examination, residuals: SensorResiduals) -> list[Stated]:
    """Return what was found in a sensor's residuals and has columns there."""
    return [s for s in exam.statements if s.residuals is residuals and s.hypothesis is not None]


def taken_out(exam: Examination, residuals: SensorResiduals, told: Mapping[Key, Array]) -> SensorResiduals:
    """Return residuals without the effects that are told, and without as much of the constants as is told."""
    every, value, covariance = _fitted(exam, residuals)
    turned = _turned(residuals, every, _reference(exam, residuals, (every, value, covariance)))
    stated = turned @ value
    for hypothesis, rows in zip(every, rows_of(every), strict=True):
        if hypothesis is every[0]:
            stated[rows] = _told_constants(residuals.sensor, told)
        else:
            stated[rows] *= (hypothesis.effect.name, residuals.sensor) in told
    sizes, views = np.linalg.solve(turned, stated), list(residuals.views)
    for hypothesis, rows in zip(every, rows_of(every), strict=True):
        views = [
            replace(v, y=v.y - columns @ sizes[rows])
            for v, columns in zip(views, hypothesis.columns, strict=True)
        ]
    return replace(residuals, views=tuple(views))


def _told_constants(sensor: str, told: Mapping[Key, Array]) -> Array:
    """Return bias and what the sensor reads of the input, twelve numbers, as told; zero what is not."""
    bias, scale = (told.get((f"{sensor}_{kind}", sensor)) for kind in ("bias", "scale"))
    out, one = np.zeros(12), np.eye(3)
    if bias is not None:
        out[:3] = bias
    if scale is not None:
        out[3:] = (np.linalg.inv(one + scale.reshape(3, 3)) - one).ravel()
    return out


def _fitted(exam: Examination, residuals: SensorResiduals) -> Fitted:
    """Fit constants and everything found, as they are at the mean temperature."""
    bare = tuple(replace(v, baseline=v.baseline[:, :, :0], absorbed=None) for v in residuals.views)
    free = replace(residuals, views=bare)
    own = [s.hypothesis for s in _found(exam, residuals) if s.hypothesis is not None]
    every = [_constants(residuals), *own]
    whole = together(residuals, every)
    fit = fit_hypothesis(reduce_residuals(free, [whole]), 0)
    value, covariance = fit.beta * whole.sizes, fit.covariance * np.outer(whole.sizes, whole.sizes)
    return every, *_at_mean(residuals, every, value, covariance)


def _at_mean(
    residuals: SensorResiduals, every: Sequence[Hypothesis], value: Array, covariance: Array
) -> tuple[Array, Array]:
    """Return numbers (k,) and covariance (k, k), the bias at the mean of courses without a name.

    Nobody knows at which value such a course is no error: its zero is wherever its form has it. So the bias
    is that of the whole recording's mean, and the course's own variance is part of its error.
    """
    turned, spread = np.eye(value.size), np.zeros(value.size)
    weights = residuals.bins.duration / residuals.bins.duration.sum()
    for hypothesis, rows in zip(every, rows_of(every), strict=True):
        effect = hypothesis.effect
        if effect.name != "unknown" or effect.parameters[0].unit != UNIT[residuals.sensor]:
            continue
        for axis, (columns,) in enumerate(hypothesis.columns):
            turned[axis, rows] = weights @ columns
            course = columns @ value[rows]
            spread[axis] += weights @ (course - weights @ course) ** 2
    return turned @ value, turned @ covariance @ turned.T + np.diag(spread)


def _constants(residuals: SensorResiduals) -> Hypothesis:
    """Return bias and what the sensor reads of the other's input, nine numbers row by row."""
    true = residuals.bins.force if residuals.sensor == "accel" else residuals.bins.rate
    assert true is not None, "a gyroscope has rates"
    n = len(residuals.bins)
    gain = (np.eye(3)[None, :, :, None] * true[:, None, None, :]).reshape(n, 3, 9)
    response = np.concatenate([on_axes(np.ones(n)), gain], axis=2)
    parameters = (BIAS[residuals.sensor], *(Linear("gain", "1", 1, float(s)) for s in GAIN_SIZES.ravel()))
    return Hypothesis(
        Parameters("constants", residuals.sensor, parameters), {}, residuals.columns_of(response)
    )


def _bias(sensor: str, value: Array, covariance: Array, where: Where, at: dict[str, float]) -> Quantity:
    own, axes = BIAS[sensor], np.arange(3)
    alike = np.full(3, ALIKE_BIAS[sensor])
    part = (Part("bias", own.unit, 3),)
    return Quantity(f"{sensor}_bias", sensor, part, value[:3], covariance[:3, :3], np.full(3, own.size),
                    alike, axes, reference=at, where=where)  # fmt: skip


def _scale(sensor: str, value: Array, covariance: Array, where: Where, at: dict[str, float]) -> Quantity:
    """Return the scale of the correction, nine numbers: the inverse of what the sensor reads of the input."""
    rows, one = slice(3, 12), np.eye(3)
    correction = np.linalg.inv(one + value[rows].reshape(3, 3))
    # Of the inverse C the differential is -C dG C, here row by row.
    change = -np.kron(correction, correction.T)
    scale, spread = (correction - one).ravel(), change @ covariance[rows, rows] @ change.T
    part = (Part("scale", "1", 9),)
    sizes, alike, axes = GAIN_SIZES.ravel(), np.full(9, ALIKE_SCALE), np.repeat(np.arange(3), 3)
    return Quantity(f"{sensor}_scale", sensor, part, scale, spread, sizes,
                    alike, axes, reference=at, where=where)  # fmt: skip
