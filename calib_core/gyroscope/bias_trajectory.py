"""The trajectory of the gyroscope's bias from rest to rest: a slow random walk plus what force adds to it.

Real gyroscopes are sensitive to force: about 0.1 deg/s for each g (Bosch BMI270, Android compatibility
definition 7.3.4), which over a rotation of some seconds outweighs every other error. The bias at rest i is
therefore modelled as walk_i + G f_i, both estimated from the rests' mean rates. The result is the bias during
each rotation segment; what the segments then say about the scale is estimated in solver.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.robust import MAD_TO_SD

Rows = NDArray[np.intp]

_PASSES = 4  # each reduces the part of G that is still mistaken for walk by a factor of about ten


@dataclass(frozen=True, slots=True, eq=False)
class BiasTrajectory:
    """The bias over n rests in time order.

    walk: (n, 3) rad/s, the part that force does not explain. sensitivity: (3, 3) the matrix G,
    (rad/s)/(m/s^2), row by rate, column by force. covariance: (3, n + 3, n + 3), for each axis that of its
    walk and its row of G. step: (3,) rad/s, standard deviation of the walk between neighbouring rests.
    """

    walk: Array
    sensitivity: Array
    covariance: Array
    step: Array

    @classmethod
    def of(cls, rates: Array, variances: Array, forces: Array, typical: float) -> BiasTrajectory:
        """Estimate the trajectory from n rests: mean rates, their variances, calibrated forces, all (n, 3).

        typical: (rad/s)/(m/s^2), prior standard deviation of an element of G. The step of the walk is what
        neighbouring rests differ by beyond their own uncertainty, so that a bias that stays is averaged over
        the rests and one that wanders is followed.
        """
        n = len(rates)
        design = np.hstack((np.eye(n), forces))
        step = _step(rates, variances, n - 1)
        latent, covariance = _posterior(design, rates, variances, step, typical)
        for _ in range(_PASSES):
            unexplained = rates - forces @ latent[n:]
            step = np.minimum(step, _step(unexplained, variances, n - 4))
            latent, covariance = _posterior(design, rates, variances, step, typical)
        return cls(latent[:n], latent[n:].T, covariance, step)

    def between(self, before: Rows, after: Rows, forces: Array) -> tuple[Array, Array]:
        """Return the walk half way between two rests, (K, 3) rad/s, and the bias' covariance, (3, K, K).

        before, after: (K,) indices of rests. forces: (K, 3) m/s^2, mean force during the rotation.
        """
        each = np.eye(len(self.walk))
        halves = 0.5 * (each[before] + each[after])
        rows = np.hstack((halves, forces))
        half_way = 0.25 * self.step[:, None, None] ** 2 * np.eye(len(rows))
        return halves @ self.walk, rows @ self.covariance @ rows.T + half_way

    def sensitivity_uncertainty(self) -> Array:
        """Return the standard uncertainty of each element of G, (3, 3)."""
        n = len(self.walk)
        variances: Array = np.diagonal(self.covariance, axis1=1, axis2=2)[:, n:]
        return np.sqrt(variances)


def _step(rates: Array, variances: Array, freedom: int) -> Array:
    """Return the walk between neighbouring rests, (3,) rad/s, from robust differences; always above 0."""
    floor = 1e-4 * np.median(variances, axis=0)
    if len(rates) < 2:
        return np.sqrt(floor)
    spread = MAD_TO_SD * np.median(np.abs(np.diff(rates, axis=0)), axis=0)
    inflated = spread**2 * (len(rates) - 1) / max(freedom, 1)
    return np.sqrt(np.maximum(inflated - 2.0 * np.median(variances, axis=0), floor))


def _posterior(
    design: Array, rates: Array, variances: Array, step: Array, typical: float
) -> tuple[Array, Array]:
    """Return walk and sensitivity, (n + 3, 3), and their covariance for each axis, (3, n + 3, n + 3)."""
    n = len(rates)
    differences = np.diff(np.eye(n), axis=0)
    prior = np.zeros((3, n + 3, n + 3))
    prior[:, :n, :n] = differences.T @ differences / step[:, None, None] ** 2
    prior[:, n:, n:] = np.eye(3) / typical**2
    weighted: Array = design.T / variances.T[:, None, :]
    information: Array = prior + weighted @ design
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    latent: Array = covariance @ (weighted @ rates.T[:, :, None])
    return latent[..., 0].T, covariance
