"""The verdict as sentences, and the outcome of a comparison as a phrase."""

from __future__ import annotations

from typing import Any

import pytest

from stillcal.replay.diagnosis.report.summary import comparison_text, summary
from stillcal.replay.diagnosis.wording import certainty, headline


@pytest.mark.parametrize(
    ("verdict", "checked", "words"),
    [
        ("adequate", 10, "No difference found: this recording looks like a sensor with constant bias"),
        ("adequate", 4, "No difference found:"),
        (
            "adequate",
            3,
            "Not judged: 7 of 10 checks need more data (see below). No difference found in the other 3",
        ),
        ("explained", 10, "Differences found, all identified."),
        ("explained", 4, "Differences found, all identified. 6 of 10 checks were not possible."),
        ("explained", 9, "Differences found, all identified. 1 of 10 checks was not possible."),
        ("partly_explained", 10, "Differences found, some identified, some of unknown cause."),
        ("unexplained", 2, "Differences found, of unknown cause. 8 of 10 checks were not possible."),
    ],
)
def test_the_verdict_says_how_much_was_checked(verdict: str, checked: int, words: str) -> None:
    assert headline(verdict, checked, 10).startswith(words)


def test_a_phone_is_named_where_it_is_what_the_recording_is_compared_with() -> None:
    assert headline("adequate", 10, 10, against_phone=True).startswith(
        "No difference found between this recording and the simulated phone."
    )
    assert "simulated phone" not in headline("adequate", 10, 10)


@pytest.mark.parametrize(
    ("p", "words"), [(1e-10, "very high"), (1e-8, "high"), (1e-4, "good"), (0.5, "moderate")]
)
def test_confidence_falls_as_p_rises(p: float, words: str) -> None:
    assert certainty(p) == words


def outcome(*p: float) -> dict[str, Any]:
    tests = [
        {"statistic": "spread of samples at rest", "channel": "accel x", "unit": "m/s^2", "recorded": 0.02,
         "simulated": 0.01, "p_value": x, "p_corrected": x}
        for x in p
    ]  # fmt: skip
    return {"accepted": min(p) >= 0.01, "level": 0.01, "tests": tests}


def test_a_comparison_counts_the_tests_that_fail_and_names_the_worst() -> None:
    assert comparison_text(outcome(0.01, 0.5)) == "passes all 2 tests"
    assert comparison_text(outcome(0.009, 0.5)) == (
        "fails 1 of 2 tests; worst: spread of samples at rest (accel x), 0.01 m/s² simulated,"
        " 0.02 m/s² recorded"
    )


def test_the_summary_has_one_line_a_finding_and_the_notes() -> None:
    finding = {
        "effect": "gyro_saturation", "sensor": "gyro", "axes": ["x"], "alternatives": [],
        "statement": "The gyroscope saturates at 5 rad/s^2.",
    }  # fmt: skip
    answer = {
        "schema": 1, "recording": "walk.csv", "verdict": "explained", "findings": [finding],
        "checked": [{"done": True}],
        "comparison_before": outcome(0.001, 0.5), "comparison_after": outcome(0.5, 0.5),
        "limits": ["No gyroscope data"],
    }  # fmt: skip
    assert summary(answer) == [
        "walk.csv: Differences found, all identified.",
        "  gyro_saturation (gyro x): The gyroscope saturates at 5 rad/s².",
        "  Without these effects, the simulation fails 1 of 2 tests; worst: spread of samples at rest"
        " (accel x), 0.01 m/s² simulated, 0.02 m/s² recorded.",
        "  With these effects added, the simulation passes all 2 tests.",
        "  Note: No gyroscope data",
    ]
