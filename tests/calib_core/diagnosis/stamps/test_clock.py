"""The rate of a clock against the host's, and stamps that are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.model.records import Claims, Finding
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.stamps.clock import DRIVER, timing_findings
from stillcal.calib_core.streams.samples import Samples, Sensor


def found(stamps: Array, arrival: Array) -> list[Finding]:
    late = arrival + np.random.default_rng(1).exponential(1e-3, arrival.size)
    samples = Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(np.ones((stamps.size, 3))))
    shown = timing_findings(replace(samples, t_arrival=frozen(late)), Claims(), sound_phones())
    return [f for f in shown if "relative" in f.parameters]


@pytest.mark.parametrize("relative", [-0.05, 0.1])
def test_a_clock_may_be_off_by_a_tenth(relative: float) -> None:
    t = np.arange(0.0, 300.0, 0.01)
    (skew,) = found(t * (1.0 + relative), t)
    assert skew.effect == "clock_skew"
    assert skew.parameters["relative"].value == pytest.approx(relative, rel=1e-3)


def test_stamps_that_leave_out_pauses_are_no_clock_that_is_slow() -> None:
    """A watch that recorded for 136 s of 539 s, its stamps 10 ms apart throughout, was 749,000 ppm slow."""
    t = np.arange(0.0, 300.0, 0.01)
    (pauses,) = found(t, t + 30.0 * np.floor(t / 12.0))
    assert (pauses.effect, pauses.where.driver) == ("unknown", DRIVER)
    assert "leave out pauses" in pauses.statement


@pytest.mark.parametrize("relative", [-0.25, 0.25])
def test_a_clock_that_is_off_by_a_quarter_is_none_either_way(relative: float) -> None:
    t = np.arange(0.0, 300.0, 0.01)
    (other,) = found(t * (1.0 + relative), t)
    assert (other.effect, other.where.driver) == ("unknown", DRIVER)
    assert f"pass {1.0 + relative:.3g} s in each second" in other.statement
