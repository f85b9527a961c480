"""Exchanged axes of one recording that the other does not have: which sensor's they are, by its constants.

Turns tell that gravity and the rates are told in different axes, not which of the two is wrong. A sensor in
wrong axes also has its bias and misalignment in wrong axes, beside those of the other recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.linear.quantities import linear_quantities
from stillcal.calib_core.diagnosis.comparison.quantity import Key, Quantity, subtract
from stillcal.calib_core.diagnosis.direct.axis_exchange import exchanges
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Parameter
from stillcal.calib_core.diagnosis.model.settings import CERTAIN

JUDGED_BY: tuple[Key, ...] = (("accel_bias", "accel"), ("accel_scale", "accel"), ("gyro_bias", "gyro"))
"""Constants that rests show, whatever the gyroscope's axes are."""

UNSURE = "They do not tell it from an exchange of the other sensor's axes."

PAIRS = ((0, 1), (0, 2), (1, 2))

SECOND = 2.0 * float(np.log(48.0))
"""nats against both sensors being in wrong axes where one in wrong axes is enough: that there is a second one
is as unlikely as any of its 48 exchanges."""


@dataclass(frozen=True, slots=True, eq=False)
class Exchange:
    """What puts axes right, by sensor: a matrix (3, 3) times what it reads. said: whose they are, if sure."""

    matrices: Mapping[str, Array]
    said: str

    def findings(self, shown: Finding) -> list[Finding]:
        """Return the exchange that turns show as one of each of these sensors."""
        out = []
        for sensor, matrix in self.matrices.items():
            axes = [AXES[a] for a in range(3) if matrix[a, a] != 1.0]
            told = shown.parameters | {"exchange": Parameter(matrix.tolist(), None, "1")}
            out.append(replace(shown, sensor=sensor, axes=axes, parameters=told))
        return out


def exchange_of(exchanged: Examination, other: Examination) -> Exchange | None:
    """Return what puts the axes of one recording right, as its constants then agree best with another's.

    None where it has no axes that are exchanged throughout, or where the other has such as well.
    """
    if exchanged.other_axes is None or other.other_axes is not None:
        return None
    shown = np.asarray(exchanged.other_axes.parameters["exchange"].value, dtype=np.float64).round()
    own, others = linear_quantities(exchanged, [], {}), linear_quantities(other, [], {})
    ways = _ways(shown)
    score = np.array([_log_likelihood(own, others, way) - SECOND * (len(way) - 1) for way in ways])
    weight = np.exp(score - score.max())
    best = ways[int(score.argmax())]
    alike = sum(w for w, way in zip(weight, ways, strict=True) if way.keys() == best.keys())
    whose = " and ".join(f"the {NAME[sensor]}'s" for sensor in best)
    sure = alike >= CERTAIN * weight.sum()
    said = f"By bias and misalignment of both recordings they are {whose}." if sure else UNSURE
    return Exchange(best, said)


def _ways(shown: Array) -> list[dict[str, Array]]:
    """Return by sensor the matrices that put axes right of which turns show that `shown` (3, 3) does.

    Rates are an axial vector. Once M puts the accelerometer's axes right, a signed exchange, true rates are
    det(M) M times what they are in its axes as read, to which `shown` takes what the gyroscope reads.
    """
    same, ways = np.eye(3), []
    for accel in (same, *exchanges()):
        both = {"accel": accel, "gyro": np.linalg.det(accel) * accel @ shown}
        ways.append({sensor: m.round() for sensor, m in both.items() if not np.allclose(m, same)})
    return ways


def _log_likelihood(
    own: Mapping[Key, Quantity], others: Mapping[Key, Quantity], way: Mapping[str, Array]
) -> float:
    """Return how likely (nats) two recordings' constants are, the axes of one put right.

    As always one of so many is expected to differ, and the others to differ by their errors only.
    """
    total, keys = 0.0, [key for key in JUDGED_BY if key in own and key in others]
    for key in keys:
        right = turned(own[key], way[key[1]]) if key[1] in way else own[key]
        apart = subtract(right, others[key])
        noise = apart.covariance + np.diag(right.tolerance**2)
        alike = -0.5 * (np.linalg.slogdet(noise)[1] + apart.value @ np.linalg.solve(noise, apart.value))
        odds = np.logaddexp(np.log(len(keys)), apart.log_bayes_factor) - np.log(1.0 + len(keys))
        total += float(alike + odds)
    return total


def turned(constant: Quantity, matrix: Array) -> Quantity:
    """Return a bias (3,), or scales and misalignment (3 + 3), of which `matrix` puts the axes right."""
    change = matrix
    if constant.value.size != len(AXES):
        change = np.array([_numbers(matrix @ _symmetric(e) @ matrix.T) for e in np.eye(6)]).T
    turned_covariance = change @ constant.covariance @ change.T
    return replace(constant, value=change @ constant.value, covariance=turned_covariance)


def _symmetric(numbers: Array) -> Array:
    out = np.diag(numbers[:3])
    for x, (a, b) in zip(numbers[3:], PAIRS, strict=True):
        out[a, b] = out[b, a] = x
    return out


def _numbers(symmetric: Array) -> Array:
    return np.array([*symmetric.diagonal(), *(symmetric[a, b] for a, b in PAIRS)])
