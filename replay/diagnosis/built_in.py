"""`stillcal diagnose REC`: against an ideal affine sensor with plain noise, moved as the recording moved.

The corrected simulation is a phone with the effects found: it is played through the recording's own motion
and compared with the recording as any other simulation is.
"""

from __future__ import annotations

from collections.abc import Collection

from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.replay.diagnosis.answer import Fit, answer_of
from stillcal.replay.diagnosis.corrected import with_known
from stillcal.replay.diagnosis.judged import Judged, ShowStage, examined, named, silent
from stillcal.replay.diagnosis.phone.case import Case, case_of
from stillcal.replay.diagnosis.words.names import BUILT_IN
from stillcal.replay.formats.trace import Recording


def judge_built_in(
    recording: Recording,
    name: str = "",
    show_stage: ShowStage = silent,
    *,
    without: Collection[str] = (),
) -> Judged:
    """Compare a recording with the built-in simulation.

    name: of the recording, where it is not its own. without: effects of which the catalogue knows nothing.
    Raises NotSupported on too little data.
    """
    names = (name or recording.name, BUILT_IN)
    recorded = examined(recording, show_stage, without=without)
    show_stage("comparing", 0.0)
    before = compare_with_ideal(recorded)
    case = case_of(recording, recorded, before)
    fit, after, corrected = Fit.of(before, before, case.not_in_phone()), None, None
    found = {id(s.finding) for s in recorded.statements}
    if any(id(d.recorded) in found for d in before.discrepancies):
        fit, after, corrected = _played(case, recorded, before, names, show_stage)
    answer = answer_of(before, names, fit, {}, recorded.bins.temperature)
    return Judged(recording, recorded, None, before, after, corrected, answer, case)


def _played(
    case: Case, recorded: Examination, before: Comparison, names: tuple[str, str], show_stage: ShowStage
) -> tuple[Fit, Comparison | None, Recording | None]:
    """Play the phone with the effects found and compare it; nothing is played where nothing is at rest."""
    if not len(case.bins):
        return Fit.of(before, None, case.not_in_phone()), None, None
    show_stage("simulating the recording's motion with the effects found", 0.0)
    corrected = named(with_known(case.played(case.phone()), case.beside), f"{BUILT_IN}, corrected")
    beside = {known.effect.name for known in case.beside}
    left_out = [effect for effect in case.not_in_phone() if effect not in beside]
    again, turning = _found_again(recorded), _of_turns(recorded)
    measured = examined(corrected, show_stage, sought=again, of_turns=turning, within=recorded.bins)
    after = compare(recorded, measured, names, played=True)
    return Fit.of(before, after, left_out).without_own_constants(), after, corrected


def _of_turns(recorded: Examination) -> list[Stated]:
    """Return the named effects of the rate of turn, which the corrected simulation has too.

    A large one is measured about itself in both, for it goes with powers of the true rate.
    """
    named = (s for s in recorded.statements if s.hypothesis and s.finding.effect != "unknown")
    return [s for s in named if s.residuals is not None and s.residuals.turns]


def _found_again(recorded: Examination) -> list[Hypothesis]:
    """Return the effects that must be found again in the corrected simulation.

    What another recording can have as well is measured in both. What comes at a moment must be found again,
    and with it what it was found beside: alone, one of two may not stand out of what the other does.
    """
    named = [s.hypothesis for s in recorded.statements if s.hypothesis and s.finding.effect != "unknown"]
    sensors = {h.effect.sensor for h in named if h.effect.recurs}
    return [h for h in named if h.effect.sensor in sensors]
