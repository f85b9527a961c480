"""The delay between the sensors is compared as a number, also where sound phones have as much."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY
from stillcal.replay.diagnosis.judged import examined
from tests.support.diagnosis.turned_pairs import turned

NAMES = ("real.csv", "sim.csv")


@pytest.fixture(scope="module")
def exam() -> Examination:
    return examined(turned(1, turns=4), sought=())


def with_delay(exam: Examination, value: float, error: float = 5e-4) -> Examination:
    return replace(exam, delay=Measured(value, error))


def test_a_delay_that_no_finding_has_differs(exam: Examination) -> None:
    """8 ms are what phones have, and a simulation without them is wrong all the same."""
    (found,) = (
        d for d in compare(with_delay(exam, 8e-3), with_delay(exam, 0.0), NAMES).discrepancies
        if d.effect == DELAY
    )  # fmt: skip
    assert found.relation == "lacking" and found.difference is not None
    assert found.difference.value == pytest.approx([8e-3])
    other = compare(with_delay(exam, 8e-3), with_delay(exam, 7e-3), NAMES)
    assert DELAY not in {d.effect for d in other.discrepancies}


def test_one_that_is_not_known_is_not_compared_with_the_reason(exam: Examination) -> None:
    rough = compare(with_delay(exam, 8e-3, 6e-3), with_delay(exam, 0.0), NAMES)
    (why,) = (n.reason for n in rough.not_compared if n.effect == DELAY)
    assert why == "real.csv: its turns do not tell it from how the hand moves it"
    arrived = replace(exam, accelerometer=replace(exam.accelerometer, t_arrival=exam.accelerometer.t))
    reasons = {n.effect: n.reason for n in compare(arrived, exam, NAMES).not_compared}
    assert reasons["arrival_bursts"] == "sim.csv: no arrival times"
    none = compare(with_delay(exam, 8e-3), replace(exam, delay=None), NAMES)
    (why,) = (n.reason for n in none.not_compared if n.effect == DELAY)
    assert why.startswith("sim.csv: the phone turns in ")
