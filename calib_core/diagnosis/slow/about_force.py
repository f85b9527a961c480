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

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.by_force import ForceNonlinearity
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Scene, together
from stillcal.calib_core.diagnosis.model.residuals import fit_baseline
from stillcal.calib_core.diagnosis.model.scenes import of_force
from stillcal.calib_core.diagnosis.slow.estimate import estimate
from stillcal.calib_core.diagnosis.slow.findings import Stated, slow_statements
from stillcal.calib_core.diagnosis.slow.taken_off import Known

CHANCE = 1e-3
"""Probability of a nonlinearity as large by chance, from which on residuals are linear as they are."""

ROUNDS = 10
"""Most times that what is left is estimated; each leaves a tenth, or less, of what the one before left."""

SETTLED = 0.1
"""Standard errors by which sizes still change that are no change."""


def about_nonlinearity(scenes: Sequence[Scene]) -> list[Scene]:
    """Return scenes with that of the accelerometer made anew about the nonlinearity that its rests show."""
    return [_about(s, _nonlinearity(s)) if s.sensor == "accel" else s for s in scenes]


def searched(scene: Scene, without: Collection[str] = ()) -> tuple[Scene, list[Stated]]:
    """Return what the still bins of one sensor show, and the scene about that point.

    without: effects that are left out of the catalogue. The point is that of a first search's named effects.
    """
    stated = slow_statements(scene, without)
    made = _about(scene, _point(scene, stated)) if scene.sensor == "accel" else scene
    return made, stated if made is scene else slow_statements(made, without)


def _nonlinearity(scene: Scene) -> list[Hypothesis]:
    """Return the accelerometer's nonlinearity where its rests show one; else nothing."""
    effects = [e for e in (ForceNonlinearity(3), ForceNonlinearity(2)) if e.points(scene.moments)]
    own = [scene.hypothesis(e, {}) for e in effects[:1]]
    return [h for h in own if estimate(scene, h, []).chance() < CHANCE]


def _point(scene: Scene, stated: Sequence[Stated]) -> list[Hypothesis]:
    """Return the effects that a scene was found to have and that tell what they add to the force."""
    named = [scene.hypothesis(one.effect, one.grid) for one in Known.among(stated)]
    if not named or any(isinstance(h.effect, ForceNonlinearity) for h in named):
        return named
    return [*named, *_nonlinearity(scene)]


def _about(scene: Scene, effects: Sequence[Hypothesis]) -> Scene:
    """Return a scene about effects of the sizes that its rests show; itself where that is no change."""
    made, own, value = scene, list(effects), np.zeros(sum(h.sizes.size for h in effects))
    for done in range(ROUNDS + 1 if own else 0):
        found = estimate(made, together(made, own), [])
        value = value + found.value
        settled = bool((np.abs(found.value) <= SETTLED * found.sigma).all())
        if settled and done <= 1:
            return scene
        made = _without(scene, made, own, value)
        own = [made.hypothesis(h.effect, h.grid) for h in own]
        if settled:
            break
    if made is scene:
        return scene
    columns = together(made, own).columns
    views = (replace(v, y=v.y + c @ value) for v, c in zip(made.views, columns, strict=True))
    return replace(made, bins=scene.bins, views=tuple(views))


def _without(scene: Scene, made: Scene, own: Sequence[Hypothesis], value: Array) -> Scene:
    """Return a scene without effects of sizes (k,), as they are at the force of the last scene `made`."""
    response = np.concatenate([h.effect.response(made.moments, h.grid) for h in own], axis=2)
    bins = replace(scene.bins, force=scene.bins.force - response @ value)
    baseline = fit_baseline(bins.force, bins.force_variance, bins.rest, scene.gravity)
    return of_force(bins, baseline, scene.gravity, scene.covariates)
