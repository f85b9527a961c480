"""What an effect of temperature, or of a column, adds to the constants at another value of its driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import comb

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.linear.wanted import Wanted, kind_of, proposed
from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.hypothesis import (
    Hypothesis,
    SensorResiduals,
    rows_of,
)

Shifted = Mapping[str, tuple[tuple[int, ...], float]]
"""By effect, which constants of a fit it moves, by axis, and the sign."""

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


def moved_rows(effect: str, shifted: Shifted = SHIFTED) -> NDArray[np.int64]:
    """Return which numbers (3,) of a bias or a scale an effect of temperature moves, axis by axis."""
    rows = np.array(shifted[effect][0])
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
    shifted: Shifted = SHIFTED,
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
