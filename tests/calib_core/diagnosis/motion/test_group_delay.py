"""A low-pass on one sensor delays it: the filter is named where the noise shows it, not the delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.diagnose import diagnose
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.model.rotation_alignment import aligned
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.motion.group_delay import FilterDelay
from stillcal.calib_core.diagnosis.motion.time_offset import shown_in_motion
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet, judged
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.streams.samples import Samples
from tests.calib_core.diagnosis.motion.test_time_offset import G, played
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


def test_a_delay_beside_a_low_pass_is_what_the_low_pass_does_not_delay() -> None:
    made = turned(1)
    assert made.gyroscope is not None
    both = low_passed(late(made.gyroscope, 0.035), 0.2)
    found = {f.effect: f for f in diagnose(made.accelerometer, both).findings}
    assert set(found) == {"bandwidth", "accel_gyro_time_offset"}
    interval = found["accel_gyro_time_offset"].parameters["delay"].ci95
    assert interval is not None and interval[0] <= 0.035 <= interval[1]
    assert found["bandwidth"].alternatives == []


def test_what_a_low_pass_does_to_fast_and_slow_motion_is_no_delay_that_grows() -> None:
    """At 8 Hz a filter of the first order is 20 ms late, for slow motion."""
    spectra = judged(Quiet(tuple(NOISE), tuple(10.0 * i for i in range(len(NOISE))), 100.0))
    assert spectra is not None
    filters = FilterDelay.of({"accel": spectra, "gyro": replace(spectra, low_pass=None)})
    assert filters is not None and filters.delay.value == pytest.approx(-0.02, rel=0.1)
    assert filters.explains_growth(-0.006) and not filters.explains_growth(0.08)
    assert filters.explains_arm(0.002, 9.8) and not filters.explains_arm(0.01, 9.8)
    assert FilterDelay.of({"accel": spectra, "gyro": spectra}) is None


def test_a_low_pass_may_be_the_other_sensors_too_where_its_noise_does_not_tell() -> None:
    spectra = judged(Quiet(tuple(NOISE), tuple(10.0 * i for i in range(len(NOISE))), 100.0))
    assert spectra is not None
    filters = FilterDelay.of({"accel": spectra})
    assert filters is not None
    for delay in (0.0, -0.02):
        beyond = filters.beyond(Measured(delay, 0.0))
        assert abs(beyond.value) <= 1.1 * beyond.error


def test_a_low_pass_too_wide_for_a_finding_delays_its_sensor_as_well() -> None:
    """Of two sensors with the same low-pass near that limit, noise may put one on either side of it."""
    white = np.random.default_rng(3).normal(size=(2, 20, 1000, 3))
    made = [lfilter(*butter(2, 2.0 * cut), x, axis=1) for cut, x in zip((0.375, 0.4), white, strict=True)]
    seen = [judged(Quiet(tuple(x), tuple(10.0 * i for i in range(len(x))), 100.0)) for x in made]
    accel, gyro = seen
    assert accel is not None and accel.low_pass is not None
    assert gyro is not None and gyro.low_pass is None
    filters = FilterDelay.of({"accel": accel, "gyro": gyro})
    assert filters is not None and abs(filters.delay.value) < 1e-3
    assert FilterDelay.of({"gyro": gyro}) is None


def test_motion_without_a_delay_refutes_a_low_pass_that_vibration_imitates() -> None:
    """What shakes a phone at rest has a spectrum of its own; stamps that undo its low-pass were stated."""
    accelerometer, gyroscope = played(11)
    spectra = judged(Quiet(tuple(NOISE), tuple(10.0 * i for i in range(len(NOISE))), 100.0))
    assert spectra is not None
    filters = FilterDelay.of({"accel": spectra, "gyro": replace(spectra, low_pass=None)})
    affine = aligned(gyroscope, cut(accelerometer, gyroscope), G)
    usual = sound_phones()["time_offset"]
    shown = shown_in_motion(accelerometer, gyroscope, affine, G, usual, filters=filters)
    assert shown.findings == [] and shown.delay is not None
    assert abs(shown.delay.value) < 3.0 * shown.delay.error < 0.01


NOISE = lfilter(*butter(1, 0.16), np.random.default_rng(8).normal(size=(20, 1000, 3)), axis=1)
