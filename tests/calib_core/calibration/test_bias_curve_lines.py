"""Lines that are drawn where a bias is learnt by temperature: when a curve is dropped, what widens what."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.calibration.bias_curve.evidence import MATTERS, change_of
from stillcal.calib_core.calibration.bias_curve.learn import _after, _wider
from stillcal.calib_core.calibration.bias_curve.learnt import DROPPED
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.regression import GYROSCOPE, Observations

HOURS = 12


def seen(celsius: list[float]) -> Observations:
    n = len(celsius)
    t = 3600.0 * np.arange(n) + 1800.0
    return Observations(
        t, np.array(celsius), np.zeros((n, 3)), np.full(n, 1e-4), np.ones((n, 1)), np.array([1.0])
    )


def fit(size: float) -> Any:
    """Return a fit by which every rest misses its prediction by `size` rad/s on each axis."""
    n = HOURS + 1
    return SimpleNamespace(
        errors=np.full((n, 3), size),
        errors_sd=np.full(n, 1e-3),
        wander=SimpleNamespace(declared=1.0, white=0.0),
    )


@pytest.mark.parametrize(
    ("worse", "change"), [(1.0, ""), (MATTERS - 0.02, ""), (MATTERS + 0.02, DROPPED), (0.5, "")]
)
def test_a_curve_in_use_is_dropped_where_it_makes_errors_a_fifth_larger(worse: float, change: str) -> None:
    assert MATTERS == 1.2
    rests = seen([20.0 + i for i in range(HOURS + 1)])
    decided, evidence = change_of(fit(1e-3 * worse), fit(1e-3), rests, True, QualitySettings())
    assert decided == change and evidence["hours"] == HOURS


def test_rests_without_a_temperature_are_as_uncertain_as_half_of_what_the_term_rises_by() -> None:
    slope = TermParameter(value=np.array([1e-4, -2e-4, 0.0]), unit="rad/s/K")
    term = Term(
        effect="gyro_bias_temperature",
        sensor=Sensor.GYROSCOPE,
        parameters={"slope": slope},
        reference={"temperature": 25.0},
    )
    rests = seen([20.0, np.nan, 30.0, 24.0])
    assert np.asarray(_wider(rests, term).more) == pytest.approx([0.0, 1e-3, 0.0, 0.0])
    assert _wider(rests, None) is rests


def test_what_is_known_of_a_curve_before_is_that_of_its_least_known_axis() -> None:
    curve = [[1.0, 2.0, 3.0], [6.0, 5.0, 4.0], [7.0, 9.0, 8.0]]
    before: Any = SimpleNamespace(covariance=np.diag(np.concatenate([[99.0] * 3, *np.square(curve)])))
    assert _after(GYROSCOPE, before).curve == (3.0, 6.0, 9.0)
    assert _after(GYROSCOPE, None) is GYROSCOPE
