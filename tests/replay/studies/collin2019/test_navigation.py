"""Tables 3 and 4, the powers of error growth, and the hour on a round Earth, against theory."""

import math

import numpy as np
import pytest

from stillcal.replay.studies.collin2019.inertial_navigation import (
    DEG_H,
    EARTH_M,
    G,
    growth,
    hour_on_earth,
    power,
)
from stillcal.replay.studies.collin2019.pedestrian_tables import (
    HOUR,
    MINUTE,
    scale_effect,
    table3,
    table4,
    walk,
)


def test_times_of_table_3_are_those_printed() -> None:
    assert np.array(table3(2)) / MINUTE == pytest.approx([5.5, 8.25, 7.2], abs=0.005)
    assert np.array(table3(1)) / HOUR == pytest.approx([2.3, 3.44, 3.0], abs=0.01)


@pytest.mark.parametrize(("grade", "percent"), [(0, 0.001), (1, 0.015), (2, 1.0)])
def test_a_half_turn_leaves_the_scale_error_s_share_of_it(grade: int, percent: float) -> None:
    heading, position = table4(grade)
    assert heading == pytest.approx(1.8 * percent, rel=1e-6)
    assert position == pytest.approx(200.0 * math.sin(math.radians(0.9 * percent)), rel=1e-6)


def test_walk_without_errors_is_the_true_one() -> None:
    walked = walk(60.0)
    assert np.abs(walked.estimated - walked.true).max() < 1e-9
    assert walked.true[-1] == pytest.approx([90.0, 0.0])


def test_scale_moves_each_pattern_by_its_order() -> None:
    effect = scale_effect(3)
    assert effect[0] == pytest.approx(0.0, abs=0.01)  # the frequency hardly changes
    assert effect[[1, 2]] == pytest.approx(0.0201, rel=1e-3)
    assert effect[[4, 5]] == pytest.approx(0.01, rel=1e-3)
    followed = scale_effect(3, reference=1.01)
    assert followed[3] == pytest.approx(0.01, rel=1e-6)  # the area, where g is scaled with the forces
    assert abs(effect[3] - 0.01) > 1e-4


def test_powers_of_growth() -> None:
    assert power(*growth(1e-3, 0.0)) == pytest.approx(2.0, abs=1e-3)
    assert power(*growth(0.0, 1e-5)) == pytest.approx(3.0, abs=1e-2)


def test_schuler_oscillation_has_its_period_and_size() -> None:
    bias, schuler = 0.01, math.sqrt(G / EARTH_M)
    t, error = hour_on_earth(bias, 0.0, 2.0 * math.pi / schuler)
    assert error == pytest.approx(bias / schuler**2 * (1.0 - np.cos(schuler * t)), rel=1e-3, abs=0.1)
    drift = 0.005 * DEG_H
    t, error = hour_on_earth(0.0, drift, 3600.0)
    assert error == pytest.approx(EARTH_M * drift * (t - np.sin(schuler * t) / schuler), rel=1e-3, abs=0.1)
