"""`stillcal diagnose REC --phone PHONE`: a phone file, played through the recording's motion and conditions.

What the phone would have recorded is then a simulation like any other, and judged as one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec

from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.replay.diagnosis.corrected import Corrected, with_known
from stillcal.replay.diagnosis.given_simulation import judge_examined
from stillcal.replay.diagnosis.judged import Judged, ShowStage, examined, named, silent
from stillcal.replay.diagnosis.phone.case import case_of
from stillcal.replay.export.fix.fixers import fixed_for
from stillcal.replay.export.fix.phone import phone_from
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.phone import Phone, dump_phone


def judge_phone(
    recording: Recording, phone: Phone, phone_name: str, show_stage: ShowStage = silent
) -> Judged:
    """Compare a recording with a phone. Raises NotSupported on too little data.

    The corrected simulation is the phone that `--fix-for phone` writes, played again, with the effects that
    no phone file can have put into its samples.
    """
    recorded = examined(recording, show_stage)
    case = case_of(recording, recorded, compare_with_ideal(recorded))

    def played(one: Phone) -> Recording:
        show_stage(f"simulating {phone_name} with the recording's motion", 0.0)
        conditions = replace(case.conditions, reference_c=one.heat.reference_c)
        simulation = named(case.played(one, conditions), phone_name)
        # Its stamps are those of its own rate, whatever the recording's maker says of the recording's.
        claims = msgspec.structs.replace(simulation.claims, nominal_rate_hz=one.accel.rate_hz)
        return replace(simulation, claims=claims)

    def again(_before: Comparison, answer: dict[str, Any]) -> Corrected:
        fixed = fixed_for("phone", dump_phone(phone), answer)
        beside = {known.effect.name for known in case.beside}
        left_out = [effect for effect in fixed.left_out if effect not in beside]
        return Corrected(with_known(played(phone_from(fixed.text)), case.beside), left_out)

    simulation = played(phone)
    simulated = examined(simulation, show_stage, within=recorded.bins)
    judged = judge_examined(recording, recorded, simulation, simulated, again, show_stage=show_stage)
    return replace(judged, case=case)
