"""Approach 1 of ESGI'95: shifts, scaling coefficients and the angles between the sensor's own axes.

Georgieva, Hofreither, Ilieva, Ivanov and Nakov, "Laboratory calibration of a MEMS accelerometer sensor",
section 2. raw_i = s_i + b_i a_i, where a_i is the acceleration along axis i and the axes meet at angles
phi = xOy, psi = xOz, theta = yOz. The general fit is accelerometer/fit.py; this one has its own terms.

Conventions that the paper leaves open, settled on its own figures
(tests/replay/studies/methods/test_esgi.py):

- The signs of b. The cost holds only squares and products of two axes, so the three signs may be flipped
  together, which the paper's result is (all b negative), or one at a time with the two angles at that axis
  replaced by their supplements. The least squares of step 2 do not see signs at all; they are taken from
  the start.
- The cost. Eq. 17 sums (|a|^2 - g^2)^2, but the printed parameters of dataset 2, the one printed to ten
  digits, minimise the sum of (|a| - g)^2 to every digit, and Eq. 17 as printed does not.
- g = 9.8061 m/s^2: the one value that gives the printed b on every table.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.levenberg_marquardt import Damping, Residuals, minimise
from stillcal.calib_core.model import SensorModel

Cost = Literal["squared norm", "norm"]
ESGI_GRAVITY = 9.8061
"""m/s^2, the g behind the paper's approach 1, found from its printed scaling coefficients."""

_PAIRS = ((0, 1), (0, 2), (1, 2))  # phi, psi, theta
_RIGHT = np.pi / 2.0


@dataclass(frozen=True, slots=True)
class AxisAngleSettings:
    """cost: "squared norm" as Eq. 17 is printed, "norm" as the paper's figures were got. damping: of steps.

    signs: of the scaling coefficients that the search starts from and keeps, as step 2 restricts them.
    """

    cost: Cost = "squared norm"
    signs: tuple[int, int, int] = (1, 1, 1)
    damping: Damping = field(default_factory=lambda: Damping(tolerance=1e-12, floor=1e-9))

    def __post_init__(self) -> None:
        if any(s not in (-1, 1) for s in self.signs):
            raise ValueError(f"signs is {self.signs}: each must be 1 or -1")


@dataclass(frozen=True, slots=True, eq=False)
class AxisAngleFit:
    """Approach 1's nine parameters: shifts (3,) m/s^2, scalings (3,), angles (3,) rad phi, psi, theta."""

    shifts: Array
    scalings: Array
    angles: Array
    iterations: int

    @property
    def model(self) -> SensorModel:
        """Eq. 16 as scale and bias, in the frame of Eq. 12: x axis the sensor's own, y in its xy plane."""
        inverse = np.linalg.inv(np.linalg.cholesky(_cosines(self.angles)))
        return SensorModel.of(inverse / self.scalings, self.shifts)

    def relative_errors(self, forces: Array, gravity: float) -> Array:
        """Return (|a| - g) / g for raw forces (n, 3), the paper's check; (n,)."""
        return np.asarray(np.linalg.norm(self.model.apply(forces), axis=1) / gravity - 1.0)

    def with_signs(self, signs: tuple[int, int, int]) -> AxisAngleFit:
        """Return the fit of the same cost whose scalings have these signs: angles to a flipped axis turn."""
        flips = np.sign(self.scalings) * signs
        angles = [
            a if flips[i] * flips[j] > 0 else np.pi - a for a, (i, j) in zip(self.angles, _PAIRS, strict=True)
        ]
        return AxisAngleFit(self.shifts, frozen(self.scalings * flips), frozen(angles), self.iterations)


_DEFAULT = AxisAngleSettings()


def fit_axis_angles(forces: Array, gravity: float, settings: AxisAngleSettings = _DEFAULT) -> AxisAngleFit:
    """Fit approach 1 to raw forces (n, 3) of rests of any attitude, unweighted; gravity in m/s^2.

    Step 2 fits shifts and scalings with right angles, step 3 all nine from there. Raises NotSupported where
    it does not converge, or fewer than nine rests are given. The report's first phone, positions 1 to 20:

    >>> from importlib import resources
    >>> table = resources.files("stillcal.config").joinpath("esgi", "dataset1.csv")
    >>> forces = np.loadtxt(table, delimiter=",", skiprows=1)[:20]
    >>> fit = fit_axis_angles(forces, ESGI_GRAVITY, AxisAngleSettings("norm", signs=(-1, -1, -1)))
    >>> fit.shifts.round(4), fit.scalings.round(4)  # printed: 0.304496 0.321482 -1.08995, -1.00457 ...
    (array([ 0.3045,  0.3215, -1.09  ]), array([-1.0046, -1.0015, -0.9893]))
    """
    if len(forces) < 9:
        raise NotSupported(f"{len(forces)} rests for nine parameters", ["nine rests in different attitudes"])
    start = np.r_[np.zeros(3), gravity * np.array(settings.signs), np.full(3, _RIGHT)] / gravity
    start[6:] = _RIGHT
    function = _residuals(forces / gravity, settings.cost)
    rough = minimise(_first_six(function), start[:6], settings.damping)
    fine = minimise(function, np.r_[rough.v, start[6:]], settings.damping)
    if not fine.converged:
        raise NotSupported("the axis angles did not converge", ["rests in more attitudes"])
    return AxisAngleFit(
        frozen(gravity * fine.v[:3]),
        frozen(fine.v[3:6]),
        frozen(fine.v[6:]),
        rough.iterations + fine.iterations,
    )


def _cosines(angles: Array) -> Array:
    """Return the matrix of Eq. 8: cosines between the axes, of which T-bar (Remark 2) is the inverse."""
    matrix = np.eye(3)
    for angle, (i, j) in zip(angles, _PAIRS, strict=True):
        matrix[i, j] = matrix[j, i] = np.cos(angle)
    return matrix


def _first_six(function: Residuals) -> Residuals:
    def residuals(v: Array) -> tuple[Array, Array]:
        values, jacobian = function(np.r_[v, np.full(3, _RIGHT)])
        return values, jacobian[:, :6]

    return residuals


def _residuals(raw: Array, cost: Cost) -> Residuals:
    """Eq. 17's terms in units of gravity; a^T M^-1 a is the squared norm of Eq. 9 with Eq. 5 put in."""

    def residuals(v: Array) -> tuple[Array, Array]:
        along = (raw - v[:3]) / v[3:6]
        affine = np.linalg.solve(_cosines(v[6:]), along.T).T
        squares = (along * affine).sum(axis=1)
        by_angle = [
            2.0 * np.sin(a) * affine[:, i] * affine[:, j] for a, (i, j) in zip(v[6:], _PAIRS, strict=True)
        ]
        jacobian = np.hstack(
            (-2.0 * affine / v[3:6], -2.0 * affine * along / v[3:6], np.column_stack(by_angle))
        )
        if cost == "squared norm":
            return squares - 1.0, jacobian
        norms = np.sqrt(squares)
        return norms - 1.0, jacobian / (2.0 * norms[:, None])

    return residuals
