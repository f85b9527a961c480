"""Stamps as people read them."""

from __future__ import annotations

import pytest

from stillcal.replay.diagnosis.words.moments import moment, span, with_moments


@pytest.mark.parametrize(
    ("t", "said"),
    [
        (-0.2, "0 s"),
        (800.4, "800 s"),
        (9.4e8, "940000000 s"),
        (1.76e12, "1760000000000 s"),
        (1.76e9 + 24.6, "2025-10-09 08:53:45 UTC"),
    ],
)
def test_a_moment(t: float, said: str) -> None:
    assert moment(t) == said


@pytest.mark.parametrize(
    ("start", "end", "said"),
    [
        (-0.1, 831.4, "from 0 to 831 s"),
        (4.0e9, 4.2e9, "from 4000000000 to 4200000000 s"),
        (1.76e9, 1.76e9 + 31 * 86400.0, "from 2025-10-09 08:53:20 to 2025-11-09 08:53:20 UTC"),
        (1.76e9, 1.76e9 + 600.0, "from 2025-10-09 08:53:20 to 09:03:20 UTC"),
        (1.76e9, 1.76e9 + 86400.0, "from 2025-10-09 08:53:20 to 2025-10-10 08:53:20 UTC"),
    ],
)
def test_a_span(start: float, end: float, said: str) -> None:
    assert span(start, end) == said


def test_spans_within_a_sentence_are_said_alike() -> None:
    """What was observed of something without a name kept its stamps beside the dates."""
    said = "From 1760000000 to 1760000600 s the x axis is stuck, nearly all from 5 to 8 s."
    dated = "From 2025-10-09 08:53:20 to 09:03:20 UTC the x axis is stuck, nearly all from 5 to 8 s."
    assert with_moments(said) == dated
