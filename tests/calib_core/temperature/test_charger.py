"""The charger as a stand-in for a thermometer: a first-order filter of plug events, and what is unknown."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.codec import packed, unpacked
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.temperature.charger import (
    CHARGER_LAGS_S,
    FULL_K,
    MOST_CHANGES,
    SPAN_S,
    Charger,
    followed,
)

HOUR = 3600.0
EVENTS = [Charging(HOUR, True), Charging(3 * HOUR, False), Charging(3.2 * HOUR, True)]


def test_it_is_the_filter_of_a_reading_that_steps_and_unknown_before_the_first_change() -> None:
    t = np.arange(0.0, 8 * HOUR, 1.0)
    course = Charger().with_events(EVENTS).course(t)
    on = (t >= HOUR) & ((t < 3 * HOUR) | (t >= 3.2 * HOUR))
    for column, lag in enumerate(CHARGER_LAGS_S, start=1):
        value, wanted = 0.5, np.empty(len(t))
        for row, now in enumerate(on.tolist()):  # Euler's small steps: another formula than the one tested
            value = value + (now - value) / lag if t[row] > HOUR else 0.5
            wanted[row] = FULL_K * value
        known = np.isfinite(course[:, column])
        assert np.abs(course[known, column] - wanted[known]).max() <= FULL_K / lag
        assert known.argmax() == pytest.approx(HOUR + lag * np.log(10.0), abs=2.0)
    assert np.isnan(course[t < HOUR]).all()
    np.testing.assert_array_equal(course[t >= HOUR, 0], FULL_K * on[t >= HOUR])


def test_what_is_forgotten_counts_for_nothing_and_a_state_said_twice_is_no_change() -> None:
    events = [Charging(600.0 * k, not k % 2) for k in range(100)]
    whole = Charger().with_events([*events, events[-1]])
    assert len(whole.t) == 100
    late, t = whole.of_late(), events[-1].t + 900.0
    assert len(late.t) < 40 and late.t[0] <= late.t[-1] - SPAN_S
    assert late.at(t) == pytest.approx(whole.at(t), abs=0.002)
    again = unpacked(packed(late), Charger)
    np.testing.assert_array_equal(again.at(t), late.at(t))
    assert Charger().of_late().at(t).shape == late.at(t).shape


def test_after_a_loose_plug_the_slow_lags_are_unknown() -> None:
    flapping = Charger().with_events(Charging(1.0 * k, not k % 2) for k in range(1000)).of_late()
    assert len(flapping.t) == MOST_CHANGES
    soon = flapping.at(1010.0)
    assert np.isfinite(soon[0]) and np.isnan(soon[1:]).all()
    assert followed(soon, CHARGER_LAGS_S[0]).tolist() == [soon[0]]
    assert np.isnan(followed(flapping.at(1010.0), 900.0)).all()  # another version's lag
