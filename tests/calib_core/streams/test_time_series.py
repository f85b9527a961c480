"""A logged quantity between its readings, and its means over stretches."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.streams.time_series import TimeSeries

RAMP = TimeSeries(np.array([0.0, 10.0, 20.0]), np.array([0.0, 10.0, 0.0]))


def test_a_mean_is_that_of_straight_lines_between_readings() -> None:
    t = np.array([5.0, 10.0, 10.0, 15.0, 25.0, -4.0])
    duration = np.array([4.0, 0.0, 10.0, 10.0, 10.0, 2.0])
    means = RAMP.mean(t, duration)
    np.testing.assert_allclose(means, [5.0, 10.0, 7.5, 5.0, 0.0, 0.0], atol=1e-12)


def test_a_mean_over_several_swings_is_not_the_value_in_the_middle() -> None:
    t = np.arange(0.0, 100.0, 0.01)
    swing = TimeSeries(t, np.sin(t))
    middle, length = 50.0, 27.0
    exact = (np.cos(middle - length / 2) - np.cos(middle + length / 2)) / length
    np.testing.assert_allclose(swing.mean(np.array([middle]), np.array([length])), exact, atol=1e-5)
    assert abs(exact - np.sin(middle)) > 0.1
