"""The trial of calibrations that would mislead: what it says of a change, of none, and of silence."""

from __future__ import annotations

import math

import pytest

from stillcal.replay.trials.misleading.__main__ import CASES, Verdict, judge

BY_NAME = {case.name: case for case in CASES}


def test_a_step_in_the_middle_is_told_and_the_bias_is_the_new_one() -> None:
    verdict = judge(BY_NAME["it steps by 20 mg in the middle"], 1)
    assert verdict.said == "made anew" and verdict.error_mg < 0.2 and not verdict.misleads


def test_where_nothing_happens_nothing_is_said() -> None:
    verdict = judge(BY_NAME["nothing happens"], 1)
    assert not verdict.said and verdict.error_mg < 0.2 and not verdict.misleads


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
