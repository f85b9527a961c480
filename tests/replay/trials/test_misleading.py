"""The trial of calibrations that would mislead: what it says of a change, of none, and of silence."""

from __future__ import annotations

import math

import pytest

from stillcal.replay.trials.misleading.__main__ import CASES, Case, Verdict, judge

SAID = {
    "nothing happens": "",
    "the bias drifts by 0.5 mg/min": "widened",
    "it steps by 3 mg in the middle": "widened",
    "it steps by 20 mg in the middle": "made anew",
    "it steps by 3 mg and back": "widened",
    "it steps by 20 mg and back": "refused",
    "it steps by 20 mg near the end": "refused",
    "it steps by 20 mg after a calibration": "degraded",
    "another phone's recording is appended": "made anew",
    "a noisier phone's recording is appended": "warned",
    "another phone goes on, live": "degraded",
    "six attitudes for six parameters": "refused",
}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_what_happens_is_told_and_nothing_where_nothing_does(case: Case) -> None:
    verdict = judge(case, 1)
    assert verdict.said == SAID[case.name] and not verdict.misleads
    if verdict.said in ("", "made anew"):
        assert verdict.error_mg < 0.2


@pytest.mark.parametrize(
    ("said", "error_mg", "ratio", "misleads"),
    [
        ("", 20.0, 900.0, True),
        ("degraded", 20.0, 900.0, False),
        ("", 0.05, 4.5, False),
        ("", 2.0, 0.7, False),
    ],
)
def test_silence_misleads_where_the_bias_is_not_what_it_is_stated_to_be(
    said: str, error_mg: float, ratio: float, misleads: bool
) -> None:
    assert Verdict(said, math.nan, error_mg, ratio, "").misleads is misleads
