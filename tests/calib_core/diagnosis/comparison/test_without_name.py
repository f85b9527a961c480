"""What has no name in one recording and may be what the other one has as well."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.comparison.without_name import BY_NAME, SAME, is_course, may_be_had
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.effects.followed import driver_of
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.slow.between_rest_variance import DRIVER as REST
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.wander import NO_DRIVER
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.support.diagnosis import nulls

RATE = np.array([1.0, -0.6, 0.4]) * 1e-4


@cache
def drifting(seconds: float, rests: int, seed: int, rate: float = 1.0) -> Examination:
    """Return an accelerometer at 25 Hz, half of the time moved, whose bias drifts by `rate` times RATE."""
    rng, t = np.random.default_rng(seed), np.arange(seconds * 25.0) / 25.0
    up = rng.normal(size=(rests, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    at = t * rests / seconds
    moved = (at % 1.0 > 0.5)[:, None] * rng.normal(0.0, 1.5, (t.size, 3))
    noise = rng.normal(0.0, 7e-3, (t.size, 3))
    force = nulls.G * up[at.astype(int)] + moved + noise + rate * np.outer(t, RATE)
    return examine(Samples.checked(Sensor.ACCELEROMETER, t, frozen(force)), None)


def without_a_name(found: Comparison) -> list[str]:
    return [d.relation for d in found.discrepancies if d.effect == "unknown"]


def reasons(found: Comparison) -> set[str]:
    return {n.reason.partition(": ")[2] for n in found.not_compared if n.effect == "unknown"}


@pytest.mark.parametrize(
    ("other", "why"),
    [
        ((900.0, 30, 100), BY_NAME),  # as a drift
        ((400.0, 14, 0), SAME),  # as a curve from a moment on
        ((100.0, 5, 1), "only 31 s at rest, 74 s are needed"),
    ],
)
def test_a_drift_that_few_rests_show_as_wander_is_no_difference(
    other: tuple[float, int, int], why: str
) -> None:
    """The other recording has the same drift, and was said not to show it."""
    found = compare(drifting(300.0, 14, 0), drifting(*other), ("r", "s"))
    assert without_a_name(found) == []
    assert why in reasons(found)


def test_wander_that_the_other_recording_excludes_is_a_difference() -> None:
    found = compare(drifting(300.0, 14, 0), drifting(900.0, 30, 100, rate=0.0), ("r", "s"))
    assert without_a_name(found) == ["lacking"]


def nameless(driver: str, **sizes: float) -> Finding:
    where = Where(0.0, 300.0, SLOW_BAND, driver)
    parameters = {name: Parameter([size], [[size, size]], "m/s^2") for name, size in sizes.items()}
    return Finding("unknown", "accel", ["x"], where, parameters, Evidence(log_bayes_factor=20.0), [], "")


@pytest.mark.parametrize(
    ("finding", "course"),
    [
        (nameless(NO_DRIVER, size=0.1), True),
        (nameless(REST, size=0.1), True),
        (nameless("time", amplitude=0.1), True),
        (nameless("time", amplitude=0.1, period_s=60.0), False),
        (nameless("temperature", amplitude=0.1), False),
        (nameless(driver_of("uptime"), amplitude=0.1), False),
    ],
)
def test_a_course_goes_once_and_follows_time_or_nothing(finding: Finding, course: bool) -> None:
    """What comes again after a period, or with temperature, is no matter of when it was recorded."""
    assert is_course(finding) is course


@pytest.mark.parametrize(("size", "why"), [(0.011, SAME), (0.009, None)])
def test_what_is_less_than_a_tenth_as_large_is_not_the_same(size: float, why: str | None) -> None:
    own, other = (nameless(REST, size=s) for s in (0.1, size))
    exams = [cast(Any, SimpleNamespace(statements=[Stated(f)])) for f in (own, other)]
    assert may_be_had(own, exams[0], exams[1]) == why
