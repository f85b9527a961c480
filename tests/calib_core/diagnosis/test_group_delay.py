"""A low-pass on one sensor delays it: the filter is named where the noise shows it, not the delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.diagnose import diagnose
from stillcal.calib_core.diagnosis.group_delay import without_group_delay
from stillcal.calib_core.diagnosis.model.measurement import Seen, direct_finding
from stillcal.calib_core.diagnosis.model.records import Finding, Parameter, Where
from stillcal.calib_core.streams.samples import Samples
from tests.support.diagnosis.turned_pairs import RATE, low_passed, turned


def late(samples: Samples, by: float) -> Samples:
    """Return the readings stamped as if they were `by` s later than they are."""
    t = samples.t
    moved = np.stack([np.interp(t - by, t, samples.xyz[:, a]) for a in range(3)], axis=1)
    noise = np.random.default_rng(5).normal(0.0, 5e-4, moved.shape)
    return replace(samples, xyz=frozen(moved + noise))


@pytest.mark.parametrize("cutoff", [0.2, 0.27])
def test_a_low_pass_of_one_sensor_is_named_by_its_cutoff(cutoff: float) -> None:
    made = turned(1)
    assert made.gyroscope is not None
    found = diagnose(made.accelerometer, low_passed(made.gyroscope, cutoff)).findings
    assert [(f.effect, f.sensor) for f in found] == [("bandwidth", "gyro")]
    interval = found[0].parameters["cutoff"].ci95
    assert interval is not None and interval[0] <= cutoff * RATE <= interval[1]
    assert [(a.effect, a.indistinguishable) for a in found[0].alternatives] == [
        ("accel_gyro_time_offset", True)
    ]


def test_a_low_pass_of_both_sensors_is_no_delay_and_explains_none() -> None:
    made = turned(1)
    assert made.gyroscope is not None
    force, rate = (low_passed(s, 0.27) for s in (made.accelerometer, made.gyroscope))
    assert diagnose(force, rate).findings == []
    found = diagnose(force, low_passed(late(made.gyroscope, 0.03), 0.27)).findings
    assert [f.effect for f in found] == ["accel_gyro_time_offset"]


def of(effect: str, sensor: str, **sizes: float) -> Finding:
    parameters = {name: Parameter(value, None, "s") for name, value in sizes.items()}
    where = Where(0.0, 600.0, (0.0, 50.0), "rate of turn, with time")
    made = direct_finding(effect, sensor, [], where, parameters, statement="", seen=Seen(50.0))
    assert made is not None
    return made


@pytest.mark.parametrize(("growth", "explained"), [(-0.006, True), (0.08, False)])
def test_a_delay_that_goes_with_the_motion_is_a_low_pass_own(growth: float, explained: bool) -> None:
    """At 8 Hz a filter of the first order is 20 ms late, for slow motion."""
    found = [of("bandwidth", "accel", cutoff=8.0), of("unknown", "timing", growth=growth)]
    assert (without_group_delay(found, 9.8) == found[:1]) == explained
    assert without_group_delay(found[1:], 9.8) == found[1:]
