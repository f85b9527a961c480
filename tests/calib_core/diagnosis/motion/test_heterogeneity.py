"""The error of a delay, or an arm, grows where its parts disagree, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.diagnosis.motion.block_regression import Regression
from stillcal.calib_core.diagnosis.motion.heterogeneity import disagreement
from stillcal.calib_core.diagnosis.motion.lever_arm import lever_arm

WINDOWS, FREQUENCIES = 40, 60
FREQUENCY = np.arange(FREQUENCIES) / 8.0


def spectra(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """What a delay of 1 s does, and noise of which one Hann window's neighbours share a value."""
    rng = np.random.default_rng(seed)
    shape = (WINDOWS, FREQUENCIES, 3)
    late = 300.0 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    noise = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2.0)
    return late, noise


@pytest.mark.parametrize("seed", range(4))
def test_parts_that_agree_add_little(seed: int) -> None:
    late, noise = spectra(seed)
    sampling = 1.0 / np.sqrt(2.0 * (np.abs(late) ** 2).sum())
    assert disagreement(late, noise, FREQUENCY) < 3.0 * sampling


def test_delays_that_differ_between_directions_are_as_uncertain_as_they_differ() -> None:
    late, noise = spectra(9)
    apart = late * np.array([0.01, -0.01, 0.0])
    error = disagreement(late, noise + apart, FREQUENCY)
    assert 0.0005 < error < 0.01


def test_an_arm_on_which_frequencies_do_not_agree_is_none() -> None:
    rng = np.random.default_rng(5)
    arm, designs = np.array([0.0, 0.08, -0.05]), [rng.normal(size=(60, 3, 3)) for _ in range(WINDOWS)]
    sums = Regression.of(designs, [d @ arm + rng.normal(0.0, 0.05, (60, 3)) for d in designs])
    where = Where(0.0, 600.0, (0.1, 25.0), "rate of turn")
    found = lever_arm(sums, 0.2, where)
    assert found is not None and found.effect == "lever_arm"
    low, high = found.parameters["position"].ci95[1]
    assert high - low == pytest.approx(2 * 1.96 * 0.2 * 0.08, rel=0.1)
    assert lever_arm(sums, 0.5, where) is None
