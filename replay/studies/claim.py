"""What a study says: claims of a paper beside our figures, with a verdict that is computed, and a text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

Progress = Callable[[float], None]
"""Told what share of a study is done, 0 to 1."""

StudyFunction = Callable[[Path | None, Path, int, Progress], "Study"]
"""(folder of real recordings or None, folder for figures, seed, progress) -> Study."""


class Verdict(StrEnum):
    """Whether a figure came out as published."""

    REPRODUCED = "reproduced"
    DIFFERS = "differs"
    UNTESTED = "cannot be tested here"


@dataclass(frozen=True, slots=True)
class Claim:
    """One claim beside ours. source: the paper, as page.py lists them. where: "Table 2", "3.5.3". data: what
    it was computed from. because: the tolerance and its reason, or why it differs, or what is missing.
    """  # noqa: D205 - the fields are the summary

    source: str
    where: str
    claim: str
    paper: str
    ours: str
    data: str
    verdict: Verdict
    because: str = ""


@dataclass(frozen=True, slots=True)
class Study:
    """Claims and a text about them. name: as on the command line. text: Markdown, headings from ###, with
    figures by `picture`. figures: their file names. seed: what it was drawn with.
    """  # noqa: D205 - the fields are the summary

    name: str
    title: str
    claims: tuple[Claim, ...]
    text: str
    figures: tuple[str, ...] = ()
    seed: int = 0


def agreement(paper: float, ours: float, tolerance: float) -> Verdict:
    """Judge a figure: reproduced if within `tolerance` (absolute, inclusive) of the paper's."""
    return Verdict.REPRODUCED if abs(ours - paper) <= tolerance else Verdict.DIFFERS


def holds(condition: bool) -> Verdict:
    """Judge a claim that is a statement: reproduced if it holds here."""
    return Verdict.REPRODUCED if condition else Verdict.DIFFERS


def picture(file: str, caption: str) -> str:
    """Return Markdown for a figure of this name in the figures' folder, as seen from the page."""
    return f"![{caption}](evaluation/{file})"


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Return a Markdown table; a bar within a cell is escaped."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
