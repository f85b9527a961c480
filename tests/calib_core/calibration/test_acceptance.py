"""The acceptance rule: a new calibration against the old one on held-out rests."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.calibration.acceptance import compare_residuals
from stillcal.calib_core.calibration.drift_check import QualitySettings

SETTINGS = QualitySettings()


def test_a_better_calibration_wins_and_an_equal_one_seldom() -> None:
    rng = np.random.default_rng(3)
    sd = np.full(20, 0.01)
    wins = 0
    for _ in range(400):
        noise = rng.normal(0, 0.01, 20)
        wins += compare_residuals(
            noise + rng.normal(0, 0.003, 20), noise + rng.normal(0, 0.003, 20), sd, SETTINGS
        ).better
    # The test's own 2.5 %; 400 trials, three standard errors either way.
    assert abs(wins / 400 - 0.025) < 3 * np.sqrt(0.025 * 0.975 / 400)
    drifted = compare_residuals(rng.normal(0.05, 0.01, 20), rng.normal(0, 0.01, 20), sd, SETTINGS)
    assert drifted.better and drifted.rms_new < drifted.rms_old


def test_too_few_held_out_rests_decide_nothing() -> None:
    few = compare_residuals(np.full(3, 0.1), np.zeros(3), np.full(3, 0.01), SETTINGS)
    assert not few.better and few.rests == 3
    one_sided = compare_residuals(np.full(6, 0.1), np.zeros(6), np.full(6, 0.01), SETTINGS)
    assert one_sided.better and one_sided.chance == 2.0**-6
    assert not compare_residuals(np.empty(0), np.empty(0), np.empty(0), SETTINGS).better
