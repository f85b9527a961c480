"""Slow effects in the difference of two sensors' readings, in motion as at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from stillcal.calib_core.diagnosis.comparison.pair.motion import left_in_motion
from stillcal.calib_core.diagnosis.diagnose import Examination
from stillcal.calib_core.diagnosis.effects.unknown import SHAKEN
from stillcal.calib_core.diagnosis.model.hypothesis import Scene
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.findings import Stated, slow_statements


def examined_in_pair(
    exam: Examination,
    bins: Bins,
    scenes: Sequence[Scene],
    direct: Sequence[Stated],
    progress: Callable[[float], None] = lambda _share: None,
) -> Examination:
    """Return an examination whose slow effects are those of the pair. direct: what single samples show.

    progress: is called with the share of the scenes that is searched.
    """
    slow: list[Stated] = []
    searched: list[Scene] = []
    for done, scene in enumerate(scenes, start=1):
        allowed, stated = _searched(scene)
        searched.append(allowed)
        slow += stated
        progress(done / len(scenes))
    return replace(exam, bins=bins, scenes=searched, turns=None, statements=[*direct, *slow])


def _searched(scene: Scene) -> tuple[Scene, list[Stated]]:
    """Return a scene whose bins in motion have the variance that they show, and what was found in it.

    That variance is estimated before the search, lest what does not fit in motion looks like an effect, and
    again beside what was found. What is left of it then is a finding itself.
    """
    motion = left_in_motion(scene)
    if motion is None:
        return scene, slow_statements(scene)
    stated = slow_statements(motion.allowed(scene))
    if motion.finding(scene) is not None:
        stated = [s for s in stated if not _of_shaking(s)]
    found = [s.hypothesis for s in stated if s.hypothesis is not None]
    motion = (left_in_motion(scene, found) if found else None) or motion
    allowed = motion.allowed(scene)
    stated = [s if s.hypothesis is None else replace(s, scene=allowed) for s in stated]
    lack = motion.finding(scene)
    return allowed, [*stated, *([] if lack is None else [Stated(lack, None, allowed)])]


def _of_shaking(stated: Stated) -> bool:
    """Whether a statement has no name and follows what shakes the device: one of motion says it already."""
    return stated.finding.effect == "unknown" and stated.finding.where.driver == SHAKEN
