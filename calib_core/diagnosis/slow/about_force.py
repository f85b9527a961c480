"""The accelerometer's residuals about its own nonlinearity, where rests show one.

The norm of gravity is linear in small errors only. A square of 3 % of the force turns the direction that
gravity is taken to have, and moves the affine parameters it is linear about: what is then left of it is no
square, has no name, and makes scale and bias of a recording false. So the nonlinearity is estimated, taken
off the force, what is left of it is estimated, and so again until nothing is left (Gauss-Newton). About that
point residuals are made anew, with what the nonlinearity does there in them: they are linear in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.by_force import ForceNonlinearity
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Scene
from stillcal.calib_core.diagnosis.model.residuals import fit_baseline
from stillcal.calib_core.diagnosis.model.scenes import of_force
from stillcal.calib_core.diagnosis.slow.estimate import estimate

CHANCE = 1e-3
"""Probability of a nonlinearity as large by chance, from which on residuals are linear as they are."""

ROUNDS = 10
"""Most times that what is left is estimated; each leaves a tenth, or less, of what the one before left."""

SETTLED = 0.1
"""Standard errors by which sizes still change that are no change."""


def about_nonlinearity(scenes: Sequence[Scene]) -> list[Scene]:
    """Return scenes with that of the accelerometer made anew about the nonlinearity that its rests show."""
    return [_anew(s) if s.sensor == "accel" else s for s in scenes]


def _anew(scene: Scene) -> Scene:
    effects = [e for e in (ForceNonlinearity(3), ForceNonlinearity(2)) if e.points(scene.moments)]
    if not effects:
        return scene
    made, own = scene, scene.hypothesis(effects[0], {})
    found = estimate(made, own, [])
    if found.chance() >= CHANCE:
        return scene
    value = found.value
    for _ in range(ROUNDS):
        made = _without(scene, made, own, value)
        own = made.hypothesis(own.effect, {})
        found = estimate(made, own, [])
        value = value + found.value
        if (np.abs(found.value) <= SETTLED * found.sigma).all():
            break
    made = _without(scene, made, own, value)
    own = made.hypothesis(own.effect, {})
    views = (replace(v, y=v.y + c @ value) for v, c in zip(made.views, own.columns, strict=True))
    return replace(made, bins=scene.bins, views=tuple(views))


def _without(scene: Scene, made: Scene, own: Hypothesis, value: Array) -> Scene:
    """Return a scene without a nonlinearity of sizes (k,), as it is at the force of the last scene `made`."""
    error = own.effect.response(made.moments, {}) @ value
    bins = replace(scene.bins, force=scene.bins.force - error)
    baseline = fit_baseline(bins.force, bins.force_variance, bins.rest, scene.gravity)
    return of_force(bins, baseline, scene.gravity, scene.covariates)
