"""Samples that are lost, or wait, for a minute of a recording: the processor was busy then."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import UNTOLD, direct_checks
from stillcal.calib_core.diagnosis.comparison.sample_rate import rate
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.model.records import Claims, Finding
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.segments.sample_period import rounded_to_intervals, sample_period
from stillcal.calib_core.diagnosis.stamps.clock import timing_findings
from stillcal.calib_core.diagnosis.stamps.timestamps import Grid
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE, N = 50.0, 60_000


def found(kept: Array, arrival: Array | None = None) -> dict[str, Finding]:
    """Return what stamps at 50 Hz show of which only some are kept, by name; the rate is declared."""
    rng = np.random.default_rng(5)
    t = np.arange(N) / RATE
    stamps = t + 2e-5 * rng.standard_normal(N)
    arrived = None if arrival is None else frozen(arrival[kept])
    samples = Samples(
        Sensor.ACCELEROMETER, frozen(stamps[kept]), frozen(np.zeros((int(kept.sum()), 3))), None, arrived
    )
    claims = Claims(nominal_rate_hz=RATE)
    return {f.effect: f for f in timing_findings(samples, claims, sound_phones())}


def test_losses_of_a_while_are_found_where_they_are() -> None:
    """Half of the samples of one minute in twenty are missing: 2.5 % of all, from 600 to 660 s."""
    rng = np.random.default_rng(1)
    t = np.arange(N) / RATE
    kept = ~((t > 600.0) & (t < 660.0) & (rng.random(N) < 0.5))
    lost = found(kept)["dropped_samples"]
    assert 599.0 < lost.where.t_start < 603.0
    assert 657.0 < lost.where.t_end < 661.0
    assert "nearly all from 60" in lost.statement
    assert abs(float(np.asarray(lost.parameters["fraction"].value)) - (~kept).mean()) < 1e-3


def test_losses_all_along_name_no_time() -> None:
    """Two in a hundred are missing everywhere."""
    kept = np.random.default_rng(2).random(N) > 0.02
    lost = found(kept)["dropped_samples"]
    assert lost.where.t_end - lost.where.t_start > 1190.0
    assert "nearly all" not in lost.statement


def test_what_happens_once_is_not_stated() -> None:
    """Within two seconds every other sample is missing: 0.08 % of all, which nothing else bears out."""
    t = np.arange(N) / RATE
    kept = ~((t > 600.2) & (t < 602.2) & (np.arange(N) % 2 == 0))
    assert "dropped_samples" not in found(kept)


def test_deliveries_in_bursts_for_a_while_are_found_where_they_are() -> None:
    """For one minute samples wait for one another, ten at a time."""
    t = np.arange(N) / RATE
    waits = (t > 300.0) & (t < 360.0)
    late = np.where(waits, (9 - np.arange(N) % 10) / RATE, 0.0)
    arrival = t + 0.003 + late + 1e-4 * np.random.default_rng(3).random(N)
    bursts = found(np.ones(N, dtype=np.bool_), np.maximum.accumulate(arrival))["arrival_bursts"]
    assert 299.0 < bursts.where.t_start < 302.0
    assert 358.0 < bursts.where.t_end < 361.0


def test_batches_whose_stamps_were_spread_by_arrival_have_lost_nothing() -> None:
    """A batch that comes late is stretched, the next one squeezed; each has its ten samples."""
    rng = np.random.default_rng(7)
    steps = np.full((600, 10), 0.01)
    late = 2 * np.flatnonzero(rng.random(300) < 0.1)
    steps[late], steps[late + 1] = 0.0157, 0.0043
    t = np.concatenate([[0.0], np.cumsum(steps)])
    assert Grid.of(t, 0.01).missing().value < 1e-3
    kept = np.delete(t, np.sort(rng.choice(np.arange(1, t.size - 1), 60, replace=False)))
    assert Grid.of(kept, 0.01).missing().value == pytest.approx(60 / t.size, rel=0.1)


@pytest.mark.parametrize("scatter", [0.1, 0.15, 0.25])
@pytest.mark.parametrize("share", [0.01, 0.1, 0.2, 0.4])
def test_losses_are_counted_beside_jitter(scatter: float, share: float) -> None:
    """Each stamp is off by itself, by a part of the period, and single samples are missing at random."""
    rng = np.random.default_rng(11)
    t = np.arange(N // 2) / RATE
    kept = rng.random(t.size) >= share
    stamps = np.sort(t + scatter / RATE * rng.standard_normal(t.size))[kept]
    grid = Grid.of(stamps, sample_period(stamps))
    assert grid.missing().value == pytest.approx((~kept).mean(), abs=5e-4)
    jitter = grid.jitter()
    assert jitter is not None and jitter.value * RATE == pytest.approx(scatter, rel=0.05)


@pytest.mark.parametrize("scatter", [0.1, 0.25, 0.5])
def test_jitter_alone_loses_nothing(scatter: float) -> None:
    """The clock also wanders by a period every five minutes, which is no loss."""
    rng = np.random.default_rng(12)
    t = np.arange(N) / RATE
    wander = np.sin(2.0 * np.pi * t / 300.0) / RATE
    stamps = np.sort(t + wander + scatter / RATE * rng.standard_normal(t.size))
    assert Grid.of(stamps, sample_period(stamps)).missing().value < 2e-4


def test_intervals_that_scatter_by_themselves_have_no_grid() -> None:
    """A loop that sleeps between samples: intervals scatter by a quarter, and nothing is missing."""
    rng = np.random.default_rng(13)
    stamps = np.cumsum(1.0 + 0.25 * rng.standard_normal(N // 2).clip(-3.0, 3.0)) / RATE
    assert Grid.of(stamps, sample_period(stamps)).missing().value == 0.0


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_stamps_as_coarse_as_their_interval_hide_no_sample(share: float) -> None:
    """Two stamps of 20 ms are the same where one was late, and the next interval is 40 ms."""
    rng = np.random.default_rng(14)
    kept = rng.random(N) >= share
    late = np.sort(np.arange(N) + 0.3 * rng.standard_normal(N))[kept]
    stamps = np.floor(late) / RATE
    grid = Grid.of(stamps, sample_period(stamps))
    assert grid.missing().value == pytest.approx((~kept).mean(), abs=2e-3)


@pytest.mark.parametrize("scatter", [0.0, 0.1])
@pytest.mark.parametrize(("hz", "step"), [(833.0, 1e-3), (952.0, 1e-3), (1600.0, 1e-3), (97.0, 1e-2)])
def test_stamps_rounded_to_their_interval_are_of_a_rate_between_steps(
    hz: float, step: float, scatter: float
) -> None:
    """At 833 Hz in ms every fifth interval is 2 ms, as evenly as a clock has it: nothing is missing."""
    rng = np.random.default_rng(15)
    stamps = np.floor(np.sort(np.arange(N) + scatter * rng.standard_normal(N)) / hz / step) * step
    samples = Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(np.zeros((N, 3))))
    assert timing_findings(samples, Claims(nominal_rate_hz=hz), sound_phones()) == []
    assert sample_period(stamps) == pytest.approx(1.0 / hz, rel=1e-4)


def test_losses_by_chance_are_no_rounding_of_stamps() -> None:
    """Exact stamps of 50 Hz: their intervals are whole numbers of the usual one, too."""
    kept = np.random.default_rng(16).random(N) >= 0.1
    stamps = (np.arange(N) / RATE)[kept]
    assert sample_period(stamps) == pytest.approx(1.0 / RATE)
    assert Grid.of(stamps, sample_period(stamps)).missing().value == pytest.approx((~kept).mean(), abs=5e-4)


def test_rounding_is_told_from_losses_by_even_long_intervals_of_exact_stamps() -> None:
    """It takes a few long intervals that come evenly, all of them whole numbers of the usual one."""
    rng = np.random.default_rng(19)
    every_tenth = 1.0 + np.isin(np.arange(2_000), np.rint(10.4 * np.arange(200)))
    by_chance = 1.0 + (rng.random(2_000) < 0.4)
    scattering = every_tenth + 0.02 * rng.standard_normal(2_000)
    assert rounded_to_intervals(np.cumsum(every_tenth) / RATE)
    for intervals in (every_tenth[:30], by_chance, scattering):
        assert not rounded_to_intervals(np.cumsum(intervals) / RATE)


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_losses_beside_jitter_make_no_clock_slow(share: float) -> None:
    """The rate is the one of the grid on which samples are missing, and the phone file has the same."""
    rng = np.random.default_rng(17)
    kept = rng.random(N) >= share
    stamps = np.sort(np.arange(N) + 0.25 * rng.standard_normal(N))[kept] / RATE
    samples = Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(np.zeros((stamps.size, 3))))
    found = timing_findings(samples, Claims(nominal_rate_hz=RATE), sound_phones())
    assert {f.effect for f in found} == {"timestamp_jitter", "dropped_samples"}
    assert np.exp(rate(samples).value[0]) == pytest.approx(RATE, rel=1e-3)


@pytest.mark.parametrize("share", [0.05, 0.2])
@pytest.mark.parametrize("off", [-0.01, 0.0083])
def test_losses_are_counted_beside_stamps_of_half_the_interval(off: float, share: float) -> None:
    """Stamps in steps of 10 ms at 50.4 Hz: phases agree as well at 49.6 Hz, where too few are missing."""
    rng = np.random.default_rng(18)
    kept = rng.random(N // 2) >= share
    late = np.sort(np.arange(N // 2) + 0.15 * rng.standard_normal(N // 2))[kept]
    stamps = np.floor(late / (1.0 + off) * 2.0) / 2.0 / RATE
    grid = Grid.of(stamps, sample_period(stamps))
    assert grid.missing().value == pytest.approx((~kept).mean(), abs=1e-3)


@pytest.mark.parametrize("share", [0.01, 0.05, 0.2])
def test_losses_are_counted_beside_stamps_as_coarse_as_their_interval(share: float) -> None:
    """At 833 Hz in ms a fifth of the intervals is 2 ms by rounding, and more are by losses."""
    rng = np.random.default_rng(20)
    kept = rng.random(20_000) >= share
    stamps = np.floor(np.flatnonzero(kept) / 0.833) * 1e-3
    grid = Grid.of(stamps, sample_period(stamps))
    assert grid.told
    assert grid.missing().value == pytest.approx((~kept).mean(), abs=2e-3)


def test_losses_that_jitter_hides_make_no_clock_slow() -> None:
    """Stamps scatter by 0.35 periods and a fifth is missing: if that is not told, neither is a slow clock."""
    rng = np.random.default_rng(21)
    kept = rng.random(20_000) >= 0.2
    stamps = np.sort(np.arange(20_000) + 0.35 * rng.standard_normal(20_000))[kept] / 100.0
    force = np.array([0.0, 0.0, 9.81]) + 0.01 * rng.standard_normal((stamps.size, 3))
    samples = Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(force))
    found = timing_findings(samples, Claims(nominal_rate_hz=100.0), sound_phones())
    assert "clock_skew" not in {f.effect for f in found}
    exam = examine(samples, None, claims=Claims(nominal_rate_hz=100.0), sought=())
    reasons = {check.effect: check.reason for check in direct_checks(exam)}
    assert reasons["clock_skew"] == reasons["dropped_samples"] == UNTOLD


def test_a_mirrored_period_loses_nothing() -> None:
    """49.6 Hz in steps of 10 ms agrees as well with 50.4 Hz, where one in 62 would be missing."""
    rng = np.random.default_rng(22)
    late = np.sort(np.arange(20_000) + 0.3 * rng.standard_normal(20_000))
    stamps = np.floor(late / 49.6 * 100.0) / 100.0
    samples = Samples(Sensor.ACCELEROMETER, frozen(stamps), frozen(np.zeros((stamps.size, 3))))
    found = timing_findings(samples, Claims(nominal_rate_hz=49.6), sound_phones())
    assert {f.effect for f in found} <= {"timestamp_jitter"}
