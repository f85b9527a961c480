"""A grid that is coarser for a while is found; one grid all along is silent, whatever moves the phone."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.direct.step_changes import step_change
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.streams.samples import Samples, Sensor

Array = np.ndarray
N, STEP = 12000, 1.2e-3


def phone(seed: int) -> Array:
    """Return eight rests with noise of eight steps, a turn of 2 s before each."""
    rng = np.random.default_rng(seed)
    x = np.clip((np.arange(N) % 1500) / 200.0, 0.0, 1.0)[:, None]
    ends = rng.normal(0.0, 5.0, (10, 3))
    which = np.arange(N) // 1500
    return np.asarray(ends[which] * (1.0 - x) + ends[which + 1] * x + rng.normal(0.0, 8.0 * STEP, (N, 3)))


def found(values: Array) -> Finding | None:
    rounded = np.rint(values / STEP) * STEP
    return step_change(Samples.checked(Sensor.ACCELEROMETER, np.arange(N) / 100.0, rounded), "accel")


@pytest.mark.parametrize("ratio", [4.0, 31.7])
def test_coarser_steps_from_a_moment_on(ratio: float) -> None:
    values = phone(1)
    values[7500:] = np.rint(values[7500:] / (ratio * STEP)) * ratio * STEP
    seen = found(values)
    assert seen is not None and seen.effect == "unknown"
    assert seen.where.t_start == pytest.approx(75.0, abs=3.0) and seen.where.t_end > 119.0
    assert seen.parameters["step"].value == pytest.approx(ratio * STEP, rel=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_one_grid_all_along_is_silent(seed: int) -> None:
    """Fine, coarser than the noise, and with a quiet rest of few values."""
    assert found(phone(seed)) is None
    coarse = np.rint(phone(seed) / (20.0 * STEP)) * 20.0 * STEP
    assert found(coarse) is None
    still = phone(seed)
    still[6300:7500] = still[6300]
    assert found(still) is None
