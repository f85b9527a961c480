"""The gyroscope's bias followed from rest to rest: a slow walk plus what gravity adds to it.

Real gyroscopes feel force: about 0.1 deg/s for each g (Bosch BMI270, Android compatibility definition
7.3.4), which over a turn of seconds outweighs every other error. So the bias at a rest is modelled as
walk_i + G f_i, both estimated from the rests' mean rates. Which bias a turn had is answered here; what
the turn then says about the scale is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

Rows = NDArray[np.intp]

_PASSES = 4  # each divides what of G is still taken for walk by about ten
_MAD_TO_SD = 1.4826  # of a normal distribution


@dataclass(frozen=True, slots=True, eq=False)
class BiasTrajectory:
    """Bias over n rests in time order. walk: (n, 3) rad/s, the part that force does not explain.

    sensitivity: (3, 3) G, (rad/s)/(m/s^2), row by rate, column by force. covariance: (3, n + 3, n + 3) for
    each axis of the walk, then of its row of G. step: (3,) rad/s, what the walk moves between rests.
    """

    walk: Array
    sensitivity: Array
    covariance: Array
    step: Array

    @classmethod
    def of(cls, rates: Array, variances: Array, forces: Array, typical: float) -> BiasTrajectory:
        """Follow the bias through n rests: mean rates and their variances, calibrated forces, all (n, 3).

        typical: (rad/s)/(m/s^2), standard size of an element of G before anything is seen. The walk's
        step is what neighbours differ by beyond their own uncertainty, so a bias that stays is pooled
        over the rests and one that wanders is followed.
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
        """Return the walk half way between two rests, (K, 3), and the whole bias' covariance, (3, K, K).

        before, after: (K,) indices of rests. forces: (K, 3) m/s^2, mean force while turning.
        """
        each = np.eye(len(self.walk))
        halves = 0.5 * (each[before] + each[after])
        rows = np.hstack((halves, forces))
        strayed = 0.25 * self.step[:, None, None] ** 2 * np.eye(len(rows))
        return halves @ self.walk, rows @ self.covariance @ rows.T + strayed

    def sensitivity_uncertainty(self) -> Array:
        """Return the standard uncertainty of each element of G, (3, 3)."""
        n = len(self.walk)
        variances: Array = np.diagonal(self.covariance, axis1=1, axis2=2)[:, n:]
        return np.sqrt(variances)


def _step(rates: Array, variances: Array, freedom: int) -> Array:
    """Walk between neighbouring rests, (3,) rad/s, from robust differences; never quite none."""
    floor = 1e-4 * np.median(variances, axis=0)
    if len(rates) < 2:
        return np.sqrt(floor)
    spread = _MAD_TO_SD * np.median(np.abs(np.diff(rates, axis=0)), axis=0)
    inflated = spread**2 * (len(rates) - 1) / max(freedom, 1)
    return np.sqrt(np.maximum(inflated - 2.0 * np.median(variances, axis=0), floor))


def _posterior(
    design: Array, rates: Array, variances: Array, step: Array, typical: float
) -> tuple[Array, Array]:
    """Solve for walk and sensitivity: (n + 3, 3) and its covariance for each axis, (3, n + 3, n + 3)."""
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
