"""`stillcal diagnose REC --phone PHONE`: a phone file, played through the recording's motion and conditions.

What the phone would have recorded is then a simulation like any other, and judged as one.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec

from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.replay.diagnosis.given_simulation import judge_examined
from stillcal.replay.diagnosis.judged import Judged, ShowStage, examined, named, silent
from stillcal.replay.diagnosis.phone.case import case_of
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.phone import Phone


def judge_phone(
    recording: Recording, phone: Phone, phone_name: str, show_stage: ShowStage = silent
) -> Judged:
    """Compare a recording with a phone. Raises NotSupported on too little data."""
    recorded = examined(recording, show_stage)
    case = case_of(recording, recorded, compare_with_ideal(recorded))
    show_stage(f"simulating {phone_name} with the recording's motion")
    conditions = replace(case.conditions, reference_c=phone.heat.reference_c)
    simulation = named(case.played(phone, conditions), phone_name)
    # Its stamps are those of its own rate, whatever the recording's maker says of the recording's.
    claims = msgspec.structs.replace(simulation.claims, nominal_rate_hz=phone.accel.rate_hz)
    simulation = replace(simulation, claims=claims)
    return replace(judge_examined(recording, recorded, simulation, show_stage), case=case)
