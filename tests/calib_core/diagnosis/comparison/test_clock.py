"""A clock that runs fast, beside the gyroscope's scale, which turns tell by the stamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.linear.quantities import linear_quantities
from stillcal.calib_core.diagnosis.comparison.records import Discrepancy
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.formats.trace import Recording
from tests.support import report_days

FAST = 3e-3


def by_a_fast_clock(samples: Samples, *, arrives: bool, fast: float = FAST) -> Samples:
    """Return samples stamped by a clock that runs fast. arrives: whether the host's time is kept."""
    late = np.random.default_rng(3).uniform(0.002, 0.006, len(samples))
    arrival = samples.t + late if arrives else None
    return replace(samples, t=samples.t * (1.0 + fast), t_arrival=arrival)


def gyro_scale(recording: Recording) -> Array:
    """Return the scale and misalignment (3, 3) that a comparison would state."""
    found = linear_quantities(examined(recording, sought=()), [], {})
    return found["gyro_scale", "gyro"].value.reshape(3, 3)


def test_the_scale_of_the_gyroscope_is_that_at_the_hosts_time() -> None:
    recording = report_days.recorded(report_days.phone_with(), 5, part_s=240.0)
    assert recording.gyroscope is not None
    true = gyro_scale(recording)
    for arrives, off in ((True, 0.0), (False, FAST)):
        accelerometer, gyroscope = (
            by_a_fast_clock(s, arrives=arrives) for s in (recording.accelerometer, recording.gyroscope)
        )
        stretched = replace(recording, accelerometer=accelerometer, gyroscope=gyroscope)
        assert true.diagonal() - gyro_scale(stretched).diagonal() == pytest.approx(off, abs=FAST / 5.0)


def evenly_stamped(samples: Samples) -> Samples:
    """Return samples whose stamps are computed from their rate."""
    return replace(samples, t=frozen(np.linspace(samples.t[0], samples.t[-1], len(samples))))


def of_scale(recording: Recording, simulation: Examination) -> Discrepancy:
    """Return what is said of the gyroscope's scale."""
    found = compare(examined(recording, sought=()), simulation, ("real.csv", "sim.csv")).discrepancies
    return next(d for d in found if d.effect == "gyro_scale")


@pytest.mark.slow
def test_a_scale_alike_on_all_axes_may_be_the_clocks() -> None:
    recording = report_days.recorded(report_days.phone_with(), 5, part_s=240.0)
    simulation = examined(report_days.recorded(report_days.phone_with(), 6, part_s=240.0), sought=())
    assert recording.gyroscope is not None
    stamped = {
        arrives: replace(
            recording,
            accelerometer=by_a_fast_clock(recording.accelerometer, arrives=arrives, fast=0.02),
            gyroscope=by_a_fast_clock(recording.gyroscope, arrives=arrives, fast=0.02),
        )
        for arrives in (True, False)
    }
    said = of_scale(stamped[False], simulation)
    assert [(a.effect, a.indistinguishable) for a in said.alternatives] == [("clock_skew", True)]
    assert "the sample rates differ by as much: stamps that run 2" in said.note and "fast" in said.note
    alone = replace(recording.gyroscope, t_arrival=None)
    larger = replace(alone, xyz=frozen(1.02 * alone.xyz))
    larger_x = replace(alone, xyz=frozen([1.02, 1.0, 1.0] * alone.xyz))
    mixed = replace(larger, xyz=frozen(larger.xyz @ [[1.0, 0.0, 0.0], [0.02, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    cases = (
        *((larger, False), (evenly_stamped(larger), True), (evenly_stamped(larger_x), False)),
        (evenly_stamped(mixed), True),
        (by_a_fast_clock(evenly_stamped(larger), arrives=True, fast=0.0), False),
    )
    for gyroscope, may_be in cases:
        said = of_scale(replace(recording, gyroscope=gyroscope), simulation)
        assert bool(said.alternatives) is may_be
        assert ("the stamps of real.csv are even" in said.note) is may_be
        assert ("samples that come 2 % faster than they say" in said.note) is may_be
        # What x reads of y is no clock's, and was said to be alike on all axes.
        axes_apart = may_be and not np.allclose(gyroscope.xyz, larger.xyz)
        assert ("The misalignment is not the clock's." in said.note) is axes_apart
    effects = compare(examined(stamped[True], sought=()), simulation, ("real.csv", "sim.csv")).discrepancies
    assert "gyro_scale" not in {d.effect for d in effects}


def at_rest(rate: float, seed: int) -> Examination:
    """Return a phone on a table for two minutes, whose rate is 200 Hz by its maker."""
    t = np.arange(0.0, 120.0, 1.0 / rate)
    xyz = np.array([0.0, 0.0, 9.81]) + np.random.default_rng(seed).normal(0.0, 0.02, (t.size, 3))
    samples = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz))
    return examine(samples, None, claims=Claims(nominal_rate_hz=200.0))


@pytest.mark.parametrize(("rate", "alone"), [(199.4, False), (199.9, True)])
def test_a_rate_that_is_not_the_nominal_one_is_both_s_where_both_have_it(rate: float, alone: bool) -> None:
    """Where deliveries stall for a while the error is not stated: it was told as the other one's alone."""
    stalled, even = replace(at_rest(rate, 1), statements=[]), at_rest(199.4, 2)
    assert [s.finding.effect for s in even.statements] == ["clock_skew"]
    found = compare(stalled, even, ("a", "b")).discrepancies
    assert ("clock_skew" in {d.effect for d in found}) == alone
