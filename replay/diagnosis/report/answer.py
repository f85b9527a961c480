"""The whole answer to one recording, stage by stage: what `stillcal diagnose` writes and Python returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from stillcal.replay.diagnosis.diagnose import (
    answer_of,
    diagnose_rests,
    diagnosis_of,
    facts,
)
from stillcal.replay.diagnosis.judge_phone import PhoneJudgement, judge_phone
from stillcal.replay.diagnosis.report.inputs import case_of, resimulate_before_and_after
from stillcal.replay.diagnosis.report.page import page
from stillcal.replay.diagnosis.report.phone_file import phone_text
from stillcal.replay.formats.trace import Recording, read_rest_table
from stillcal.replay.phone.phone import Phone


class Request(NamedTuple):
    """What the user asked for beside the findings.

    phone: the simulated phone to compare with, named `phone_name`. report: whether the page is made;
    phone_file: whether the phone with the effects found is.
    """

    phone: Phone | None = None
    phone_name: str = ""
    report: bool = False
    phone_file: bool = False


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer as plain values, with the text of the page and of the phone file if they were asked for."""

    answer: dict[str, Any]
    page: str | None = None
    phone: str | None = None


def answer_for_table(table: Path) -> Answer:
    """Diagnose a table of rests. Raises TraceError, NotSupported."""
    return Answer(diagnose_rests(read_rest_table(table), table.name))


def answer_for_recording(
    recording: Recording, request: Request, show_stage: Callable[[str], None] = lambda stage: None
) -> Answer:
    """Diagnose a recording and make what was asked for. Raises NotSupported on too little data.

    show_stage: is called with the name of each stage as it begins.
    """
    name = recording.name
    show_stage("checking time stamps, noise, bias and motion")
    if request.phone is None:
        judgement = PhoneJudgement(diagnosis_of(recording, name))
    else:
        judgement = judge_phone(recording, name, request.phone)
    show_stage("locating the differences")
    case = case_of(recording, judgement.diagnosis, judgement.known())
    answer = answer_of(judgement.diagnosis, facts(recording, case.bins))
    answer |= {
        "map": case.departure_map.plain(),
        **judgement.plain(),
        "simulation": request.phone_name or "built-in",
    }
    if request.phone is not None:
        answer["judged_phone"] = request.phone_name
    resimulated = None
    if request.report and len(case.bins):
        resimulated = resimulate_before_and_after(case, show_stage)
        answer |= {
            "comparison_before": resimulated[0].comparison.plain(),
            "comparison_after": resimulated[1].comparison.plain(),
        }
    show_stage("drawing" if request.report else "writing")
    phone = phone_text(case.phone(), case.mapped, name) if request.phone_file else None
    return Answer(answer, page(case, answer, resimulated) if request.report else None, phone)
