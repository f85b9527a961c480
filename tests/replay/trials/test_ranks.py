"""The ranks of true parameters: what is put in is fitted, and uneven ranks are told from even ones."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.diagnosis.effects.timed import Charging
from stillcal.calib_core.diagnosis.model.scenes import scenes
from stillcal.replay.trials.ranks import chi_squared, cold, drawn, fitted, ranks, with_effect
from tests.support.diagnosis import nulls


def test_an_effect_that_is_put_in_is_fitted_and_its_posterior_holds_it() -> None:
    rng = np.random.default_rng(4)
    scene = scenes(nulls.bins_of(rng, nulls.schedule(rng), "white"), nulls.G)[1]
    effect = BiasTemperature("gyro")
    made = drawn(scene, effect, rng)
    assert made is not None
    true, _ = made
    value = np.array([2e-4, -1e-4, 0.0])
    found = fitted(with_effect(scene, true, value), effect)
    assert np.abs(found.value - value).max() < 5.0 * found.sigma.max() < 1e-4
    assert np.abs(fitted(scene, effect).value).max() < 5.0 * found.sigma.max(), "the scene is as it was"
    told = ranks(scene, effect, rng)
    assert told is not None
    assert told.shape == (3,)
    assert ((told > 1e-6) & (told < 1.0 - 1e-6)).all()


def test_an_effect_without_its_driver_has_no_ranks() -> None:
    rng = np.random.default_rng(4)
    bins = nulls.bins_of(rng, nulls.schedule(rng), "white", charger=False)
    scene = scenes(bins, nulls.G)[1]
    assert drawn(scene, Charging("gyro"), rng) is None
    assert drawn(cold(scene), BiasTemperature("gyro"), rng) is None


def test_ranks_that_pile_up_are_not_uniform() -> None:
    even = (np.arange(100) + 0.5) / 100.0
    assert chi_squared(even) > 0.99
    assert chi_squared(even**2) < 0.01
    assert chi_squared(0.5 + 0.5 * (even - 0.5)) < 0.01, "intervals twice as wide as they should be"
