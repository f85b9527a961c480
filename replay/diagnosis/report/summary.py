"""The diagnosis in ten lines for a terminal: the same as the page says, shorter."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stillcal.replay.diagnosis.relation_text import comparison_summary
from stillcal.replay.diagnosis.wording import counted, headline, judged_against, number, readable

LINES = 10
"""Longest summary; it is to be read at a glance."""


def summary(answer: dict[str, Any]) -> list[str]:
    """Return at most `LINES` lines. answer: the diagnosis as plain values, of schema 1 or 2."""
    if answer["schema"] == 2:
        return comparison_summary(answer, LINES + 2)
    lines = [
        _verdict(answer),
        *_judged_phone(answer),
        *_findings(answer),
        *_comparisons(answer),
        *_limits(answer),
    ]
    if len(lines) <= LINES:
        return lines
    return [*lines[: LINES - 1], f"  {len(lines) - LINES + 1} more lines are in --json and --report"]


def _verdict(answer: dict[str, Any]) -> str:
    done = [check["done"] for check in answer["checked"]]
    words = headline(answer["verdict"], sum(done), len(done), against_phone="judged_phone" in answer)
    return f"{answer['recording']}: {words}"


def _judged_phone(answer: dict[str, Any]) -> Iterator[str]:
    if "judged_phone" in answer:
        yield f"  {judged_against(answer['judged_phone'])}"


def _findings(answer: dict[str, Any]) -> Iterator[str]:
    for finding in answer["findings"]:
        where = " ".join([finding["sensor"], *finding["axes"]])
        yield f"  {finding['effect']} ({where}): {readable(finding['statement'])}"
        indistinguishable = [a["effect"] for a in finding["alternatives"] if a["indistinguishable"]]
        if indistinguishable and "cannot distinguish" not in finding["statement"]:
            yield f"    This recording cannot distinguish it from {', '.join(indistinguishable)}."
    for known in answer.get("already_simulated", ()):
        yield f"  {known['effect']} ({known['sensor']}): in the recording and in the simulated phone"
    for missing in answer.get("only_simulated", ()):
        yield f"  {missing['effect']}: only in the simulated phone: {missing['why']}"


def _comparisons(answer: dict[str, Any]) -> Iterator[str]:
    if "comparison_after" not in answer:
        return
    if not answer["findings"]:
        yield f"  The simulation of this recording {comparison_text(answer['comparison_after'])}."
        return
    yield f"  Without these effects, the simulation {comparison_text(answer['comparison_before'])}."
    yield f"  With these effects added, the simulation {comparison_text(answer['comparison_after'])}."


def comparison_text(comparison: dict[str, Any]) -> str:
    """Return the outcome of a comparison as the end of a sentence, with the worst of the tests that fail."""
    tests = comparison["tests"]
    failed = [t for t in tests if t["p_corrected"] < comparison["level"]]
    if not failed:
        return f"passes all {counted(len(tests), 'test')}"
    worst = failed[0]
    unit = "" if worst["unit"] == "1" else f" {readable(worst['unit'])}"
    simulated, recorded = (f"{number(worst[side])}{unit} {side}" for side in ("simulated", "recorded"))
    return (
        f"fails {len(failed)} of {counted(len(tests), 'test')}; worst: {worst['statistic']}"
        f" ({worst['channel']}), {simulated}, {recorded}"
    )


def _limits(answer: dict[str, Any]) -> Iterator[str]:
    for limit in answer.get("limits", ()):
        yield f"  Note: {limit}"
