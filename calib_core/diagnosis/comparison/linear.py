"""Constant and slow parameters of one recording, fitted together: bias, scale, and what changes them.

A static bin's residual is linear in all of them. They are fitted with the noise averaged over its shapes
(`inference.likelihood`), the constants free beside the effects, so that a slope in temperature and the bias
at a reference temperature are one estimate and not two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from math import comb

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, posterior
from stillcal.calib_core.diagnosis.effects.catalogue import effects_in
from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED, Warmup
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.likelihood import fit_hypothesis, reduce_residuals
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, Linear, on_axes
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Parameters, SensorResiduals, together
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Finding, Where
from stillcal.calib_core.diagnosis.model.residuals import (
    BIAS_SIZE,
    MISALIGNMENT_SIZE,
    PRIOR,
    SCALE_SIZE,
    View,
)
from stillcal.calib_core.diagnosis.model.rotation_alignment import GYRO_SCALE_SIZE
from stillcal.calib_core.diagnosis.slow.about_force import about_point
from stillcal.calib_core.diagnosis.slow.estimate import GRID_PARAMETERS, averaged
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

MODEL_ERROR = 0.03
"""Standard deviation of the model's own error in an effect's numbers, as a part of the largest of them:
residuals are linear in the effects, and no effect is exactly of its named form."""

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


@dataclass(frozen=True, slots=True, eq=False)
class Wanted:
    """An effect to be measured, as one of the recordings has it. kind: "accel", "gyro" or "turn".

    grid: its time constant and the like, as they were estimated there.
    """

    kind: str
    hypothesis: Hypothesis
    grid: Grid

    @property
    def key(self) -> tuple[str, str, str]:
        """Return what makes two of them the same effect: kind, name, driver."""
        effect = self.hypothesis.effect
        return self.kind, effect.name, effect.follows


def wanted_of(exam: Examination) -> list[Wanted]:
    """Return the linear effects that a recording was found to have and that another can be asked for."""
    return [
        Wanted(kind_of(s.residuals), s.hypothesis, _grid_of(s.hypothesis, s.finding))
        for s in exam.statements
        if s.hypothesis is not None and s.residuals is not None and transferable(s.hypothesis)
    ]


def _estimated(finding: Finding) -> dict[str, float]:
    """Return the estimates of what is not linear in an effect."""
    return {
        name: float(np.max(finding.parameters[name].value))
        for name in GRID_PARAMETERS
        if name in finding.parameters
    }


def _grid_of(hypothesis: Hypothesis, finding: Finding) -> Grid:
    """Return an effect's grid point as estimated; a settling counts from the start until biases are known."""
    counted = {SETTLED: 0.0} if isinstance(hypothesis.effect, Warmup) else {}
    return hypothesis.grid | _estimated(finding) | counted


def settled(wanted: Wanted) -> Wanted:
    """Return a wanted effect that counts, if it settles, up to the settled bias."""
    return replace(wanted, grid=wanted.grid | {SETTLED: 1.0}) if SETTLED in wanted.grid else wanted


def transferable(hypothesis: Hypothesis) -> bool:
    """Whether another recording can have the same effect; a step at one moment cannot be had again."""
    return hypothesis.effect.name != "unknown" and not hypothesis.effect.recurs


def kind_of(residuals: SensorResiduals) -> str:
    """Return what residuals are of: "accel" or "gyro" for rests, "turn" for the turns between them."""
    return "turn" if residuals.turns else residuals.sensor


def linear_quantities(
    exam: Examination,
    wanted: Sequence[Wanted],
    reference_c: Mapping[str, float],
    about: Mapping[str, float] | None = None,
) -> dict[tuple[str, str], Quantity]:
    """Measure the constants and the wanted effects; by effect and sensor.

    reference_c: by sensor, degC at which bias and scale are stated where they follow temperature. about: by
    column, the value at which the bias is stated where it follows that; the recording's own mean where it has
    none. An effect is missing where the recording lacks what drives it, all of them where it has too few
    static bins.
    """
    every = every_linear_quantity(exam, wanted, reference_c, about)
    return {(q.effect, q.sensor): q for q in every}


def every_linear_quantity(
    exam: Examination,
    wanted: Sequence[Wanted],
    reference_c: Mapping[str, float],
    about: Mapping[str, float] | None = None,
) -> list[Quantity]:
    """Return what `linear_quantities` does, also of effects that come more than once, such as steps."""
    out: list[Quantity] = []
    for residuals in exam.with_turns:
        if len(residuals.bins) >= thresholds.LEAST_BINS:
            own = [w for w in wanted if w.kind == kind_of(residuals)]
            out += _fitted(exam, residuals, own, reference_c.get(residuals.sensor), about or {})
    return out


def _fitted(
    exam: Examination,
    residuals: SensorResiduals,
    wanted: Sequence[Wanted],
    reference_c: float | None,
    about: Mapping[str, float],
) -> list[Quantity]:
    kind = kind_of(residuals)
    if kind == "accel":
        # A large effect makes the constants of a linear fit false where it was not searched for.
        residuals = about_point(residuals, [h for w in wanted if (h := proposed(residuals, w)) is not None])
    free = replace(residuals, views=tuple(_freed(v, residuals.gravity) for v in residuals.views))
    effects = [h for w in wanted if (h := proposed(residuals, w)) is not None]
    hypotheses = [_constants(kind, residuals), *effects]
    parts = rows_of(hypotheses)
    count = int(parts[-1][-1]) + 1
    value, covariance = _measured(free, hypotheses, _of_its_own(exam, residuals))
    turned = at_reference(residuals, hypotheses, reference_c, about)
    roughly = np.zeros(count)
    for hypothesis, rows in zip(hypotheses[1:], parts[1:], strict=True):
        roughly[rows] = _model_error(hypothesis, value[rows])
    stated, of_constants = turned @ value, turned @ (covariance + np.diag(roughly**2)) @ turned.T
    covariance = turned @ covariance @ turned.T
    reference = {} if reference_c is None else {"temperature_c": reference_c}
    for one in effects:
        reference |= {name: at for name, at in one.grid.items() if name == SETTLED}
    out = _constant_quantities(exam, kind, stated, of_constants, reference)
    for hypothesis, rows in zip(hypotheses[1:], parts[1:], strict=True):
        effect = effect_quantity(
            residuals.bins.span, hypothesis, stated[rows], covariance[np.ix_(rows, rows)]
        )
        if reference_c is not None and hypothesis.effect.name in SHIFTED:
            effect = replace(effect, reference=dict(effect.reference) | {"temperature_c": reference_c})
        if isinstance(column := hypothesis.effect, CovariateBias):
            at = about.get(column.column, residuals.column_means[column.column])
            effect = replace(effect, reference=dict(effect.reference) | {column.column: at})
        out.append(effect)
    return out


def _of_its_own(exam: Examination, residuals: SensorResiduals) -> list[tuple[Hypothesis, float]]:
    """Return what a recording alone has, a step or something unknown, and the probability that it has it.

    It is fitted beside, and stated elsewhere. Left out, it would be a part of the constants, which would then
    differ too.
    """
    looked_for = len(effects_in(residuals))
    return [
        (s.hypothesis, posterior(s.finding.evidence.log_bayes_factor, looked_for))
        for s in exam.statements
        if s.hypothesis is not None
        and s.residuals is not None
        and kind_of(s.residuals) == kind_of(residuals)
        and not transferable(s.hypothesis)
    ]


def _measured(
    residuals: SensorResiduals,
    hypotheses: Sequence[Hypothesis],
    beside: Sequence[tuple[Hypothesis, float]],
) -> tuple[Array, Array]:
    """Fit hypotheses together; return their numbers (k,) and covariance (k, k), SI.

    beside: other hypotheses and how probable each of them is: the numbers are averaged over fits with and
    without each.
    """
    fits, weight = [], []
    for chosen in product((True, False), repeat=len(beside)):
        own = [h for (h, _), there in zip(beside, chosen, strict=True) if there]
        whole = together(residuals, [*hypotheses, *own])
        fits.append(fit_hypothesis(reduce_residuals(residuals, [whole]), 0))
        odds = [p if there else 1.0 - p for (_, p), there in zip(beside, chosen, strict=True)]
        weight.append(float(np.prod(odds)))
    return averaged(fits, np.array(weight), np.concatenate([h.sizes for h in hypotheses]))


def rows_of(hypotheses: Sequence[Hypothesis]) -> list[NDArray[np.int64]]:
    """Return which numbers of a joint fit belong to each of the hypotheses."""
    ends = np.cumsum([0, *(h.sizes.size for h in hypotheses)])
    return [np.arange(a, b) for a, b in pairwise(ends)]


def proposed(residuals: SensorResiduals, wanted: Wanted) -> Hypothesis | None:
    """Return the effect as this recording would have it, at the nearest fine point; None if it cannot.

    What comes at a moment is taken at that moment.
    """

    def nearest(points: Sequence[Hypothesis]) -> Hypothesis:
        return min(points, key=lambda h: _apart(h.grid, wanted.grid))

    for effect in effects_in(residuals):
        same = (wanted.kind, effect.name, effect.follows) == wanted.key
        if not same or not _of_one_form(effect, wanted.hypothesis.effect):
            continue
        if effect.recurs:
            return residuals.measured(effect, wanted.hypothesis.grid)
        if found := residuals.hypotheses(effect):
            point = nearest(residuals.finer(nearest(found)))
            if SETTLED not in wanted.grid:
                return point
            return residuals.measured(
                effect, point.grid | {SETTLED: wanted.grid[SETTLED]}, point.multiplicity
            )
    return None


def _of_one_form(one: Effect, other: Effect) -> bool:
    """Whether two effects of one name have the same numbers: a polynomial of one degree, or a lag."""
    forms = [([p.name for p in effect.parameters], effect.grid_units) for effect in (one, other)]
    return forms[0] == forms[1]


def _apart(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Return how far two grid points are from each other, positive numbers by their logarithms."""
    total = 0.0
    for name in one.keys() & other.keys():
        a, b = one[name], other[name]
        total += abs(np.log(a / b)) if a > 0.0 and b > 0.0 else abs(a - b)
    return total


def _freed(view: View, gravity: float) -> View:
    """Return a view whose constants are no longer projected out, since they are fitted; it is made once."""
    if "freed" not in view.memo:
        view.memo["freed"] = _constants_free(view, gravity)
    made: View = view.memo["freed"]
    return made


def _constants_free(view: View, gravity: float) -> View:
    if view.name == "norm":
        local = np.full((view.t.size, 1), LOCAL_GRAVITY * gravity)
        return replace(view, baseline=view.baseline[:, :, :0], absorbed=local)
    if view.name == "turn":
        return replace(view, baseline=view.baseline[:, :, :0])
    return replace(view, baseline=view.baseline[:, :, :0]) if view.name.startswith("rate") else view


def _constants(kind: str, residuals: SensorResiduals) -> Hypothesis:
    """Return the constant parameters as a hypothesis: what they do to the residuals of a faultless phone."""
    constants = Parameters("constants", residuals.sensor, CONSTANTS[kind])
    if kind == "accel":
        columns = tuple(_of_constants(v) for v in residuals.views)
    elif kind == "turn":
        columns = tuple(v.baseline for v in residuals.views)
    else:
        columns = residuals.columns_of(on_axes(np.ones(len(residuals.bins))))
    return Hypothesis(constants, {}, columns)


def _of_constants(view: View) -> Array:
    """Return what the accelerometer's nine constants do to a view, (b, n, 9).

    The norm view holds it per standard deviation of the prior (`absorbed`); within a rest they do nothing.
    """
    if view.absorbed is None:
        return np.zeros((*view.y.shape, len(PRIOR)))
    return np.asarray(-(view.absorbed @ PRIOR)[None])


BIAS_SHIFTED = ((0, 1, 2), 1.0)
"""What an effect on the bias moves by, as in `SHIFTED`."""

SHIFTED = {
    "accel_bias_temperature": BIAS_SHIFTED,
    "gyro_bias_temperature": BIAS_SHIFTED,
    "accel_scale_temperature": ((3, 4, 5), -1.0),
    "gyro_scale_temperature": ((0, 4, 8), 1.0),
}
"""Effects whose columns are about the recording's mean temperature: which constants of the fit they move, by
axis, and the sign (the accelerometer's scale is that of the correction: what the sensor gains it loses)."""


def moved_rows(effect: str) -> NDArray[np.int64]:
    """Return which numbers (3,) of a bias or a scale an effect of temperature moves, axis by axis."""
    rows = np.array(SHIFTED[effect][0])
    return np.asarray(rows - rows[0])


def hidden_shifts(exam: Examination, wanted: Sequence[Wanted]) -> set[str]:
    """Return the sensors whose constants follow temperature, which here changes too little to show it."""
    sensors = {kind_of(s): s for s in exam.with_turns}
    return {
        w.hypothesis.effect.sensor
        for w in wanted
        if w.hypothesis.effect.name in SHIFTED and w.kind in sensors and proposed(sensors[w.kind], w) is None
    }


def at_reference(
    residuals: SensorResiduals,
    hypotheses: Sequence[Hypothesis],
    reference_c: float | None,
    about: Mapping[str, float],
    shifted: Mapping[str, tuple[tuple[int, ...], float]] = SHIFTED,
) -> Array:
    """Return the matrix that takes constants and polynomials about a driver's mean to the reference.

    shifted: which constants an effect of temperature moves, as in `SHIFTED`.

    About x + w a polynomial sum c_p x^p has the coefficients sum over p of binomial(p, q) w^(p - q) c_p.
    """
    parts = rows_of(hypotheses)
    matrix = np.eye(int(parts[-1][-1]) + 1)
    for hypothesis, rows in zip(hypotheses, parts, strict=True):
        more = _above_mean(residuals, hypothesis.effect, reference_c, about)
        if more:
            moved, sign = shifted.get(hypothesis.effect.name, BIAS_SHIFTED)
            powers = rows.reshape(-1, 3)
            for p, of in enumerate(powers, start=1):
                matrix[moved, of] += sign * more**p
                for q in range(1, p):
                    matrix[powers[q - 1], of] += comb(p, q) * more ** (p - q)
    return matrix


def _above_mean(
    residuals: SensorResiduals, effect: Effect, reference_c: float | None, about: Mapping[str, float]
) -> float:
    """Return by how much the reference of an effect's driver is above its mean; 0 where it has none."""
    if isinstance(effect, CovariateBias):
        own = residuals.column_means[effect.column]
        return about.get(effect.column, own) - own
    if effect.name not in SHIFTED or reference_c is None or residuals.bins.temperature is None:
        return 0.0
    return reference_c - float(residuals.bins.temperature.mean())


def _constant_quantities(
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


def _rows(hypothesis: Hypothesis) -> list[slice]:
    """Return which of a hypothesis' numbers belong to each of its parameters."""
    ends = np.cumsum([0, *(p.count for p in hypothesis.effect.parameters)]).tolist()
    return [slice(a, b) for a, b in pairwise(ends)]


def effect_quantity(
    span: tuple[float, float], hypothesis: Hypothesis, value: Array, covariance: Array
) -> Quantity:
    """Return the numbers (k,) of an effect as a quantity, the model's own error in their covariance.

    span: s, when the recording began and ended.
    """
    effect = hypothesis.effect
    return Quantity(
        effect.name,
        effect.sensor,
        tuple(Part(p.name, p.unit, p.count) for p in effect.parameters),
        value,
        covariance + np.diag(_model_error(hypothesis, value) ** 2),
        hypothesis.sizes,
        1e-9 * hypothesis.sizes,
        np.asarray(hypothesis.axis_of),
        reference=dict(hypothesis.grid),
        where=Where(*span, SLOW_BAND, effect.follows),
    )


def _model_error(hypothesis: Hypothesis, value: Array) -> Array:
    """Return the standard deviation (k,) that an effect's numbers (k,) have because it is only a model."""
    largest = [float(np.abs(value[rows]).max()) for rows in _rows(hypothesis)]
    return np.concatenate(
        [
            np.full(p.count, MODEL_ERROR * x)
            for p, x in zip(hypothesis.effect.parameters, largest, strict=True)
        ]
    )
