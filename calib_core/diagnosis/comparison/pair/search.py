"""Slow effects in the difference of two sensors' readings, in motion as at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from stillcal.calib_core.diagnosis.comparison.pair.motion import Motion, left_in_motion
from stillcal.calib_core.diagnosis.effects.unknown import SHAKEN
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.findings import slow_statements
from stillcal.calib_core.diagnosis.slow.statement import Stated

EXPLAINED = 0.5
"""Part of the variance in motion that is left beside what was found, below which the search is made anew."""


def examined_in_pair(
    exam: Examination,
    bins: Bins,
    sensors: Sequence[SensorResiduals],
    direct: Sequence[Stated],
    progress: Callable[[float], None] = lambda _share: None,
) -> Examination:
    """Return an examination whose slow effects are those of the pair. direct: what single samples show.

    progress: is called with the share of the sensors that is searched.
    """
    slow: list[Stated] = []
    searched: list[SensorResiduals] = []
    for done, residuals in enumerate(sensors, start=1):
        allowed, stated = _searched(residuals)
        searched.append(allowed)
        slow += stated
        progress(done / len(sensors))
    return replace(exam, bins=bins, sensors=searched, turns=None, statements=[*direct, *slow])


def _searched(residuals: SensorResiduals) -> tuple[SensorResiduals, list[Stated]]:
    """Return residuals whose bins in motion have the variance that they show, and what was found in them.

    That variance is estimated before the search, lest what does not fit in motion looks like an effect, and
    again beside what was found. Where most of it was that, bins in motion tell as well as others, and all are
    searched anew. What is left of it then is a finding itself.
    """
    motion = left_in_motion(residuals)
    if motion is None:
        return residuals, slow_statements(residuals)
    stated, beside = _beside_motion(residuals, motion)
    if (beside.variance < EXPLAINED * motion.variance).any():
        stated, beside = _beside_motion(residuals, beside)
    allowed = beside.allowed(residuals)
    stated = [s if s.hypothesis is None else replace(s, residuals=allowed) for s in stated]
    lack = beside.finding(residuals)
    return allowed, [*stated, *([] if lack is None else [Stated(lack, None, allowed)])]


def _beside_motion(residuals: SensorResiduals, motion: Motion) -> tuple[list[Stated], Motion]:
    """Return what is found where bins in motion have a variance besides, and what they have beside that."""
    stated = slow_statements(motion.allowed(residuals))
    if motion.finding(residuals) is not None:
        stated = [s for s in stated if not _of_shaking(s)]
    found = [s.hypothesis for s in stated if s.hypothesis is not None]
    return stated, (left_in_motion(residuals, found) if found else None) or motion


def _of_shaking(stated: Stated) -> bool:
    """Whether a statement has no name and follows what shakes the device: one of motion says it already."""
    return stated.finding.effect == "unknown" and stated.finding.where.driver == SHAKEN
