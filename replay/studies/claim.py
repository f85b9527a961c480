"""What a study says: claims of a paper beside our figures, with a verdict that is computed, and a text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

Progress = Callable[[float], None]
"""Told what share of a study is done, 0 to 1."""

StudyFunction = Callable[[Path | None, Path, int, Progress], "Study"]
"""(folder of real recordings or None, folder for figures, seed, progress) -> Study."""


class Verdict(StrEnum):
    """Whether a figure came out as published.

    OPEN is for questions that a paper leaves open: our figure stands beside no claim, so it reproduces none.
    """

    REPRODUCED = "reproduced"
    DIFFERS = "differs"
    OPEN = "left open by the paper"
    UNTESTED = "cannot be tested here"


class Evidence(StrEnum):
    """What kind of evidence a verdict rests on, strongest first.

    REAL: recordings of real devices. SEMI_SYNTHETIC: real activity carried through the measured errors of
    real devices. SIMULATION: simulated phones or random draws. THEORY: a derivation, checked numerically.
    ARITHMETIC: counted, timed or computed from given numbers. PRINTED: the numbers that the paper itself
    prints. NONE: nothing; the claim could not be tested.
    """

    REAL = "real recordings"
    SEMI_SYNTHETIC = "semi-synthetic"
    SIMULATION = "simulation"
    THEORY = "theory"
    ARITHMETIC = "arithmetic"
    PRINTED = "the paper's own numbers"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class Cause:
    """What was run to find why a figure differs, with its figures.

    shown: whether the run shows that this is why. It is computed from those figures, as a verdict is.
    """

    tried: str
    shown: bool

    def __post_init__(self) -> None:
        """Keep `shown` as a plain bool: numpy's cannot be written."""
        object.__setattr__(self, "shown", bool(self.shown))

    def __str__(self) -> str:
        """Say whether it is the cause, and what was tried."""
        return f"tested: {self.tried}" if self.shown else f"not known; tried: {self.tried}"


@dataclass(frozen=True, slots=True)
class Claim:
    """One claim of a paper beside our figure.

    source: the paper, as page.py lists them. where: its place in the paper, such as "Table 2" or "3.5.3".
    data: what our figure was computed from. because: the tolerance and its reason, or what is missing.
    evidence: the kind of evidence. cause: why our figure differs, told only where the verdict is DIFFERS.
    brief: our figure in the page's summary, where `ours` is too long for it.
    """

    source: str
    where: str
    claim: str
    paper: str
    ours: str
    data: str
    verdict: Verdict
    because: str = ""
    evidence: Evidence = field(kw_only=True)
    cause: Cause | None = field(default=None, kw_only=True)
    brief: str = field(default="", kw_only=True)

    @property
    def why_it_differs(self) -> str:
        """Return the cause of a difference, "not known" where none was given; empty where nothing differs."""
        return str(self.cause or "not known; nothing was tried") if self.verdict is Verdict.DIFFERS else ""

    @property
    def explained(self) -> bool:
        """Return whether this differs and a run showed why."""
        return self.verdict is Verdict.DIFFERS and self.cause is not None and self.cause.shown


@dataclass(frozen=True, slots=True)
class Study:
    """A study's claims and a text about them.

    name: as on the command line. text: Markdown, headings from ###, with figures by `picture`. figures: their
    file names. seed: the seed of everything that was drawn.
    """

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
