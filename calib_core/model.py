"""The affine sensor model by which all readings are corrected: calibrated = scale @ (raw - bias).

Grammenos et al. 2018, Eq. 2 (accelerometer) and Eq. 9 (gyroscope).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.samples import Samples


@dataclass(frozen=True, slots=True, eq=False)
class SensorModel:
    """The correction of one triaxial sensor. scale: (3, 3), dimensionless; bias: (3,) in raw units."""

    scale: Array
    bias: Array

    @classmethod
    def of(cls, scale: ArrayLike, bias: ArrayLike) -> SensorModel:
        """Build from array-like values. Raises ValueError on a wrong shape or a non-finite value."""
        model = cls(frozen(scale), frozen(bias))
        if model.scale.shape != (3, 3) or model.bias.shape != (3,):
            shapes = f"scale {model.scale.shape} and bias {model.bias.shape}"
            raise ValueError(f"{shapes}: expected (3, 3) and (3,)")
        if not (np.isfinite(model.scale).all() and np.isfinite(model.bias).all()):
            raise ValueError("scale and bias must be finite")
        return model

    @classmethod
    def identity(cls) -> SensorModel:
        """Return the model that changes nothing."""
        return cls.of(np.eye(3), np.zeros(3))

    def apply(self, raw: Array) -> Array:
        """Correct raw readings, shape (..., 3), to calibrated ones of the same shape (Eq. 2).

        >>> model = SensorModel.of(scale=np.diag([2.0, 1.0, 1.0]), bias=[1.0, 0.0, 0.5])
        >>> model.apply(np.array([[2.0, 0.0, 9.5], [1.0, 1.0, 0.5]]))
        array([[2., 0., 9.],
               [0., 1., 0.]])
        """
        return (raw - self.bias) @ self.scale.T

    def correct(self, samples: Samples) -> Samples:
        """Return a run of samples with calibrated readings; stamps and temperature stay as they are."""
        return replace(samples, xyz=self.apply(samples.xyz))
