"""Which logged columns are copies of what drives another effect."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias, copies
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.diagnosis.model.effect import Effect, on_axes
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis

TURN = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
WARM, ACROSS = np.cos(TURN), np.sin(TURN)
"""Two curves about their means that do not correlate."""


def follows(effect: Effect, correlation: float) -> Hypothesis:
    """Return an effect whose driver has this correlation with `WARM`."""
    curve = correlation * WARM + np.sqrt(1.0 - correlation**2) * ACROSS
    return Hypothesis(effect, {}, (on_axes(1.8 * curve),))


@pytest.mark.parametrize(("correlation", "same"), [(0.9985, False), (0.9995, True), (-0.9995, True)])
def test_a_column_is_a_copy_from_a_correlation_of_0_999(correlation: float, same: bool) -> None:
    warm, column = BiasTemperature("gyro"), CovariateBias("gyro", "case_f", 10.0)
    assert copies(follows(warm, 1.0), follows(column, correlation)) is same
    assert copies(follows(column, correlation), follows(warm, 1.0)) is same


def test_two_effects_of_the_catalogue_are_rivals_however_alike() -> None:
    warm = follows(BiasTemperature("gyro"), 1.0)
    assert not copies(warm, warm)


def test_an_effect_of_more_parameters_is_no_copy() -> None:
    column, bent = CovariateBias("gyro", "case_f", 10.0), BiasTemperature("gyro", 2)
    both = Hypothesis(bent, {}, (np.concatenate([on_axes(WARM), on_axes(WARM**2)], axis=2),))
    assert not copies(follows(column, 1.0), both)
