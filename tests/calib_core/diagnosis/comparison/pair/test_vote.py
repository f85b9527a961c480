"""Whose an effect is that sensors on one body differ by."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.comparison.pair.vote import of_share, shares
from stillcal.calib_core.diagnosis.comparison.quantity import posterior
from stillcal.calib_core.diagnosis.model.effect import Linear, on_axes
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Parameters, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Evidence, Finding, Where
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.replay.diagnosis.pair.readings import less, mean_readings
from stillcal.replay.diagnosis.pair.witnesses import MISMATCH
from tests.support.diagnosis.one_body import LENGTH, course, sensor

DRIFT = np.array([2e-3, 0.0, -1e-3])
"""rad/s, of a gyroscope's bias."""

NOTHING = np.zeros(3)


def residuals_of(drifts: list[Array | None]) -> list[SensorResiduals]:
    """Return the gyroscope's residuals of each sensor less the mean of the others."""
    every = [sensor(seed, f"{seed}.csv", drift=drift) for seed, drift in enumerate(drifts)]
    out = []
    for k, own in enumerate(every):
        true = mean_readings(own, every[:k] + every[k + 1 :])
        out.append(pair_residuals(less(own, true), true, [], MISMATCH)[1][1])
    return out


def drifting(residuals: SensorResiduals) -> Stated:
    """Return a bias that changes as the generator's drift does."""
    effect = Parameters("drift", "gyro", (Linear("size", "rad/s", 3, 0.01),))
    columns = residuals.columns_of(on_axes(course(residuals.bins.t / LENGTH)))
    where = Where(*residuals.bins.span, SLOW_BAND, "time")
    return Stated(
        Finding("drift", "gyro", [], where, {}, Evidence(0.0), [], ""), Hypothesis(effect, {}, columns)
    )


@pytest.mark.parametrize("owner", [0, 1, 2])
def test_of_three_sensors_the_one_that_drifts_is_found(owner: int) -> None:
    sensors = residuals_of([DRIFT if k == owner else None for k in range(3)])
    assert shares(drifting(sensors[0]), [], sensors, NOTHING)[owner] > 0.99


def test_where_none_drifts_none_is_blamed() -> None:
    sensors = residuals_of([None, None, None])
    assert shares(drifting(sensors[0]), [], sensors, NOTHING).max() < 0.8


def test_two_sensors_decide_nothing_unless_one_shows_it_alone() -> None:
    one = drifting(residuals_of([DRIFT, None])[0])
    assert shares(one, [], [], np.zeros(2)) == pytest.approx([0.5, 0.5])
    assert shares(one, [], [], np.array([20.0, 0.0]))[0] > 0.999


def test_an_effect_of_either_counts_for_the_recording_as_no_more_than_its_share() -> None:
    for share in (0.1, 0.5, 0.9):
        assert posterior(of_share(200.0, share, 39), 39) == pytest.approx(share)
    assert of_share(200.0, 1.0, 39) == pytest.approx(200.0)
    assert of_share(-2.0, 0.5, 39) < -2.0
    assert posterior(of_share(200.0, 0.0, 39), 39) < 1e-100
