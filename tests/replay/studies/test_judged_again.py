"""Every verdict of the page whose scores are kept is judged again: a rule that is turned is red at once.

The scores are those of the page's own run: `python -m tests.support.judged NAME ...` keeps them.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from stillcal.replay.studies import page
from stillcal.replay.studies.registry import STUDIES
from tests.support.judged import judged, kept, kept_at

DOCS = Path(__file__).parents[3] / "docs"
NOT_KEPT = {
    "people",
    "quality-check",
    "stationary-states",
}
"""Studies that run long, or judge what cannot be kept; their rules have tests with made-up scores."""

FED = [name for name in STUDIES if kept_at(name).is_file()]


@pytest.mark.parametrize("name", FED)
def test_kept_scores_are_judged_as_the_page_says(name: str) -> None:
    (study,) = page.kept(DOCS / page.FOLDER, [name])
    said = {(c.where, c.claim): (c.verdict, c.explained) for c in study.claims}
    again = [claim for call in kept(name) for claim in judged(call)]
    assert again
    for claim in again:
        own = claim.verdict, claim.explained
        assert own == said[claim.where, claim.claim], f"{claim.claim}: run `stillcal evaluate {name}` anew"


def test_the_scores_of_all_other_studies_are_kept() -> None:
    assert set(STUDIES) - set(FED) == NOT_KEPT
