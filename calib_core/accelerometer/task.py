"""What an accelerometer's fit is given: its settings, and rests in units of gravity for one model.

Arrays are checked here, once; the fit is accelerometer.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.accelerometer import observability as attitudes
from stillcal.calib_core.accelerometer.equations import Norms
from stillcal.calib_core.accelerometer.observability import Attitude
from stillcal.calib_core.accelerometer.parameters import Form, basis
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.levenberg_marquardt import Damping
from stillcal.calib_core.static.rest import attitude_labels


@dataclass(frozen=True, slots=True)
class AccelerometerSettings:
    """What a fit asks of its rests, and how it proceeds.

    damping: of the Gauss-Newton steps. attitude_angle: rad, rests nearer than this share an attitude.
    max_amplification: the calibrated norm may be known, along the worst direction, this many times worse
    than one rest is measured. The default sets what an omitted 1 % of cross-axis sensitivity costs (a
    phone's MEMS datasheet figure; half of it, 0.05 m/s^2, along the worst direction) against the 0.01 m/s^2
    by which a phone's rests scatter: beyond it, leaving the cross-axis terms out does less harm.
    max_norm_sd: m/s^2, the same cost as a bound on the outcome. spare_attitudes: how many more than
    parameters "auto" wants before it takes more than 6, so that the fit can be checked at all.
    outlier_level: chance of dropping any rest where none is bad; 0 drops none. max_outliers: most rests
    dropped, as a fraction. max_bias: m/s^2 and max_scale_error: beyond these it is not a phone's
    accelerometer. rounds: of reweighting.
    """

    damping: Damping = field(default_factory=Damping)
    attitude_angle: float = 0.0872665  # 5 degrees
    max_amplification: float = 5.0
    max_norm_sd: float = 0.05
    spare_attitudes: int = 1
    outlier_level: float = 0.01
    max_outliers: float = 0.2
    max_bias: float = 5.0
    max_scale_error: float = 0.3
    rounds: int = 10

    def __post_init__(self) -> None:
        for name, low, high in (
            ("attitude_angle", 0.0, 1.0),
            ("max_amplification", 1.0, np.inf),
            ("max_norm_sd", 0.0, np.inf),
            ("spare_attitudes", 0, 100),
            ("outlier_level", 0.0, 0.5),
            ("max_outliers", 0.0, 0.5),
            ("max_bias", 0.0, np.inf),
            ("max_scale_error", 0.0, 1.0),
            ("rounds", 1, 1000),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} is {getattr(self, name)}: allowed {low} to {high}")


class AttitudesMissing(NotSupported):
    """The attitudes do not support the model. attitudes: those to add, with their unit directions."""

    def __init__(self, reason: str, wanted: tuple[Attitude, ...]) -> None:
        super().__init__(reason, [a.words for a in wanted])
        self.attitudes = wanted


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """One model to be fitted. least: distinct attitudes wanted; local: (n,) gravity, m/s^2."""

    norms: Norms
    parameters: int
    form: Form
    least: int
    local: Array
    gravity_uncertainty: float
    settings: AccelerometerSettings

    @property
    def g(self) -> float:
        """The unit of `norms`, m/s^2."""
        return float(self.local.mean())

    def supported_by(self, rests: Norms, least: int) -> bool:
        """Tell whether these rests' attitudes determine the model well enough."""
        up = rests.directions()
        if len(up) < least:
            return False
        return attitudes.amplification(up, self.parameters) <= self.settings.max_amplification


def task_of(  # noqa: PLR0917 - `fit`'s own arguments, in its order
    forces: ArrayLike,
    uncertainties: ArrayLike | None,
    gravity: ArrayLike,
    gravity_uncertainty: float,
    parameters: int,
    form: Form,
    settings: AccelerometerSettings,
) -> Task:
    """Check the arrays and put them in units of gravity.

    Raises ValueError on arrays that do not fit, NotSupported where they seem to be multiples of g, and
    AttitudesMissing where there is no rest.
    """
    raw = np.asarray(forces, dtype=np.float64).reshape(-1, 3) if np.size(forces) == 0 else np.asarray(forces)
    sd = np.zeros(raw.shape) if uncertainties is None else np.asarray(uncertainties, dtype=np.float64)
    _check_arrays(raw, sd.reshape(raw.shape) if raw.size == 0 else sd)
    local = np.array(np.broadcast_to(np.asarray(gravity, dtype=np.float64), len(raw)))
    if not (np.isfinite(local).all() and (local > 0.0).all() and gravity_uncertainty >= 0.0):
        raise ValueError("gravity must be positive and its uncertainty not negative")
    if len(raw) == 0:
        wanted = attitudes.missing_attitudes(raw, 6, settings.max_amplification, 6)
        raise AttitudesMissing("there is no rest", wanted)
    g = float(local.mean())
    _check_unit(raw, g)
    own_form: Form = "symmetric" if parameters == 12 else form
    labels = attitude_labels(raw, settings.attitude_angle)
    norms = Norms(raw / g, sd / g, local / g, labels, basis(min(parameters, 9), own_form))
    least = min(parameters, 9)
    return Task(norms, parameters, own_form, least, local, gravity_uncertainty, settings)


def _check_arrays(raw: Array, sd: Array) -> None:
    if raw.ndim != 2 or raw.shape[1] != 3:
        raise ValueError(f"forces have shape {raw.shape}: expected (n, 3)")
    if sd.shape != raw.shape:
        raise ValueError(f"uncertainties have shape {sd.shape}: expected {raw.shape}")
    if not (np.isfinite(raw).all() and np.isfinite(sd).all() and (sd >= 0.0).all()):
        raise ValueError("forces and uncertainties must be finite, uncertainties not negative")


def _check_unit(raw: Array, gravity: float) -> None:
    norm = float(np.median(np.linalg.norm(raw, axis=1)))
    if 0.5 < norm < 2.0 < gravity:
        reason = f"the forces' norm is about {norm:.2f}: these look like multiples of g, not m/s^2"
        raise NotSupported(reason, ["the same rests in m/s^2 (multiply by 9.80665)"])
