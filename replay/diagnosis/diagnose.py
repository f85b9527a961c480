"""A recording's diagnosis against any of the three kinds of simulation, and its phone file."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, replace
from typing import Any

from stillcal.replay.diagnosis.built_in import judge_built_in
from stillcal.replay.diagnosis.condense import condensed
from stillcal.replay.diagnosis.given_simulation import judge_simulation
from stillcal.replay.diagnosis.judged import Judged, ShowStage, silent
from stillcal.replay.diagnosis.pair.paired import judge_paired
from stillcal.replay.diagnosis.pair.witnesses import judge_with_witnesses
from stillcal.replay.diagnosis.phone.phone_file import phone_text
from stillcal.replay.diagnosis.phone.phone_simulation import judge_phone
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.phone import Phone


@dataclass(frozen=True, slots=True)
class Request:
    """What a recording is compared with, and what is wanted beside the findings.

    simulated: what a simulator recorded; phone: a simulated phone, named `phone_name`; with neither it is the
    built-in simulation. paired: whether it simulates the recording's own motion, at the same stamps.
    witnesses: other sensors on the same body. phone_file: whether the phone with the effects found is wanted.
    """

    simulated: Recording | None = None
    phone: Phone | None = None
    phone_name: str = ""
    phone_file: bool = False
    paired: bool = False
    witnesses: tuple[Recording, ...] = ()


def conflict(given: Collection[str], mark: str = "") -> str:
    """Say which of the options that are given exclude each other, "" where none do.

    given: of simulated, phone, paired, witness, covariate, phone-out and residuals. mark: what is written
    before a name, such as "--".
    """
    if "simulated" in given and "phone" in given:
        return f"{mark}simulated and {mark}phone exclude each other: each is a simulation, and one is judged"
    if "simulated" in given and "phone-out" in given:
        return (
            f"{mark}simulated and {mark}phone-out exclude each other: {mark}fix-for writes what is found into"
            " the simulation's own configuration"
        )
    if "paired" in given and "simulated" not in given:
        return f"{mark}paired goes with {mark}simulated"
    if "witness" in given and ("simulated" in given or "phone" in given):
        return f"{mark}witness is for the built-in simulation: leave out {mark}simulated and {mark}phone"
    one = next((name for name in ("paired", "witness") if name in given), "")
    beside = next((name for name in ("phone-out", "residuals", "covariate") if name in given), "")
    return f"{mark}{one} does not go with {mark}{beside}" if one and beside else ""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """A diagnosis and, where it was asked for, the phone file with what was found."""

    judged: Judged
    phone_text: str | None = None


def diagnose(recording: Recording, request: Request, show_stage: ShowStage = silent) -> Outcome:
    """Compare a recording with the simulation asked for. Raises NotSupported on too little data."""
    judged = _judged(recording, request, show_stage)
    judged = replace(judged, answer=judged.answer | {"beginning": asdict(recording.beginning)})
    wanted = request.phone_file and judged.case is not None
    return Outcome(judged, _phone_file(judged) if wanted else None)


def _judged(recording: Recording, request: Request, show_stage: ShowStage) -> Judged:
    if request.paired and request.simulated is not None:
        return judge_paired(recording, request.simulated, show_stage)
    if request.witnesses:
        return judge_with_witnesses(recording, request.witnesses, show_stage)
    recording = condensed(recording)
    if request.simulated is not None:
        return judge_simulation(recording, condensed(request.simulated), show_stage)
    if request.phone is not None:
        return judge_phone(recording, request.phone, request.phone_name, show_stage)
    return judge_built_in(recording, show_stage=show_stage)


def _phone_file(judged: Judged) -> str:
    assert judged.case is not None, "asked for where there is one"
    return phone_text(judged.case.phone(), judged.case.mapped, judged.case.recording.name)


def diagnose_recording(recording: Recording, name: str, without: str | None = None) -> dict[str, Any]:
    """Return the diagnosis of a recording against the built-in simulation, as plain values.

    without: an effect of which the catalogue is to know nothing. Raises NotSupported on too little data.
    """
    removed = () if without is None else (without,)
    return judge_built_in(condensed(recording), name, without=removed).answer
