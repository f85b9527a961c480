"""What `stillcal diagnose` works out, stage by stage, before anything is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import click

from stillcal.replay.diagnosis.diagnose import (
    answered,
    bins_of,
    claims_of,
    diagnosed_rests,
    diagnosis_of,
    facts,
)
from stillcal.replay.diagnosis.judge_phone import Judged, judged
from stillcal.replay.diagnosis.report.comparison import compare, side_of
from stillcal.replay.diagnosis.report.inputs import Case, case_of, trials
from stillcal.replay.diagnosis.report.page import page
from stillcal.replay.diagnosis.report.phone_file import phone_text
from stillcal.replay.formats.trace import read_all, read_rest_table
from stillcal.replay.phone.phone import load_phone


class Wanted(NamedTuple):
    """What was asked for beside the findings; None for not."""

    phone: str | None
    simulated: Path | None
    report: Path | None
    phone_out: Path | None


@dataclass(frozen=True, slots=True)
class Answered:
    """The answer as plain values, and the files' text where they were asked for."""

    answer: dict[str, Any]
    page: str | None = None
    phone: str | None = None


def judged_rests(table: Path) -> Answered:
    """Diagnose a table of rests. Raises TraceError, NotSupported."""
    return Answered(diagnosed_rests(read_rest_table(table), table.name))


def judged_recording(
    trace: Path, format_: str, gyro: Path | None, wanted: Wanted, tell: Callable[[str], None]
) -> Answered:
    """Diagnose a recording and make what is wanted of it. Raises TraceError, NotSupported, UsageError."""
    tell(f"reading {trace.name}")
    recording = read_all(trace, format_, gyro)
    tell("judging: stamps, noise, bias, motion")
    if wanted.phone is None:
        found = Judged(diagnosis_of(recording, trace.name))
    else:
        found = judged(recording, trace.name, _loaded(wanted.phone))
    tell("mapping where it departs")
    case = case_of(recording, found.diagnosis, found.known())
    answer = answered(found.diagnosis, facts(recording, case.bins))
    answer |= {"map": case.map.plain(), **found.plain()}
    if wanted.phone is not None:
        answer["judged_phone"] = wanted.phone
    if wanted.simulated is not None:
        tell(f"comparing with {wanted.simulated.name}")
        answer["comparison"] = _compared(case, wanted.simulated)
    both = None
    if wanted.report is not None and len(case.bins):
        both = trials(case, tell)
        answer |= {
            "comparison_before": both[0].comparison.plain(),
            "comparison_after": both[1].comparison.plain(),
        }
    tell("drawing" if wanted.report is not None else "writing")
    phone = None if wanted.phone_out is None else phone_text(case.phone(), case.found, trace.name)
    return Answered(answer, None if wanted.report is None else page(case, answer, both), phone)


def _loaded(name: str) -> Any:
    try:
        return load_phone(name)
    except ValueError as error:
        raise click.UsageError(str(error)) from error


def _compared(case: Case, simulated: Path) -> dict[str, Any]:
    other = read_all(simulated)
    gravity = claims_of(other).gravity
    return compare(case.side(), side_of(other, bins_of(other), gravity)).plain()
