"""The hourly check (Grammenos et al. 2018, 4.7), and whether a new calibration deserves the old one's place.

"Checking for calibration quality is much faster and easier than trying to gather potential states":
the norm of a rest is held against local gravity, the gyroscope against zero, and a table says what
follows. Every difference is judged against its own uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.rest_pool import HeldRest
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import force_uncertainties, forces

Number = float | Array

_ALL_FLIPS = 12
_OUTVOTED = 3  # rests: one that is off among no more than these is not told from a change


@dataclass(frozen=True, slots=True)
class QualitySettings:
    """What counts as drift: larger than `significance` standard deviations and than the limits.

    accel_limit: m/s^2 of the rest's norm. gyro_limit: rad/s. chance: of taking a new calibration that is
    no better than the old one. held_out_rests: how many rests it takes to tell.
    """

    significance: float = 3.0
    accel_limit: float = 0.02
    gyro_limit: float = 0.001
    chance: float = 0.025
    held_out_rests: int = 6

    def __post_init__(self) -> None:
        for name in ("significance", "accel_limit", "gyro_limit"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be positive")
        if not 0 < self.chance < 0.5:
            raise ValueError(f"chance = {self.chance}: must be within 0..0.5")
        if 2.0**-self.held_out_rests > self.chance:
            raise ValueError(
                f"held_out_rests = {self.held_out_rests}: too few to tell at chance {self.chance}"
            )


class Drift(StrEnum):
    """What a check found of one sensor."""

    NONE = "none"
    DRIFTED = "drifted"
    UNKNOWN = "unknown"


class Verdict(StrEnum):
    """What follows from a check.

    The gyroscope is zeroed at every check that does not ask for more (4.7): `zero gyro` says that it had
    drifted beyond its limit, `keep` that it had not.
    """

    WAIT = "wait"
    KEEP = "keep"
    ZERO_GYRO = "zero gyro"
    RECALIBRATE = "recalibrate"


VERDICTS: dict[tuple[Drift, Drift], Verdict] = {
    (Drift.UNKNOWN, Drift.UNKNOWN): Verdict.WAIT,
    (Drift.UNKNOWN, Drift.NONE): Verdict.WAIT,
    (Drift.UNKNOWN, Drift.DRIFTED): Verdict.WAIT,
    (Drift.NONE, Drift.UNKNOWN): Verdict.KEEP,
    (Drift.NONE, Drift.NONE): Verdict.KEEP,
    (Drift.NONE, Drift.DRIFTED): Verdict.ZERO_GYRO,
    (Drift.DRIFTED, Drift.UNKNOWN): Verdict.RECALIBRATE,
    (Drift.DRIFTED, Drift.NONE): Verdict.RECALIBRATE,
    (Drift.DRIFTED, Drift.DRIFTED): Verdict.RECALIBRATE,
}
"""(accelerometer, gyroscope) -> what follows. The accelerometer decides on a full recalibration (4.7)."""


@dataclass(frozen=True, slots=True)
class Check:
    """One check. accel_residual: m/s^2, mean norm less gravity; gyro_residual: rad/s, largest axis.

    Each with its standard uncertainty; None where no rest told. rests: how many took part; rests_off: of
    these, how many are off by themselves; off_since: s, when the first of them began.
    """

    accelerometer: Drift
    gyroscope: Drift
    verdict: Verdict
    rests: int
    rests_off: int = 0
    off_since: float | None = None
    accel_residual: float | None = None
    accel_uncertainty: float | None = None
    gyro_residual: float | None = None
    gyro_uncertainty: float | None = None


def norm_residuals(model: SensorModel, held: Sequence[HeldRest]) -> tuple[Array, Array]:
    """Return each rest's calibrated norm less local gravity, and its standard uncertainty, (n,) m/s^2.

    The uncertainty holds the rest's own mean, carried through the model along the direction of gravity.
    """
    rests = [h.rest for h in held]
    calibrated = model.apply(forces(rests))
    norm = np.linalg.norm(calibrated, axis=1)
    along = (calibrated / norm[:, None]) @ model.scale
    own = np.linalg.norm(along * force_uncertainties(rests), axis=1)
    return norm - np.array([h.gravity.value for h in held]), own


def check(
    accelerometer: SensorModel,
    norm_uncertainty: float,
    gyro_bias: Array | None,
    held: Sequence[HeldRest],
    settings: QualitySettings,
) -> Check:
    """Hold rests taken since the last check against the current calibration.

    norm_uncertainty: m/s^2, what the calibration itself leaves open in a norm, the repeatability of
    rests included. gyro_bias: (3,) rad/s or None. The accelerometer has drifted where two rests are off
    (a change of bias lengthens one norm and shortens another, and their mean does not show it), or the mean
    is. One rest alone may be a bad one: among few it waits for more, by many it is outvoted.
    """
    if not held:
        return Check(Drift.UNKNOWN, Drift.UNKNOWN, Verdict.WAIT, 0)
    residual, own = norm_residuals(accelerometer, held)
    accel = _weighted_mean(residual, own, norm_uncertainty)
    off = _off(residual, np.hypot(own, norm_uncertainty), settings.significance, settings.accel_limit)
    off_since = held[int(off.argmax())].rest.t_start if off.any() else None
    gyro = _rate_residual(gyro_bias, held)
    accel_drift = _accel_drift(residual, own, norm_uncertainty, settings)
    gyro_drift = _drift(gyro, settings.significance, settings.gyro_limit)
    verdict = VERDICTS[accel_drift, gyro_drift]
    return Check(
        accel_drift,
        gyro_drift,
        verdict,
        len(held),
        int(off.sum()),
        off_since,
        *accel,
        *(gyro or (None, None)),
    )


def _accel_drift(residual: Array, own: Array, norm_uncertainty: float, settings: QualitySettings) -> Drift:
    """Tell whether two rests are off, or the mean is without the one that is most off."""
    apart = np.abs(residual) / np.hypot(own, norm_uncertainty)
    off = _off(residual, np.hypot(own, norm_uncertainty), settings.significance, settings.accel_limit)
    if off.sum() >= 2:
        return Drift.DRIFTED
    if off.sum() == 1 and residual.size <= _OUTVOTED:
        return Drift.UNKNOWN
    rest = np.arange(residual.size) != apart.argmax()
    if not rest.any():
        return Drift.NONE
    mean = _weighted_mean(residual[rest], own[rest], norm_uncertainty)
    return _drift(mean, settings.significance, settings.accel_limit)


def _weighted_mean(values: Array, own: Array, common: float) -> tuple[float, float]:
    """Return the mean of residuals that share one common error, and its standard uncertainty."""
    weight = 1 / np.maximum(own, 1e-9) ** 2
    mean = float(weight @ values / weight.sum())
    return mean, float(np.hypot(1 / np.sqrt(weight.sum()), common))


def _rate_residual(bias: Array | None, held: Sequence[HeldRest]) -> tuple[float, float] | None:
    """Return the largest axis of (mean rate at rest - bias) and its uncertainty; None without a rate."""
    seen = [h.rest for h in held if h.rest.rate is not None and h.rest.rate_uncertainty is not None]
    if bias is None or not seen:
        return None
    weight = 1 / np.maximum(np.array([r.rate_uncertainty for r in seen]), 1e-9) ** 2
    mean = (weight * np.array([r.rate for r in seen])).sum(axis=0) / weight.sum(axis=0) - bias
    axis = int(np.abs(mean).argmax())
    return float(mean[axis]), float(1 / np.sqrt(weight.sum(axis=0)[axis]))


def _drift(found: tuple[float, float] | None, significance: float, limit: float) -> Drift:
    if found is None:
        return Drift.UNKNOWN
    return Drift.DRIFTED if _off(*found, significance, limit) else Drift.NONE


def _off(residual: Number, uncertainty: Number, significance: float, limit: float) -> NDArray[np.bool_]:
    """Tell whether residuals are larger than their uncertainty explains, and large enough to matter."""
    return np.asarray(np.abs(residual) > np.maximum(limit, significance * np.asarray(uncertainty)))


@dataclass(frozen=True, slots=True)
class Comparison:
    """A new calibration against the old one on rests that neither was fitted to.

    gain: mean log score per rest that the new one gains; chance: how often swapping the two at random
    would gain as much; rms_old, rms_new: m/s^2 over the held-out rests. `better`: more than chance.
    """

    rests: int
    gain: float
    chance: float
    rms_old: float
    rms_new: float
    better: bool


def compare(old: Array, new: Array, sd: Array, settings: QualitySettings) -> Comparison:
    """Compare held-out residuals of the old and the new calibration, (n,) each, m/s^2.

    sd: (n,) standard uncertainty of each residual, shared by both, so that a score cannot be won by
    claiming certainty. The gain is a paired mean of Gaussian log scores. Were the two equally good,
    each rest might as well have had them the other way round: that is what the gain is held against
    (a sign-flip test, Fisher 1935), whatever its distribution.
    """
    gains = (old**2 - new**2) / (2 * sd**2)
    n = gains.size
    chance = _flipped_share(gains) if n else 1.0
    rms_old, rms_new = (float(np.sqrt(np.mean(r**2))) if n else 0.0 for r in (old, new))
    better = n >= settings.held_out_rests and chance <= settings.chance
    return Comparison(n, float(gains.mean()) if n else 0.0, chance, rms_old, rms_new, better)


def _flipped_share(gains: Array) -> float:
    """Return the share of sign patterns, all or 4096 drawn ones, whose sum reaches that of `gains`."""
    n = gains.size
    if n <= _ALL_FLIPS:
        signs = 1 - 2 * (np.arange(2**n)[:, None] >> np.arange(n) & 1)
    else:
        drawn = np.random.default_rng(n).integers(0, 2, (2**_ALL_FLIPS, n))
        signs = np.vstack((np.ones(n, dtype=np.int64), 1 - 2 * drawn))
    return float(np.mean(signs @ gains >= gains.sum() * (1 - 1e-12)))
