"""An estimate does not depend on the choice, of several that are as likely, that it begins with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.effects.warmup import LatentHeat
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.slow.estimate import estimate
from tests.support.diagnosis import nulls


def test_the_shares_of_a_latent_heat_are_averaged_over() -> None:
    rng = np.random.default_rng(3)
    bins = nulls.bins_of(rng, nulls.schedule(rng), "white", thermometer=False)
    residuals = by_sensor(replace(bins, temperature=None), nulls.G)[1]
    points = [h for h in residuals.hypotheses(LatentHeat("gyro")) if h.grid["tau_s"] == 450.0]
    assert len({(h.grid["plug"], h.grid["use"], h.grid["start"]) for h in points}) >= 3
    found = [estimate(residuals, h, []) for h in points[1:3]]
    np.testing.assert_allclose(found[0].sigma, found[1].sigma, rtol=0.15)
    assert (np.abs(found[0].value - found[1].value) < 0.25 * found[0].sigma).all()
