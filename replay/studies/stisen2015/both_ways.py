"""Claims that are tested both ways: as the paper tests them, and on motion that nobody was trained on.

The paper's way decides. That a claim holds that way alone is a finding of ours, and stands in the same cell.
"""

from __future__ import annotations

from collections.abc import Sequence

OTHER = "other windows"


def both_ways(figures: Sequence[str], good: Sequence[bool], unit: str = "") -> str:
    """Say a figure as the paper tests, and on other windows. good: whether the claim holds, each way."""
    same, other = figures
    if list(good) == [True, False]:
        return f"{same}{unit}; not on {OTHER} ({other}{unit})"
    return f"{same}; {OTHER} {other}{unit}"
