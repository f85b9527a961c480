"""A recording that rejects the simulation without a stated effect is no match."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.calib_core.diagnosis.comparison.records import LEVEL
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.streams.samples import Samples, Sensor


@pytest.mark.parametrize(("settling", "verdict"), [(0.01, "unidentified"), (0.0, "match")])
def test_the_verdict_agrees_with_its_p_where_no_effect_is_stated(settling: float, verdict: str) -> None:
    """A bias settles over 50 s; without a search nothing is stated, as where left-out parts refute it."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 300.0, 0.05)
    force = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.01, (t.size, 3))
    rate = rng.normal(0.0, 1e-3, (t.size, 3)) + settling * np.outer(np.exp(-t / 50.0), [1.0, 0.0, 0.0])
    accel = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force))
    exam = examine(accel, Samples(Sensor.GYROSCOPE, frozen(t), frozen(rate)), sought=())
    assert exam.statements == []
    said = compare_with_ideal(exam)
    assert said.verdict(said.p()) == verdict and (said.p() < LEVEL) == (verdict == "unidentified")
    if verdict == "unidentified":
        (found,) = said.discrepancies
        assert (found.effect, found.sensor, found.relation) == ("unknown", "gyro", "lacking")
        (nearest,) = said.undecided
        assert nearest.effect.startswith(("gyro_", "thermal")) and "left out of the fit" in nearest.reason
