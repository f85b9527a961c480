"""The page of effects says what the classes say."""

from __future__ import annotations

from pathlib import Path

from stillcal.replay.trials.pages.effects import page

PAGE = Path(__file__).parents[3] / "docs" / "effects.md"


def test_the_page_is_made_from_the_classes() -> None:
    assert PAGE.read_text() == page()
