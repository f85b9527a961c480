"""Deliveries on stamps that are known; what late stamps do to a vibration; the real phones of the figure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.studies.claim import Verdict
from stillcal.replay.studies.har.recordings import Still, read_still
from stillcal.replay.studies.stisen2015 import washing_machine as study
from stillcal.replay.studies.stisen2015.washing_machine import (
    Delivery,
    Stretch,
    delivery,
    kept,
    lateness,
    line,
)


def a_rest(creation: np.ndarray, arrival: np.ndarray) -> Still:
    return Still("back", "d", "m", np.tile([0.0, 0.0, 9.8], (len(creation), 1)), arrival, creation)


def test_even_samples_have_no_bulks_and_no_outages() -> None:
    t = np.arange(1001) / 100.0
    found = delivery([a_rest(t, t + 0.003)])
    assert (found.bulks, found.outages) == (0.0, 0.0)
    assert found.even == 1.0
    assert found.interval == pytest.approx(10.0)
    assert found.late == pytest.approx(0.0, abs=1e-9)  # a constant delay is the clocks' own


def test_bulks_and_outages_are_counted_once_each_in_two_seconds() -> None:
    """Taken every 10 ms, delivered five at a time: 20 outages of 50 ms and 20 bulks in a second."""
    t = np.arange(1001) / 100.0
    arrival = 0.05 * np.ceil(t / 0.05 - 1e-9)
    found = delivery([a_rest(t, arrival)])
    assert found.bulks == pytest.approx(40.0, rel=0.02)
    assert found.outages == pytest.approx(40.0, rel=0.02)
    assert found.even == 1.0
    # late by 0, 10, 20, 30 and 40 ms in turn
    assert found.late == pytest.approx(1e3 * 0.01 * np.sqrt(2.0), rel=0.02)


def test_an_outage_is_longer_than_three_intervals_and_even_is_within_a_fifth() -> None:
    for gap, outages in ((2.9, 0), (3.1, 1)):
        intervals = np.full(200, 0.01)
        intervals[100] = gap * 0.01
        t = np.r_[0.0, np.cumsum(intervals)]
        assert delivery([a_rest(t, t)]).outages == pytest.approx(2.0 * outages / t[-1])
    for stretch, share in ((1.19, 1.0), (1.21, 0.75)):
        t = np.r_[0.0, np.cumsum(np.tile([0.01, 0.01, 0.01, 0.01 * stretch], 100))]
        assert delivery([a_rest(t, t)]).even == pytest.approx(share)


def test_clocks_that_run_differently_are_not_late() -> None:
    t = np.arange(500) / 50.0
    assert np.abs(lateness(a_rest(t, 1.001 * t + 0.2))).max() < 1e-9


def test_a_vibration_put_off_by_half_its_period_now_and_then_loses_its_line() -> None:
    t = np.arange(400) / 200.0
    forces = np.sin(2 * np.pi * 10.0 * t)[:, None] * np.array([1.0, 0.0, 0.0])
    assert line(t, forces, 10.0) == pytest.approx(1.0, rel=1e-6)
    assert line(t, forces, 17.0) < 0.05
    assert kept(Stretch(t, t.copy(), forces, 10.0)) == pytest.approx(1.0)
    half = t + 0.05 * (np.arange(400) % 2)
    assert kept(Stretch(t, half, forces, 10.0)) < 0.1


def test_without_recordings_nothing_is_judged(tmp_path: Path) -> None:
    found = study.study(None, tmp_path, 0, lambda share: None)
    assert {c.verdict for c in found.claims} == {Verdict.UNTESTED}


def test_the_real_nexus_delivers_in_bulks_what_it_takes_evenly(data_dir: Path) -> None:
    rests = [r for r in read_still(data_dir) if r.model == "LG-Nexus4"][:6]
    found = delivery(rests)
    assert found.bulks > 10.0
    assert found.outages > 1.0
    assert found.even > 0.9
    assert abs(found.together) < 0.2


GOOD = Delivery(bulks=1.0, outages=1.0, even=0.9, together=0.1, late=10.0, interval=10.0)
DULL = Delivery(bulks=0.0, outages=0.0, even=1.0, together=0.5, late=0.1, interval=10.0)


@pytest.mark.parametrize(
    "one, verdicts",
    [
        (GOOD, (True, True, True)),
        (Delivery(0.99, 1.0, 0.9, 0.1, 10.0, 10.0), (False, False, True)),
        (Delivery(1.0, 0.99, 0.9, 0.1, 10.0, 10.0), (False, False, True)),
        (Delivery(1.0, 1.0, 0.89, 0.1, 10.0, 10.0), (True, False, True)),
    ],
)
def test_any_two_models_must_do_as_the_phones_of_the_figure(
    one: Delivery, verdicts: tuple[bool, ...]
) -> None:
    found = {"a": GOOD, "b": one, "c": DULL}
    claims = study._claims(found)
    assert [c.verdict is Verdict.REPRODUCED for c in claims] == list(verdicts)


@pytest.mark.parametrize("late, harmful", [(10.0, True), (9.9, False)])
def test_late_by_an_interval_on_one_that_comes_in_bulks_is_enough_to_do_harm(
    late: float, harmful: bool
) -> None:
    one = Delivery(1.0, 1.0, 0.9, 0.1, late, 10.0)
    claims = study._claims({"a": one, "b": replace(DULL, late=20.0)})
    assert (claims[2].verdict is Verdict.REPRODUCED) is harmful
