"""Wander beyond what a phone may have is found; it is a random walk only where it surely is one."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.likelihood import reduce_residuals
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.slow.wander import Wander, sizes_along_gravity, wander, wanders_of
from tests.support.diagnosis import nulls

LIMIT = thresholds.RANDOM_WALK["gyro"]


def reduced(density: float, family: str = "white") -> tuple[SensorResiduals, list[Reduced]]:
    """Return a gyroscope's residuals whose bias walks by `density`, rad/s/sqrt(s), with its sums."""
    rng = np.random.default_rng(5)
    day = nulls.schedule(rng)
    steps = rng.standard_normal((day.t.size, 3)) * np.sqrt(np.gradient(day.t))[:, None]
    return with_error(day, rng, density * np.cumsum(steps, axis=0), family)


def with_error(
    day: nulls.Day, rng: np.random.Generator, error: Array, family: str
) -> tuple[SensorResiduals, list[Reduced]]:
    """Return a gyroscope's residuals with this error (n, 3) of its bias, rad/s, with its sums."""
    bins = nulls.bins_of(rng, day, family, gyro_error=error)
    residuals = next(s for s in by_sensor(bins, nulls.G) if s.sensor == "gyro")
    return residuals, reduce_residuals(residuals)


def test_a_walk_of_ten_times_what_is_allowed_is_sure_and_its_density_is_right() -> None:
    (finding,) = wander(*reduced(10.0 * LIMIT))
    assert finding.effect == "gyro_bias_random_walk" and finding.axes == ["x", "y", "z"]
    assert finding.evidence.log_bayes_factor > 12.0, "no wander of a sound phone moves a bias as far"
    for low, high in finding.parameters["density"].ci95:  # type: ignore[union-attr]
        assert low < 10.0 * LIMIT < high


@pytest.mark.parametrize("family", ["white", "flicker", "gm300", "walk_strong"])
def test_what_is_allowed_is_no_finding(family: str) -> None:
    residuals, sums = reduced(0.1 * LIMIT, family)
    assert wander(residuals, sums) == []
    assert max(w.log_bayes_factor(LIMIT) for w in wanders_of(sums)) < 3.0


def test_strong_wander_that_is_no_walk_has_no_name() -> None:
    """A bias that comes back within a minute, by 40 limits in the square root of one."""
    rng = np.random.default_rng(6)
    day = nulls.schedule(rng)
    size, tau = 40.0 * LIMIT * np.sqrt(60.0), 60.0
    error = nulls.Wander(gm=((tau, size),)).series(rng, day.t.size)
    (finding,) = wander(*with_error(day, rng, error, "white"))
    assert finding.effect == "unknown" and finding.axes == ["x", "y", "z"]
    assert finding.evidence.log_bayes_factor > 12.0, "no sound phone's bias moves as far"
    for low, high in finding.parameters["size"].ci95:  # type: ignore[union-attr]
        assert low < size < high < 3.0 * low


def test_other_strong_wander_speaks_against_the_name_and_not_for_a_sound_phone() -> None:
    """Shapes: a sound wander, a strong flicker, a strong walk; the data rule out the first alone."""
    plain = np.zeros(3, dtype=bool)
    weight, alike = np.array([1e-9, 0.007, 0.993]), np.array([0.5, 9.0, 10.0])
    walk = Wander(
        weight, np.array([0.4, 0.2, 0.4]), np.array([0.0, 0.0, 10.0]), alike, alike, alike, plain, plain
    )
    assert walk.walks_beyond(1.0) == pytest.approx(0.993)
    assert walk.log_bayes_factor_of_walk(1.0) == pytest.approx(np.log(0.993 / 1e-9))
    assert walk.beyond(1.0) == pytest.approx(1.0) and walk.log_bayes_factor(1.0) > np.log(1e9 / 2.0)


@pytest.mark.parametrize("seed", [0, 1, 5])
def test_the_size_of_an_accelerometers_wander_is_its_standard_deviation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    day = nulls.schedule(rng)
    error = nulls.Wander(gm=((100.0, 0.02),)).series(rng, day.t.size)
    bins = nulls.bins_of(rng, day, "white", accel_error=error)
    residuals = next(s for s in by_sensor(bins, nulls.G) if s.sensor == "accel")
    assert 0.75 < np.hypot(*sizes_along_gravity(residuals, [])) / float(error.std()) < 1.3
