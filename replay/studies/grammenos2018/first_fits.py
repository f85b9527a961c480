"""First calibrations from the few states that a paper's phones met, and what is off afterwards.

Grammenos et al. 2018, 4.2. The product's own first fit adds what data sheets say of sound phones
(calib_core/accelerometer/prior.py); the paper's only has to converge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.fit import AccelerometerSettings
from stillcal.calib_core.accelerometer.parameters import basis
from stillcal.calib_core.accelerometer.prior import SOUND_PHONES
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.phone import Phone, draw_rests

UNCHECKED = AccelerometerSettings(max_amplification=np.inf, max_norm_sd=np.inf, spare_attitudes=0)
"""A fit that only has to converge to a phone's accelerometer."""

SCATTER_MG = 1.0
"""mg by axis: a bias differs by about so much from rest to rest of a day, as temperature has it."""


def converged_norms(phones: list[Phone], days: list[Array], seed: int, states: int) -> Array:
    """Return the norm's error over all directions, m/s^2, raw and by a fit to so many states.

    days: the attitudes of each, in order. The fit is only asked to converge; (phones, 2), those left out that
    do not.
    """
    rows = []
    for k, (phone, day) in enumerate(zip(phones, days, strict=True)):
        rests = draw_rests(phone, states, seed + k, attitudes=day[:states])
        raw = _everywhere(phone, seed)
        try:
            model = accelerometer.fit(
                rests.forces, rests.uncertainties, rests.gravity, settings=UNCHECKED
            ).model
        except NotSupported:
            continue
        rows.append([_norm_error(raw), _norm_error(model.apply(raw))])
    return np.array(rows)


@dataclass(frozen=True, slots=True)
class FirstFits:
    """First calibrations from so many states, with what is known of sound phones.

    done: share of phones. held: share of the 95 % intervals that hold the true parameter. worse: number of
    phones whose norms are further off, over all directions, than raw.
    """

    states: int
    done: float
    held: float
    worse: int


def first_fits(
    phones: list[Phone], days: list[Array], seed: int, states: int, scatter_mg: float
) -> FirstFits:
    """Fit each phone to the first of its day's attitudes as the product does. scatter_mg: see SCATTER_MG."""
    done, held, worse = 0, [], 0
    for k, (phone, up) in enumerate(zip(phones, days, strict=True)):
        rests = draw_rests(phone, min(states, len(up)), seed + k, attitudes=up[:states])
        rng = np.random.default_rng([seed, k, states])
        forces = rests.forces + 1e-3 * STANDARD * scatter_mg * rng.standard_normal(rests.forces.shape)
        try:
            fit = accelerometer.fit(forces, rests.uncertainties, rests.gravity, prior=SOUND_PHONES)
        except NotSupported:
            continue
        done += 1
        low, high = fit.interval().T
        truth = true_parameters(phone)[: low.size]
        held.append(np.mean((low <= truth) & (truth <= high)))
        raw = _everywhere(phone, seed)
        worse += int(_norm_error(fit.model.apply(raw)) > _norm_error(raw))
    return FirstFits(states, done / len(phones), float(np.mean(held)) if held else np.nan, worse)


def true_parameters(phone: Phone) -> Array:
    """Return the nine parameters that calibrate a phone's accelerometer but for a common rotation."""
    _, sizes, axes = np.linalg.svd(np.linalg.inv(np.asarray(phone.accel.scale)))
    scale = (axes.T * sizes) @ axes
    return np.asarray(np.linalg.pinv(basis(9)) @ np.r_[phone.accel.bias, scale.ravel()])


def _everywhere(phone: Phone, seed: int) -> Array:
    """Return raw forces of a phone at rest in 200 directions, (200, 3)."""
    up = np.random.default_rng(seed).normal(size=(200, 3))
    up *= STANDARD / np.linalg.norm(up, axis=1, keepdims=True)
    return np.asarray(up @ np.asarray(phone.accel.scale).T + phone.accel.bias)


def _norm_error(forces: Array) -> float:
    """Return the root mean square of norms less gravity."""
    return float(np.sqrt(np.mean(np.square(np.linalg.norm(forces, axis=1) - STANDARD))))
