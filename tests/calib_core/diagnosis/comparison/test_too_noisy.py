"""What a simulation is too noisy, or too short, to show is not compared, and not said to be lacking there."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.of_samples import differences_of_samples
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.slow.statement import Stated
from tests.support.diagnosis.hours import Hour, made

QUIET = {"accel": 1.5e-3, "gyro": 1.2e-4}


@cache
def recorded(seconds: float, noise: float, seed: int) -> Examination:
    density = {sensor: noise * own for sensor, own in QUIET.items()}
    hour = Hour(seconds, rate=25.0, rests=(30.0, 60.0), density=density, wander=noise)
    return examine(*made(hour, seed), sought=())


def with_step(exam: Examination, size: float) -> Examination:
    """Return a recording that was found to have a step of the gyroscope's x bias, rad/s."""
    effect = next(e for e in effects_of("gyro") if e.name == "gyro_bias_step")
    residuals = next(s for s in exam.sensors if s.sensor == "gyro")
    own = replace(
        residuals.hypothesis(effect, {"t_start": float(np.median(residuals.bins.t))}), multiplicity=100.0
    )
    step = {"step": Parameter([size, 0.0, 0.0], None, "rad/s")}
    where = Where(150.0, 300.0, SLOW_BAND, "time")
    found = Finding(effect.name, "gyro", ["x"], where, step, Evidence(30.0), [], "")
    return replace(exam, statements=[Stated(found, own, residuals)])


@pytest.mark.parametrize(
    ("seconds", "noise", "size", "why"),
    [
        (300.0, 1.0, 2e-3, ""),
        (300.0, 10.0, 2e-3, "would not show one of this size"),
        (300.0, 10.0, 2e-2, ""),
        (300.0, 10.0, 0.3, ""),
        (90.0, 1.0, 2e-3, "s at rest"),
    ],
)
def test_a_step_is_lacking_only_where_it_would_have_been_seen(
    seconds: float, noise: float, size: float, why: str
) -> None:
    real = with_step(recorded(300.0, 1.0, 1), size)
    sim = replace(recorded(seconds, noise, 2), statements=[])
    for exams, of_recording in (((real, sim), True), ((sim, real), False)):
        both, alone, missing = differences_of_samples(exams, ({}, {}), ("a.csv", "b.csv"), ((), ()))
        assert both == []
        if why:
            assert alone == [] and [why in m.reason for m in missing] == [True]
            assert missing[0].reason.startswith("b.csv" if of_recording else "a.csv")
        else:
            assert missing == [] and [own for _, own in alone] == [of_recording]
