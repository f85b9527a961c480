"""The accelerometer's residuals about what its rests show of it: its own nonlinearity, and effects found.

The norm of gravity is linear in small errors only. A square of 3 % of the force turns the direction that
gravity is taken to have, and moves the affine parameters it is linear about: what is then left of it is no
square, has no name, and makes scale and bias of a recording false. So the nonlinearity is estimated, taken
off the force, what is left of it is estimated, and so again until nothing is left (Gauss-Newton). About that
point residuals are made anew, with what the nonlinearity does there in them: they are linear in it.

So it is with a bias that changes by 60 mm/s^2. The affine parameters are those of its mean and of what
attitudes make of the rest. What is left of the slope about these had the names of a nonlinearity or of slow
noise. So what a search finds is the point of a second search.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.by_force import ForceNonlinearity
from stillcal.calib_core.diagnosis.inference.noise_models import of_same_noise
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals, together
from stillcal.calib_core.diagnosis.model.residuals import fit_baseline
from stillcal.calib_core.diagnosis.model.sensor_residuals import of_force
from stillcal.calib_core.diagnosis.slow.estimate import estimate
from stillcal.calib_core.diagnosis.slow.findings import slow_statements
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.taken_off import Known

CHANCE = 1e-3
"""Probability of a nonlinearity as large by chance, from which on residuals are linear as they are."""

ROUNDS = 10
"""Most times that what is left is estimated; each leaves a tenth, or less, of what the one before left."""

SETTLED = 0.1
"""Standard errors by which sizes still change that are no change."""


def about_nonlinearity(sensors: Sequence[SensorResiduals]) -> list[SensorResiduals]:
    """Return both sensors' residuals, the accelerometer's anew about the nonlinearity that its rests show."""
    return [about_point(s, _nonlinearity(s)) if s.sensor == "accel" else s for s in sensors]


def searched(
    residuals: SensorResiduals, search: Callable[[SensorResiduals], list[Stated]] = slow_statements
) -> tuple[SensorResiduals, list[Stated]]:
    """Return what a search states of the still bins of one sensor, and the residuals about that point.

    The point is that of a first search's named effects.
    """
    stated = search(residuals)
    made = about_point(residuals, _point(residuals, stated)) if residuals.sensor == "accel" else residuals
    return made, stated if made is residuals else search(made)


def _nonlinearity(residuals: SensorResiduals) -> list[Hypothesis]:
    """Return the accelerometer's nonlinearity where its rests show one; else nothing."""
    effects = [e for e in (ForceNonlinearity(3), ForceNonlinearity(2)) if e.points(residuals.moments)]
    own = [residuals.hypothesis(e, {}) for e in effects[:1]]
    return [h for h in own if estimate(residuals, h, []).chance() < CHANCE]


def _point(residuals: SensorResiduals, stated: Sequence[Stated]) -> list[Hypothesis]:
    """Return the effects that were found in residuals and that tell what they add to the force."""
    named = [residuals.hypothesis(one.effect, one.grid) for one in Known.among(stated)]
    if not named or any(isinstance(h.effect, ForceNonlinearity) for h in named):
        return named
    return [*named, *_nonlinearity(residuals)]


def about_point(residuals: SensorResiduals, effects: Sequence[Hypothesis]) -> SensorResiduals:
    """Return residuals about effects of the sizes that rests show; the same ones where that is no change."""
    made, own, value = residuals, list(effects), np.zeros(sum(h.sizes.size for h in effects))
    for done in range(ROUNDS + 1 if own else 0):
        found = estimate(made, together(made, own), [])
        value = value + found.value
        settled = bool((np.abs(found.value) <= SETTLED * found.sigma).all())
        if settled and done <= 1:
            return residuals
        made = _without(residuals, made, own, value)
        own = [made.hypothesis(h.effect, h.grid) for h in own]
        if settled:
            break
    if made is residuals:
        return residuals
    # Also in views in which it is not sought: it was taken off the force that all of them are made of.
    columns = made.columns_of(_response(made, own))
    views = tuple(
        of_same_noise(replace(v, y=v.y + c @ value), v) for v, c in zip(made.views, columns, strict=True)
    )
    return replace(made, bins=residuals.bins, views=views)


def _without(
    residuals: SensorResiduals, made: SensorResiduals, own: Sequence[Hypothesis], value: Array
) -> SensorResiduals:
    """Return residuals without effects of sizes (k,), as they are at the force of those `made` last."""
    bins = replace(residuals.bins, force=residuals.bins.force - _response(made, own) @ value)
    baseline = fit_baseline(bins.force, bins.force_variance, bins.rest, residuals.gravity)
    return of_force(bins, baseline, residuals.gravity, residuals.covariates)


def _response(residuals: SensorResiduals, own: Sequence[Hypothesis]) -> Array:
    """Return what the sizes of effects do to the force in every bin, (n, 3, k)."""
    return np.concatenate([h.effect.response(residuals.moments, h.grid) for h in own], axis=2)
