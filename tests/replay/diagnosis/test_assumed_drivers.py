"""A simulation that logged no temperature lacks an effect of it only where no course could hide that."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.coverage.assumed_drivers import excluded
from stillcal.calib_core.diagnosis.comparison.coverage.not_logged import not_logged
from stillcal.calib_core.diagnosis.comparison.linear.wanted import wanted_of
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.replay.diagnosis.judged import examined
from tests.support.report_days import phone_with, recorded


def exam(share: float, seed: int, *, thermometer: bool = True) -> Examination:
    """Examine a phone that has a share of an effect of temperature, its accelerometer alone."""
    slope = [share * x for x in (0.006, 0.0, -0.005)]
    made = recorded(phone_with({"name": "accel_bias_temperature", "slope": slope}), seed)
    warm = made.accelerometer.temperature if thermometer else None
    return examined(
        replace(made, accelerometer=replace(made.accelerometer, temperature=warm), gyroscope=None)
    )


@pytest.mark.slow
def test_a_bias_that_changes_with_another_course_of_temperature_is_not_steady() -> None:
    known = exam(1.0, 3)
    assert known.bins.temperature is not None
    other = replace(known, bins=replace(known.bins, temperature=frozen(known.bins.temperature[::-1].copy())))
    wanted = wanted_of(known)
    for share, lacking in ((0.0, ["accel_bias_temperature"]), (0.5, [])):
        exams = (other, exam(share, 8, thermometer=False))
        missing = not_logged(exams, (wanted, []), ("real.csv", "sim.csv"))[1]
        assert [m.effect.name for m in excluded(exams, wanted, missing)] == lacking
