"""What follows a driver without a name is as large as the driver's course makes it, in each recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.of_samples import differences_of_samples
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.effects.unknown import unknown_effects
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.slow.statement import Stated
from tests.support.diagnosis.hours import Hour, made

HOUR = Hour(600.0, rate=25.0, rests=(30.0, 60.0), density={"accel": 1.5e-3, "gyro": 1.2e-4}, wander=1.0)


def following(driver: str, size: float, seed: int) -> Examination:
    """Return a recording that was found to follow a driver without a name, rad/s on each axis."""
    exam = examine(*made(HOUR, seed), sought=())
    residuals = next(s for s in exam.sensors if s.sensor == "gyro")
    effect = next(e for e in unknown_effects("gyro") if e.follows == driver)
    count = effect.parameters[0].count
    own = replace(
        residuals.hypotheses(
            next(e for e in unknown_effects("gyro") if e.follows == "attitude, nonlinearly")
        )[0],
        effect=effect,
    )
    amplitude = Parameter([size] * count, [[0.99 * size, 1.01 * size]] * count, "rad/s")
    where = Where(0.0, 600.0, SLOW_BAND, driver)
    found = Finding("unknown", "gyro", ["x"], where, {"amplitude": amplitude}, Evidence(30.0), [], "")
    return replace(exam, statements=[Stated(found, own, residuals)])


@pytest.mark.parametrize(
    ("driver", "compared"), [("rate of heating", False), ("attitude, nonlinearly", True)]
)
def test_the_size_of_what_follows_a_driver_is_compared_where_both_had_its_whole_range(
    driver: str, compared: bool
) -> None:
    """Heating at 0.03 and at 0.06 K/s, thermometers 5 s late: the simulation's bias seemed too large."""
    exams = following(driver, 1e-3, 1), following(driver, 2e-3, 2)
    both, alone, missing = differences_of_samples(exams, ({}, {}), ("a.csv", "b.csv"), ((), ()))
    assert alone == [] and len(both) == compared
    assert [m.reason.startswith("both: it follows rate of heating") for m in missing] == [True] * (
        not compared
    )
    assert not both or np.all(both[0].value < 0.0)
