"""The hourly check of the calibration in use."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.calibration.drift_check import VERDICTS, Drift, QualitySettings, Verdict, check_rests
from stillcal.calib_core.calibration.rest_pool import HeldRest
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState

SETTINGS = QualitySettings()
IDENTITY = SensorModel.identity()


def held(force: list[float], rate: list[float] | None = None, uncertainty: float = 1e-3) -> HeldRest:
    sigma = np.full(3, uncertainty)
    rest = RestState(
        0,
        10,
        1000,
        np.array(force),
        sigma,
        sigma,
        uncertainty,
        rate=None if rate is None else np.array(rate),
        rate_uncertainty=None if rate is None else np.full(3, 1e-5),
    )
    return HeldRest(rest, Gravity(9.8, 0.0, "given"))


def test_every_pair_of_findings_has_a_verdict() -> None:
    assert set(VERDICTS) == {(a, g) for a in Drift for g in Drift}
    assert VERDICTS[Drift.DRIFTED, Drift.NONE] is Verdict.RECALIBRATE


def test_nothing_seen_is_nothing_said() -> None:
    assert check_rests(IDENTITY, 0.001, np.zeros(3), [], SETTINGS).verdict is Verdict.WAIT


@pytest.mark.parametrize(
    ("force", "rate", "verdict"),
    [
        ([0, 0, 9.801], [0, 0, 0], Verdict.KEEP),
        ([0, 0, 9.801], [0, 0.01, 0], Verdict.UPDATE_BIAS),
        ([0, 0, 9.9], [0, 0, 0], Verdict.RECALIBRATE),
        ([0, 9.7, 0], None, Verdict.RECALIBRATE),
        ([0, 9.8, 0], None, Verdict.KEEP),
    ],
)
def test_drift_of_either_sensor_is_told_apart(
    force: list[float], rate: list[float] | None, verdict: Verdict
) -> None:
    found = check_rests(IDENTITY, 0.002, np.zeros(3), [held(force, rate)] * 2, SETTINGS)
    assert found.verdict is verdict
    assert found.accel_residual == pytest.approx(np.linalg.norm(force) - 9.8)


def test_a_drift_within_its_uncertainty_is_none() -> None:
    far = [0, 0, 9.85]

    def found(norm_uncertainty: float, own: float = 1e-3) -> Drift:
        return check_rests(
            IDENTITY, norm_uncertainty, None, [held(far, uncertainty=own)] * 2, SETTINGS
        ).accelerometer

    assert found(0.001) is Drift.DRIFTED
    assert found(0.050) is Drift.NONE
    assert found(0.001, own=0.05) is Drift.NONE


def test_a_change_of_bias_shows_though_its_norms_cancel() -> None:
    """0.1 m/s^2 more on x: the norm grows with x up and shrinks with x down."""
    moved = [held([9.9, 0, 0]), held([-9.7, 0, 0]), held([0, 0, 9.8]), held([0, 0, -9.8])]
    found = check_rests(IDENTITY, 0.002, None, moved, SETTINGS)
    assert found.accel_residual == pytest.approx(0, abs=1e-9)
    assert (found.accelerometer, found.rests_off) == (Drift.DRIFTED, 2)


def test_one_rest_off_waits_for_another_and_is_outvoted_by_many() -> None:
    bad, good = held([0, 0, 9.9]), held([0, 9.8, 0])
    assert check_rests(IDENTITY, 0.002, None, [bad], SETTINGS).verdict is Verdict.WAIT
    assert check_rests(IDENTITY, 0.002, None, [bad, good], SETTINGS).verdict is Verdict.WAIT
    terrible = held([0, 0, 12.0])
    assert check_rests(IDENTITY, 0.002, None, [terrible, *[good] * 9], SETTINGS).verdict is Verdict.KEEP
