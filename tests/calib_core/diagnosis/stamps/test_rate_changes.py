"""A sample rate that is set anew is told as that, and none of its samples as lost."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.direct.smallest import of_stamps_and_values
from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.stamps.clock import timing_findings
from stillcal.calib_core.diagnosis.stamps.rate_changes import stretches
from stillcal.calib_core.diagnosis.stamps.timestamps import Grid
from stillcal.calib_core.streams.samples import Samples, Sensor

Array = np.ndarray


def at_rates(*parts: tuple[float, float], jitter: float = 2e-4) -> Array:
    """Return stamps of parts (rate in Hz, length in s), one after another."""
    steps = np.concatenate([np.full(round(rate * length), 1.0 / rate) for rate, length in parts])
    return np.asarray(np.cumsum(steps) + np.random.default_rng(1).normal(0.0, jitter, steps.size))


def stream(t: Array) -> Samples:
    return Samples.checked(Sensor.ACCELEROMETER, t, np.random.default_rng(2).normal(0.0, 0.01, (t.size, 3)))


def missing(t: Array) -> float:
    return Grid.of(t, sample_period(t)).missing().value


@pytest.mark.parametrize("slow", [50.0, 66.7])
def test_a_change_of_the_rate_is_found_and_nothing_is_lost(slow: float) -> None:
    t = at_rates((100.0, 90.0), (slow, 90.0))
    (found,) = timing_findings(stream(t), Claims(nominal_rate_hz=100.0), sound_phones())
    assert (found.effect, found.sensor) == ("unknown", "timing")
    assert f"changes at 90 s, from 100 to {slow:.4g} Hz" in found.statement
    assert found.where.t_start == pytest.approx(90.0, abs=0.1)
    assert found.parameters["lowest_rate"].value == pytest.approx(slow, rel=1e-4)
    assert missing(t) == 0.0


def test_what_is_lost_in_a_stretch_is_lost() -> None:
    t = at_rates((100.0, 90.0), (50.0, 90.0))
    kept = t[np.random.default_rng(3).random(t.size) > 0.05]
    assert missing(kept) == pytest.approx(0.05, abs=0.01)
    names = [f.effect for f in timing_findings(stream(kept), Claims(nominal_rate_hz=100.0), sound_phones())]
    assert sorted(names) == ["dropped_samples", "unknown"]


def test_a_rate_that_stays_has_one_stretch() -> None:
    """Half of the samples lost at random, much jitter, and two seconds of another rate are no change."""
    even = at_rates((100.0, 180.0))
    for t in (
        even,
        even[np.random.default_rng(4).random(even.size) > 0.5],
        np.sort(at_rates((100.0, 180.0), jitter=4e-3)),
        at_rates((200.0, 2.0), (100.0, 180.0)),
    ):
        assert stretches(t) == []


def test_the_smallest_error_of_a_clock_is_told_where_its_rate_is_known() -> None:
    t = at_rates((100.0, 60.0))
    known, unknown = (
        [s.effect for s in of_stamps_and_values(stream(t), sound_phones(), nominal)]
        for nominal in (100.0, None)
    )
    assert "clock_skew" in known and "clock_skew" not in unknown
