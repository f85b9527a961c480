"""What `stillcal diagnose` works out, stage by stage, before anything is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import click

from stillcal.replay.diagnosis.diagnose import (
    answer_of,
    bins_of,
    claims_of,
    diagnose_rests,
    diagnosis_of,
    facts,
)
from stillcal.replay.diagnosis.judge_phone import PhoneJudgement, judge_phone
from stillcal.replay.diagnosis.report.comparison import compare, side_of
from stillcal.replay.diagnosis.report.inputs import Case, case_of, resimulate_before_and_after
from stillcal.replay.diagnosis.report.page import page
from stillcal.replay.diagnosis.report.phone_file import phone_text
from stillcal.replay.formats.trace import read_all, read_rest_table
from stillcal.replay.phone.phone import load_phone


class Request(NamedTuple):
    """What was asked for beside the findings; None for not."""

    phone: str | None
    simulated: Path | None
    report: Path | None
    phone_out: Path | None


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer as plain values, and the files' text where they were asked for."""

    answer: dict[str, Any]
    page: str | None = None
    phone: str | None = None


def diagnose_table(table: Path) -> Answer:
    """Diagnose a table of rests. Raises TraceError, NotSupported."""
    return Answer(diagnose_rests(read_rest_table(table), table.name))


def diagnose_trace(
    trace: Path, format_: str, gyro: Path | None, request: Request, show_stage: Callable[[str], None]
) -> Answer:
    """Diagnose a recording and make what is wanted of it. Raises TraceError, NotSupported, UsageError."""
    show_stage(f"reading {trace.name}")
    recording = read_all(trace, format_, gyro)
    show_stage("judging: stamps, noise, bias, motion")
    if request.phone is None:
        judgement = PhoneJudgement(diagnosis_of(recording, trace.name))
    else:
        judgement = judge_phone(recording, trace.name, _loaded(request.phone))
    show_stage("mapping where it departs")
    case = case_of(recording, judgement.diagnosis, judgement.known())
    answer = answer_of(judgement.diagnosis, facts(recording, case.bins))
    answer |= {"map": case.departure_map.plain(), **judgement.plain()}
    if request.phone is not None:
        answer["judged_phone"] = request.phone
    if request.simulated is not None:
        show_stage(f"comparing with {request.simulated.name}")
        answer["comparison"] = _compared(case, request.simulated)
    resimulated = None
    if request.report is not None and len(case.bins):
        resimulated = resimulate_before_and_after(case, show_stage)
        answer |= {
            "comparison_before": resimulated[0].comparison.plain(),
            "comparison_after": resimulated[1].comparison.plain(),
        }
    show_stage("drawing" if request.report is not None else "writing")
    phone = None if request.phone_out is None else phone_text(case.phone(), case.mapped, trace.name)
    return Answer(answer, None if request.report is None else page(case, answer, resimulated), phone)


def _loaded(name: str) -> Any:
    try:
        return load_phone(name)
    except ValueError as error:
        raise click.UsageError(str(error)) from error


def _compared(case: Case, simulated: Path) -> dict[str, Any]:
    other = read_all(simulated)
    gravity = claims_of(other).gravity
    return compare(case.side(), side_of(other, bins_of(other), gravity)).plain()
