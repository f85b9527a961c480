"""The ranks of true parameters: what is put in is fitted, and uneven ranks are told from even ones."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.diagnosis.effects.timed import Charging, Step
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.replay.trials.ranks import chi_squared, cold, drawn, fitted, ranks, with_effect
from tests.support.diagnosis import nulls


def test_an_effect_that_is_put_in_is_fitted_and_its_posterior_holds_it() -> None:
    rng = np.random.default_rng(4)
    residuals = by_sensor(nulls.bins_of(rng, nulls.schedule(rng), "white"), nulls.G)[1]
    effect = BiasTemperature("gyro")
    made = drawn(residuals, effect, rng)
    assert made is not None
    true, _ = made
    value = np.array([2e-4, -1e-4, 0.0])
    found = fitted(with_effect(residuals, true, value), effect)
    assert np.abs(found.value - value).max() < 5.0 * found.sigma.max() < 1e-4
    assert np.abs(fitted(residuals, effect).value).max() < 5.0 * found.sigma.max(), (
        "the residuals are as they were"
    )
    told = ranks(residuals, effect, rng)
    assert told is not None
    assert told.shape == (3,)
    assert ((told > 1e-6) & (told < 1.0 - 1e-6)).all()


def test_a_step_is_put_into_every_view_that_its_estimate_uses() -> None:
    """A step across gravity is estimated there too; put into the norm alone, it would be contradicted."""
    rng = np.random.default_rng(2)
    residuals = by_sensor(nulls.bins_of(rng, nulls.schedule(rng), "white"), nulls.G)[0]
    effect = Step("accel")
    true, _ = drawn(residuals, effect, rng) or (None, None)
    assert true is not None
    assert "tangent" in [view.name for view in residuals.views]
    assert all(np.abs(columns).max() > 0.0 for columns in true.columns)
    value = np.array([0.0, 0.02, 0.02])
    found = fitted(with_effect(residuals, true, value), effect)
    assert (np.abs(found.value - value) < 5.0 * found.sigma).all()


def test_an_effect_that_does_not_show_has_no_ranks() -> None:
    rng = np.random.default_rng(4)
    residuals = by_sensor(nulls.bins_of(rng, nulls.schedule(rng), "white"), nulls.G)[0]
    effect = Step("accel")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stillcal.replay.trials.ranks.SIZES", np.array([1e-9]))
        assert ranks(residuals, effect, rng) is None


def test_an_effect_without_its_driver_has_no_ranks() -> None:
    rng = np.random.default_rng(4)
    bins = nulls.bins_of(rng, nulls.schedule(rng), "white", charger=False)
    residuals = by_sensor(bins, nulls.G)[1]
    assert drawn(residuals, Charging("gyro"), rng) is None
    assert drawn(cold(residuals), BiasTemperature("gyro"), rng) is None


def test_ranks_that_pile_up_are_not_uniform() -> None:
    even = (np.arange(100) + 0.5) / 100.0
    assert chi_squared(even) > 0.99
    assert chi_squared(even**2) < 0.01
    assert chi_squared(0.5 + 0.5 * (even - 0.5)) < 0.01, "intervals twice as wide as they should be"
