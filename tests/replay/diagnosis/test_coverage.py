"""Each check that was not made names the condition that failed, on both sides of every condition."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stillcal.calib_core.diagnosis.effects.temperature import LEAST_SPAN
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.replay.diagnosis.coverage import (
    FORCE_ATTITUDES,
    LEAST_PIECES,
    NONLINEARITY_ATTITUDES,
    Check,
    Facts,
    checks,
    limits,
)

ALL = Facts(
    samples=10_000,
    bins=thresholds.LEAST_BINS,
    rests=20,
    attitudes=12,
    still_s=10.0 * thresholds.LEAST_BINS,
    kelvin=5.0,
    switches=2,
    thermometer=True,
    gyroscope=True,
    rates=True,
    arrivals=True,
    stamps=True,
)
"""A recording that allows every check, with just enough rest."""


def check(facts: Facts, what: str) -> Check:
    (found,) = (c for c in checks(facts) if c.what.startswith(what))
    return found


def test_a_recording_that_has_everything_allows_every_check() -> None:
    assert all(c.done for c in checks(ALL)) and len(checks(ALL)) == 10


@pytest.mark.parametrize(
    ("what", "missing", "reason"),
    [
        ("arrival in bursts", {"arrivals": False}, "no arrival times were recorded"),
        (
            "noise",
            {"bins": LEAST_PIECES - 1, "still_s": 20.0},
            "2 static intervals (20 s at rest), 3 are needed",
        ),
        ("slow changes", {"bins": 10, "still_s": 100.0}, "only 100 s at rest, 120 s are needed"),
        ("slow changes", {"bins": 0, "still_s": 0.0}, "the phone never lies still"),
        ("temperature", {"thermometer": False, "kelvin": None}, "no temperature was recorded"),
        ("temperature", {"bins": 10, "still_s": 100.0}, "only 100 s at rest, 120 s are needed"),
        ("temperature", {"bins": 0, "kelvin": None, "still_s": 0.0}, "the phone never lies still"),
        ("temperature", {"kelvin": 0.9 * LEAST_SPAN}, "it varied by 0.27 K, 0.3 K are needed"),
        ("charging", {"switches": 0}, "no charging events were recorded"),
        ("charging", {"bins": 10, "still_s": 100.0}, "only 100 s at rest, 120 s are needed"),
        (
            "accelerometer nonlinearity",
            {"bins": 10, "still_s": 100.0},
            "only 100 s at rest, 120 s are needed",
        ),
        (
            "accelerometer nonlinearity",
            {"attitudes": NONLINEARITY_ATTITUDES - 1},
            "only 5 attitudes, 6 are needed",
        ),
        ("gyroscope's sensitivity", {"attitudes": FORCE_ATTITUDES - 1}, "only 3 attitudes, 4 are needed"),
        ("gyroscope's scale", {"rests": 9}, "at most 8 rotations from rest to rest, 9 are needed"),
        ("gyroscope, and", {"gyroscope": False, "rates": False}, "no gyroscope was recorded"),
        ("gyroscope, and", {"rates": False}, "vibration hides the rate at rest"),
    ],
)
def test_the_reason_is_the_condition_that_failed(what: str, missing: dict[str, object], reason: str) -> None:
    found = check(replace(ALL, **missing), what)  # type: ignore[arg-type]
    assert not found.done
    assert found.how == reason


@pytest.mark.parametrize(
    ("what", "least"),
    [
        ("temperature", {"kelvin": LEAST_SPAN}),
        ("charging", {"switches": 1}),
        ("accelerometer nonlinearity", {"attitudes": NONLINEARITY_ATTITUDES}),
        ("gyroscope's sensitivity", {"attitudes": FORCE_ATTITUDES}),
        ("gyroscope's scale", {"rests": 10}),
        ("noise", {"bins": LEAST_PIECES}),
    ],
)
def test_the_least_that_is_enough_is_enough(what: str, least: dict[str, object]) -> None:
    assert check(replace(ALL, **least), what).done  # type: ignore[arg-type]


def test_a_table_of_rests_says_what_it_has_not() -> None:
    table = replace(ALL, samples=0, stamps=False)
    assert check(table, "time stamps").how == "a table of rests has no samples"
    assert check(table, "drift").how == "the table's rows have no time"
    assert check(replace(table, bins=10), "bias and scale").how == "only 10 rests, 12 are needed"
    assert len(limits(table)) == 2 and len(limits(replace(table, stamps=True))) == 1
    assert limits(ALL) == []
