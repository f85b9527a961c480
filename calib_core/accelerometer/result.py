"""The result of an accelerometer fit, with its intervals and the uncertainty of what it corrects.

Grammenos et al. 2018, 4.2. A result is a plain value; it is estimated in fit.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer import observability
from stillcal.calib_core.accelerometer.observability import Coverage
from stillcal.calib_core.accelerometer.parameters import Form, basis, inverse, variances_along
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.model import SensorModel


@dataclass(frozen=True, slots=True)
class Dropped:
    """A rest left out of a fit: its row, and the reason."""

    row: int
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerFit:
    """An accelerometer's model with its evidence. Forces in m/s^2, scale dimensionless.

    parameters: 6, 9 or 12, called `names`. form: of a 9-parameter scale. Where 12 parameters are asked for,
    gravity alone shows 9 of them, and the symmetric scale is taken: any rotation of it fits as well, and this
    one is nearest to the raw axes. covariance: (p, p), by the rests alone; the methods add what the
    uncertainty of gravity, gravity_uncertainty, contributes. degrees_of_freedom: of the covariance: attitudes
    less parameters where attitudes scatter more than their rests explain; else rests less attitudes where
    rests repeat worse than declared; else infinite, with the declared uncertainties taken as they are.
    coverage: what the attitudes support. residuals: (n,) calibrated norm less gravity, of all rests.
    rms_residual: their root mean square, dropped ones included. dropped: rests left out, with reasons.
    n_states: number of distinct attitudes. repeatability: standard deviation of the norm between rests of one
    attitude, None where none was held twice. excess_rest, excess_attitude: standard deviation beyond the
    declared uncertainty, between rests of one attitude and between attitudes. gravity: mean local g that the
    norm was fitted to. iterations: number of Gauss-Newton steps tried.
    with_prior: whether a prior entered; the covariance holds it.
    """

    model: SensorModel
    parameters: int
    form: Form
    names: tuple[str, ...]
    covariance: Array
    degrees_of_freedom: float
    coverage: Coverage
    residuals: Array
    rms_residual: float
    dropped: tuple[Dropped, ...]
    n_rests: int
    n_states: int
    repeatability: float | None
    excess_rest: float
    excess_attitude: float
    gravity: float
    gravity_uncertainty: float
    iterations: int
    with_prior: bool = False

    @property
    def values(self) -> Array:
        """The parameters, (p,), in the order of `names`."""
        return np.asarray(inverse(self.parameters, self.form) @ self._twelve())

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which rests were fitted, (n,)."""
        mask = np.ones(self.n_rests, dtype=bool)
        mask[[d.row for d in self.dropped]] = False
        return mask

    @property
    def common_scale_uncertainty(self) -> float:
        """Relative standard uncertainty of the whole scale by that of gravity, which no rest can show."""
        return self.gravity_uncertainty / self.gravity

    @property
    def total_covariance(self) -> Array:
        """Covariance of the parameters, (p, p), with the uncertainty of the common scale."""
        back = inverse(self.parameters, self.form)
        return np.asarray(back @ self._full_covariance() @ back.T)

    @property
    def sensor_covariance(self) -> Array:
        """Covariance of (scale row by row 9, bias 3), (12, 12), with the uncertainty of the common scale."""
        order = np.r_[3:12, 0:3]
        return np.asarray(self._full_covariance()[np.ix_(order, order)])

    @property
    def worst_norm_uncertainty(self) -> float:
        """Standard uncertainty of the calibrated norm at rest along the worst direction, m/s^2."""
        rows = self._norm_rows(observability.sphere())
        return float(np.sqrt(variances_along(rows, self._from_rests()).max()))

    def interval(self, level: float = 0.95) -> Array:
        """Return two-sided intervals of the parameters at `level`, (p, 2), by Student's t or the normal."""
        from scipy.special import ndtri, stdtrit  # noqa: PLC0415 - loaded when used: the daemon stays light

        tail = 0.5 + level / 2.0
        free = self.degrees_of_freedom
        reach = stdtrit(free, tail) if np.isfinite(free) else ndtri(tail)
        sd = np.sqrt(np.diag(self.total_covariance))
        return np.column_stack((self.values - reach * sd, self.values + reach * sd))

    def uncertainty(self, raw: Array) -> Array:
        """Return the standard uncertainty that the calibration leaves in calibrated readings of `raw`.

        raw and result: (..., 3) m/s^2, per axis. The noise of the reading itself is not included, nor a
        rotation common to all axes.
        """
        shifted = np.asarray(raw, dtype=np.float64) - self.model.bias
        by_bias = np.broadcast_to(-self.model.scale, (*shifted.shape, 3))
        by_scale = np.eye(3)[:, :, None] * shifted[..., None, None, :]
        rows = np.concatenate((by_bias, by_scale.reshape(*shifted.shape, 9)), axis=-1)
        variances = np.einsum("...i,ij,...j->...", rows, self._full_covariance(), rows)
        return np.asarray(np.sqrt(variances))

    def _twelve(self) -> Array:
        return np.asarray(np.concatenate((self.model.bias, self.model.scale.ravel())))

    def _from_rests(self) -> Array:
        matrix = basis(self.parameters, self.form)
        return np.asarray(matrix @ self.covariance @ matrix.T)

    def _full_covariance(self) -> Array:
        common = np.r_[np.zeros(3), self.model.scale.ravel()] * self.common_scale_uncertainty
        return np.asarray(self._from_rests() + np.outer(common, common))

    def _norm_rows(self, up: Array) -> Array:
        """Return the Jacobian of the norm of rests calibrated to gravity along unit vectors `up`, (n, 12)."""
        shifted = self.gravity * up @ np.linalg.inv(self.model.scale).T
        products = up[:, :, None] * shifted[:, None, :]
        return np.asarray(np.hstack((-up @ self.model.scale, products.reshape(-1, 9))))
