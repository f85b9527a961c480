"""The diagnosis in ten lines for a terminal: the same as the page says, shorter."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stillcal.replay.diagnosis.wording import counted, headline, judged_against

LINES = 10


def summary(answer: dict[str, Any]) -> list[str]:
    """Return at most `LINES` lines."""
    lines = [
        _verdict(answer),
        *_judged_phone(answer),
        *_findings(answer),
        *_comparisons(answer),
        *_limits(answer),
    ]
    if len(lines) <= LINES:
        return lines
    return [*lines[: LINES - 1], f"  and {len(lines) - LINES + 1} lines more: --json or --report has all"]


def _verdict(answer: dict[str, Any]) -> str:
    checks = answer["checked"]
    words = headline(answer["verdict"], sum(c["done"] for c in checks), len(checks))
    return f"{answer['recording']}: {answer['verdict'].replace('_', ' ')} - {words}"


def _judged_phone(answer: dict[str, Any]) -> Iterator[str]:
    if "judged_phone" in answer:
        yield f"  {judged_against(answer['judged_phone'])}"


def _findings(answer: dict[str, Any]) -> Iterator[str]:
    for finding in answer["findings"]:
        where = " ".join([finding["sensor"], *finding["axes"]])
        yield f"  {finding['effect']} ({where}): {finding['statement']}"
        indistinguishable = [a["effect"] for a in finding["alternatives"] if a["indistinguishable"]]
        if indistinguishable and "cannot tell" not in finding["statement"]:
            yield f"    this recording cannot tell it from {', '.join(indistinguishable)}"
    for known in answer.get("already_simulated", ()):
        yield f"  already in the simulation: {known['effect']} ({known['sensor']})"
    for missing in answer.get("only_simulated", ()):
        yield f"  only in the simulation: {missing['effect']}: {missing['why']}"


def _comparisons(answer: dict[str, Any]) -> Iterator[str]:
    better = "the phone with what was found" if answer["findings"] else "its simulated twin"
    for name, what in (
        ("comparison", "the simulated recording"),
        ("comparison_before", "the phone before"),
        ("comparison_after", better),
    ):
        if name in answer and (answer["findings"] or name != "comparison_before"):
            yield f"  {what}: {comparison_text(answer[name])}"


def comparison_text(comparison: dict[str, Any]) -> str:
    """Return a comparison's outcome in a phrase."""
    tests = comparison["tests"]
    different = [t for t in tests if t["p_corrected"] < comparison["level"]]
    if not different:
        return f"cannot be told from the recording by {counted(len(tests), 'statistic')}"
    first = ", ".join(f"{t['statistic']} ({t['channel']})" for t in different[:2])
    most = "most in " if len(different) > 2 else ""
    return f"differs in {len(different)} of {counted(len(tests), 'statistic')}, {most}{first}"


def _limits(answer: dict[str, Any]) -> Iterator[str]:
    for limit in answer.get("limits", ()):
        yield f"  not seen: {limit}"
