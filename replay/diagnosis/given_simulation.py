"""`stillcal diagnose REC --simulated SIM`: where SIM differs from REC, by what physics, by how much.

Other motion, another rate and another length do not matter: both are fitted by the same model.
"""

from __future__ import annotations

from stillcal.calib_core.diagnosis.comparison.compare import Comparison, compare
from stillcal.calib_core.diagnosis.diagnose import Examination
from stillcal.replay.diagnosis.answer import Fit, answer_of, findings_stated
from stillcal.replay.diagnosis.corrected import Corrected, correct
from stillcal.replay.diagnosis.judged import Judged, ShowStage, examined, silent, without_left_out
from stillcal.replay.formats.trace import Recording


def judge_simulation(recording: Recording, simulation: Recording, show_stage: ShowStage = silent) -> Judged:
    """Compare a recording with a simulation's. Raises NotSupported where either has too little data."""
    return judge_examined(recording, examined(recording, show_stage), simulation, show_stage)


def judge_examined(
    recording: Recording, recorded: Examination, simulation: Recording, show_stage: ShowStage = silent
) -> Judged:
    """Compare a recording that was examined with a simulation's."""
    names = (recording.name, simulation.name)
    simulated = examined(simulation, show_stage)
    show_stage("comparing")
    before = compare(recorded, simulated, names)
    after, corrected, fit = None, None, Fit(before.p, before.p)
    if before.discrepancies:
        corrected = _corrected(simulation, before)
        again = examined(
            corrected.recording, show_stage, name=f"{simulation.name} with the differences put in"
        )
        after = compare(recorded, again, names)
        fit = Fit(before.p, without_left_out(after, corrected.left_out), corrected.left_out)
    stated = findings_stated([s.finding for s in recorded.statements], "recorded")
    stated |= findings_stated([s.finding for s in simulated.statements], "simulated")
    answer = answer_of(before, names, fit, stated)
    played = None if corrected is None else corrected.recording
    return Judged(recording, recorded, simulated, before, after, played, answer)


def _corrected(simulation: Recording, before: Comparison) -> Corrected:
    """Return the simulation with the differences put in, its biases known as they were measured."""
    biases = {
        d.simulated.sensor: d.simulated.value
        for d in before.compared
        if d.simulated.effect in ("accel_bias", "gyro_bias")
    }
    return correct(simulation, before.discrepancies, biases)
