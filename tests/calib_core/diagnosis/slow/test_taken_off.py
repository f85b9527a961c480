"""The gyroscope's scale by turns is not changed by what another effect does while the phone turns."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.rotation_alignment import aligned
from stillcal.calib_core.diagnosis.slow.taken_off import Known, OffRates, off_bins
from stillcal.calib_core.diagnosis.slow.wander import sizes_along_gravity
from stillcal.replay.diagnosis.judged import examined
from tests.support.report_days import phone_with, recorded

TRUE = np.linalg.inv(np.asarray(phone_with().gyro.scale, dtype=np.float64))
"""The mapping from the rate as read to the true one."""

FARTHEST = 1e-3
"""A tenth of a per cent: three times what turns of half an hour leave uncertain without any other effect."""

SENSITIVITY: dict[str, Any] = {"name": "gyro_g_sensitivity", "matrix": np.diag([3e-4, 0.0, -3e-4]).tolist()}
WARMUP: dict[str, Any] = {"name": "accel_warmup", "amplitude": [0.1, 0.0, 0.1], "tau_s": 300.0}


EFFECTS: dict[str, dict[str, Any]] = {one["name"]: one for one in (SENSITIVITY, WARMUP)}


@cache
def exam_with(name: str) -> Examination:
    """Return the examination of half an hour with an effect."""
    return examined(recorded(phone_with(EFFECTS[name]), 3, part_s=450.0))


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_what_was_found_at_rest_does_not_turn_into_a_scale(name: str) -> None:
    exam = exam_with(name)
    assert [s.finding.effect for s in exam.statements] == [name]
    assert exam.aligned is not None and exam.gyroscope is not None
    as_read = aligned(exam.gyroscope, exam.bins, exam.claims.gravity)
    assert np.abs(exam.aligned.mapping - TRUE).max() < FARTHEST < np.abs(as_read.mapping - TRUE).max()


@pytest.mark.slow
def test_what_was_found_of_a_bias_is_no_wander_that_turns_allow_for() -> None:
    exam = exam_with(WARMUP["name"])
    accel = next(s for s in exam.sensors if s.sensor == "accel")
    assert exam.aligned is not None
    assert exam.aligned.unsteady.wander < 0.3 * sizes_along_gravity(accel, [])[0]


@pytest.mark.slow
def test_bins_without_what_is_known_are_those_of_a_phone_without_it() -> None:
    exam = exam_with(WARMUP["name"])
    bare = off_bins(exam.bins, Known.among(exam.statements))
    added = exam.bins.force - bare.force
    true = -np.exp(-(exam.bins.t - exam.bins.span[0]) / WARMUP["tau_s"])[:, None] * WARMUP["amplitude"]
    # A constant goes with the bias.
    assert np.abs(np.ptp(added - true, axis=0)).max() < 0.15 * np.ptp(true)
    assert bare.rate is exam.bins.rate


@pytest.mark.slow
def test_what_follows_the_force_is_taken_off_by_the_force_itself() -> None:
    """It was by what the accelerometer reads: its bias made a gain of the gyroscope of what was left."""
    exam = exam_with(SENSITIVITY["name"])
    assert exam.gyroscope is not None
    wrong, known = np.array([0.0, 0.0, 0.6]), Known.among(exam.statements)
    biased = replace(exam.accelerometer, xyz=frozen(exam.accelerometer.xyz + wrong))
    bins = replace(exam.bins, force=exam.bins.force + wrong)
    gravity = exam.claims.gravity
    right = OffRates.of(known, exam.accelerometer, exam.bins, gravity)(exam.gyroscope)
    made = OffRates.of(known, biased, bins, gravity)(exam.gyroscope)
    assert np.abs(made - right).max() < 0.05 * 3e-4 * np.abs(wrong).max()
