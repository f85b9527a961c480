"""The Bayes factor of an effect over its grid: what is left out of the sum is nothing."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.effects.timed import Step
from stillcal.calib_core.diagnosis.inference import bayes_factor
from stillcal.calib_core.diagnosis.inference.likelihood import reduce_residuals
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from tests.support.diagnosis import nulls

AT = 1890.0


def of_a_step(size: float) -> tuple[list[Reduced], int]:
    """Return an accelerometer's residuals reduced for a step at seven moments, and how many. size: m/s^2."""
    rng = np.random.default_rng(4)
    day = nulls.schedule(rng)
    jump = np.outer(day.t > AT, [size, -size, size])
    residuals = by_sensor(nulls.bins_of(rng, day, "white", jump), nulls.G)[0]
    moments = [
        residuals.hypothesis(Step("accel"), {"t_start": AT + away}) for away in np.linspace(-900, 900, 7)
    ]
    return reduce_residuals(residuals, moments, parts=True), len(moments)


@pytest.mark.parametrize(("size", "most"), [(0.05, 14), (0.0, 29)])
def test_points_that_are_far_too_unlikely_are_left_out(
    size: float, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    views, count = of_a_step(size)
    weighed: list[int] = []
    weigh = bayes_factor.log_evidence

    def counted(views: list[Reduced], h: int) -> float:
        weighed.append(h)
        return weigh(views, h)

    monkeypatch.setattr(bayes_factor, "log_evidence", counted)
    quick = bayes_factor.log_bayes_factor(views, count, 1.0)
    assert len(weighed) <= most
    monkeypatch.setattr(bayes_factor, "NEGLIGIBLE", np.inf)
    weighed.clear()
    assert bayes_factor.log_bayes_factor(views, count, 1.0) == pytest.approx(quick, abs=1e-9)
    assert len(weighed) == 4 * count + 1
