"""What is said of an effect beside its finding: its forward equation, and what to record next."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Words:
    """An effect's fixed texts. equation: trusted HTML, parameters in bold. remedy: what to record next."""

    effect: str
    equation: str
    remedy: str
