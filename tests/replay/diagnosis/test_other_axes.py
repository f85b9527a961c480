"""Axes that one of a recording and a simulation tells otherwise are one finding, of the right sensor."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.axes import exchange_of
from stillcal.replay.diagnosis.given_simulation import judge_simulation
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone import load_scenario, simulate
from tests.support.report_days import phone_with

Signs = tuple[float, float, float]
SAME: Signs = (1.0, 1.0, 1.0)


@cache
def recorded(seed: int, accel: Signs = SAME, gyro: Signs = SAME) -> Recording:
    """Return ten minutes of rests and turns, with signs of the axes turned."""
    made = simulate(load_scenario("lab"), phone_with(), seed).whole()
    claims = msgspec.convert(phone_with().claimed(), Claims)
    force, rate = (
        replace(s, xyz=frozen(s.xyz * signs)) if s is not None else None
        for s, signs in ((made.accelerometer, accel), (made.gyroscope, gyro))
    )
    assert force is not None
    return Recording(force, rate, list(made.events), claims, [], name=f"{seed}.csv")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("accel", "gyro"),
    [
        ((1.0, -1.0, 1.0), SAME),
        (SAME, (1.0, 1.0, -1.0)),
        (SAME, (-1.0, 1.0, -1.0)),
        ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0)),
    ],
)
def test_whose_axes_are_wrong_the_constants_tell(accel: Signs, gyro: Signs) -> None:
    """A mirrored axis of the accelerometer and two turned ones of the gyroscope look alike in turns."""
    one, other = examined(recorded(3, accel, gyro), sought=()), examined(recorded(8), sought=())
    found = exchange_of(one, other)
    assert found is not None and exchange_of(other, one) is None and exchange_of(one, one) is None
    for sensor, signs in (("accel", accel), ("gyro", gyro)):
        np.testing.assert_array_equal(found.matrices.get(sensor, np.eye(3)), np.diag(signs))
    assert found.said.startswith("By bias and misalignment")


@pytest.mark.slow
def test_a_mirrored_axis_is_one_finding_without_a_bias_or_a_misalignment_besides() -> None:
    answer = judge_simulation(recorded(3, (1.0, -1.0, 1.0)), recorded(8)).answer
    (finding,) = answer["findings"]
    assert (finding["effect"], finding["sensor"], finding["axes"]) == ("axis_exchange", "accel", ["y"])
    assert finding["relation"] == "lacking" and "undone by y = -y." in finding["statement"]
    assert finding["statement"].endswith(f"{finding['put_right']}")
    assert answer["verdict"] == "identified" and answer["fit"]["p_before"] < 1e-6
