"""Whose calibration it is, by bias and scale, where names do not tell phones apart.

The accelerometers of two phones, even of one make, differ in bias by tens of mg and in scale by a percent
(Grammenos et al. 2018, section 2; Stisen et al. 2015, section 4). One phone's own change far less: by
OWN_BIAS and OWN_SCALE with temperature and age. Two calibrations are compared by their bias and by the
lengths and angles of their scale's columns, which no rotation of the phone's axes changes, against both
stated uncertainties and what a phone's own may change; the sum of squares follows chi-square.
"""

from __future__ import annotations

import math

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord

OWN_BIAS = 0.1
"""m/s^2, standard deviation: 1 mg/K (Bosch BMI160 datasheet, TCO) over 10 K."""

OWN_SCALE = 3e-3
"""Standard deviation: 0.03 %/K (Bosch BMI160 datasheet, TCS) over 10 K."""

OTHER = 1e-4
"""Chance below which two calibrations are those of two phones."""


def likeness(one: AccelerometerRecord, other: AccelerometerRecord) -> float:
    """Return the chance that calibrations of one phone differ by as much, 0 to 1.

    Terms that either calibration does not state, such as cross-axis ones of a fit without them, do not count.

    >>> part = AccelerometerRecord(scale=np.eye(3), bias=np.zeros(3), parameters=6, gravity=9.8)
    >>> likeness(part, part)
    1.0
    """
    difference = _values(one) - _values(other)
    own = np.array([OWN_BIAS] * 3 + [OWN_SCALE] * 6) ** 2
    variance = own + _variances(one) + _variances(other)
    diagonal_only = 6 in (one.parameters, other.parameters)
    counted = np.isfinite(variance) & ~(np.arange(9) >= (6 if diagonal_only else 9))
    return _chi_square_tail(float((difference[counted] ** 2 / variance[counted]).sum()), int(counted.sum()))


def is_other_phone(one: CalibrationRecord, other: CalibrationRecord | None) -> bool:
    """Say whether two calibrations are those of two phones beyond doubt; without both accelerometers not."""
    if other is None or one.accelerometer is None or other.accelerometer is None:
        return False
    return likeness(one.accelerometer, other.accelerometer) < OTHER


def _values(part: AccelerometerRecord) -> Array:
    """Return bias (3), and lengths and angles of the scale's columns (6): of `scale.T @ scale`, its root."""
    lengths = np.linalg.norm(part.scale, axis=0)
    cosines = (part.scale / lengths).T @ (part.scale / lengths)
    return np.concatenate((part.bias, lengths, cosines[np.triu_indices(3, 1)]))


def _variances(part: AccelerometerRecord) -> Array:
    """Return the stated variances of `_values`, (9,): 0 where none is, inf where nothing bounds it."""
    bias, scale = part.bias_uncertainty, part.scale_uncertainty
    sds = np.zeros(9)
    if bias is not None:
        sds[:3] = bias
    if scale is not None:
        sds[3:6] = np.diag(scale)
        across = scale[np.triu_indices(3, 1)]
        sds[6:] = 2.0 * np.where(np.isfinite(across), across, 0.0)  # an angle is the sum of two entries
    return np.where(np.isnan(sds), np.inf, sds) ** 2


def _chi_square_tail(value: float, k: int) -> float:
    """Return the probability that a chi-square of k degrees of freedom exceeds a value."""
    if k == 0:
        return 1.0
    half = value / 2.0
    # Abramowitz and Stegun 1964, 26.4.4 and 26.4.5: finite sums for even and for odd k.
    if k % 2 == 0:
        term = total = 1.0
        for j in range(1, k // 2):
            term *= half / j
            total += term
        return math.exp(-half) * total
    total, term = 0.0, math.sqrt(2.0 * value / math.pi) * math.exp(-half)
    for j in range(1, (k - 1) // 2 + 1):
        total += term
        term *= value / (2 * j + 1)
    return math.erfc(math.sqrt(half)) + total
