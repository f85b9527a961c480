"""Short recordings whose stamps are coarse: their rate is no whole number of steps, and nothing is lost."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.sample_rate import rate
from stillcal.calib_core.diagnosis.model.measurement import Measured, mean_of
from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.segments.sample_period import (
    more_even_than_chance,
    rounded_to_intervals,
    sample_period,
)
from stillcal.calib_core.diagnosis.stamps.clock import nominal_rate_error, timing_findings
from stillcal.calib_core.diagnosis.stamps.timestamps import Grid, resolution
from stillcal.calib_core.streams.samples import Samples, Sensor


def coarse(hz: float, n: int, step: float, jitter: float = 0.0) -> Samples:
    """Return n samples at hz whose stamps are rounded down to steps, s. jitter: periods."""
    rng = np.random.default_rng(3)
    late = np.sort(np.arange(n) + 0.4 + jitter * rng.standard_normal(n))
    stamps = np.floor(late / hz / step) * step
    return Samples(Sensor.ACCELEROMETER, frozen(np.round(stamps, 6)), frozen(np.zeros((n, 3))))


def rate_error(samples: Samples, hz: float) -> Measured:
    return nominal_rate_error(Grid.of(samples.t, sample_period(samples.t)), hz)[0]


@pytest.mark.parametrize(
    ("hz", "step", "n"),
    [(15.0, 0.01, 400), (49.6, 0.01, 1000), (99.3, 1e-3, 400), (208.0, 1e-3, 800), (20.0, 0.0175, 400)],
)
def test_the_rate_of_few_coarse_stamps_is_as_unsure_as_it_is_wrong(hz: float, step: float, n: int) -> None:
    """Of forty parts most hold equally many steps: the others are no outliers."""
    samples = coarse(hz, n, step)
    made = rate_error(samples, hz)
    assert abs(made.value) < 1e-3
    assert abs(made.value) < 3.0 * made.error < 0.02
    compared = rate(samples)
    assert abs(np.exp(compared.value[0]) / hz - 1.0) < 1e-3
    assert abs(np.exp(compared.value[0]) / hz - 1.0) < 3.0 * np.sqrt(compared.covariance[0, 0])


def test_a_part_whose_losses_are_not_counted_moves_no_rate() -> None:
    """Three intervals of 1.4 periods in one part are time in which no sample was made."""
    t = np.arange(4000.0)
    t[1000:] += 0.4
    t[1010:] += 0.4
    t[1020:] += 0.4
    grid = Grid.of(t / 100.0, 0.01)
    assert abs(nominal_rate_error(grid, 100.0)[0].value) < 1e-6


@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.2])
@pytest.mark.parametrize(("hz", "step", "n"), [(99.3, 0.01, 3000), (104.0, 0.01, 600), (833.0, 1e-3, 400)])
def test_few_gaps_that_come_evenly_lose_nothing(hz: float, step: float, n: int, jitter: float) -> None:
    """At 99.3 Hz in steps of 10 ms every 142nd interval is two steps long: 21 gaps in half a minute."""
    samples = coarse(hz, n, step, jitter)
    found = timing_findings(samples, Claims(nominal_rate_hz=hz), sound_phones())
    assert not {"dropped_samples", "clock_skew"} & {f.effect for f in found}


@pytest.mark.parametrize("gaps", [3, 8, 30])
def test_few_gaps_by_chance_are_not_taken_for_even(gaps: int) -> None:
    rng = np.random.default_rng(gaps)

    def lost() -> Array:
        return np.isin(np.arange(2000), rng.choice(2000, gaps, replace=False)).astype(float)

    assert np.mean([more_even_than_chance(lost()) for _ in range(500)]) < 0.03


def test_a_gap_that_jitter_takes_back_at_once_counts_once() -> None:
    lost = np.zeros(2000)
    edges = np.rint(50 + 150.4 * np.arange(12)).astype(int)
    lost[edges], lost[edges + 2], lost[edges + 5] = 1.0, -1.0, 1.0
    assert more_even_than_chance(lost)
    assert more_even_than_chance(-lost)


@pytest.mark.parametrize("n", [5000, 60_000])
def test_every_400th_sample_that_is_missing_is_lost(n: int) -> None:
    """Also with more than a hundred gaps, which were told as a clock that is 0.25 % slow."""
    t = np.delete(np.arange(n) / 50.0, np.arange(400, n, 400))
    samples = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(np.zeros((t.size, 3))))
    found = timing_findings(samples, Claims(nominal_rate_hz=50.0), sound_phones())
    assert [f.effect for f in found] == ["dropped_samples"]


@pytest.mark.parametrize(("every", "others"), [(400, 5), (400, 60), (20, 300), (7, 20)])
def test_every_so_many_th_sample_is_lost_beside_others_by_chance(every: int, others: int) -> None:
    """Five others made a clock that is 0.26 % slow of every 400th, for distances were not all the same."""
    n = 60_000
    lost = np.isin(
        np.arange(n), np.random.default_rng(every).choice(np.arange(1, n - 1), others, replace=False)
    )
    lost[every::every] = True
    t = np.flatnonzero(~lost) / 50.0
    samples = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(np.zeros((t.size, 3))))
    (found,) = timing_findings(samples, Claims(nominal_rate_hz=50.0), sound_phones())
    assert found.effect == "dropped_samples"
    assert found.parameters["fraction"].value == pytest.approx(lost.mean(), abs=1e-3)


@pytest.mark.parametrize("shifted_after", [0.3, 0.7])
@pytest.mark.parametrize("gaps", [12, 60])
def test_gaps_that_come_to_be_one_sample_off_are_made_by_rounding(gaps: int, shifted_after: float) -> None:
    """Every 300th and a bit, so that most of them are 300 apart and in one place."""
    edges = 300 * np.arange(1, gaps + 1) + (np.arange(gaps) >= shifted_after * gaps)
    t = np.delete(np.arange(300 * (gaps + 1)), edges) * 0.02
    assert rounded_to_intervals(t)


@pytest.mark.parametrize(("hz", "every"), [(99.8004, 500), (98.387097, 61), (100.0, 400)])
def test_gaps_equally_far_apart_tell_nothing_of_stamps_that_are_written_in_such_steps(
    hz: float, every: int
) -> None:
    """A twentieth of short recordings near 100 Hz had lost samples, and a clock that was fast by as much."""
    samples, step = coarse(hz, 6000, 0.01), 0.01
    if hz == 100.0:
        samples = samples[np.flatnonzero(np.arange(6000) % every != every - 1)]
    gaps = np.flatnonzero(np.diff(samples.t) > 1.5 * step)
    assert set(np.diff(gaps)) == {every - (hz == 100.0)}
    assert timing_findings(samples, Claims(nominal_rate_hz=hz), sound_phones()) == []


def test_intervals_of_nothing_are_no_losses_however_even() -> None:
    """At 50 1/8 Hz every 401st interval in steps of 20 ms is none."""
    steps = np.where(np.arange(1, 6000) % 401 == 0, 0.0, 0.02)
    t = frozen(np.cumsum(steps))
    assert rounded_to_intervals(t)
    assert Grid.of(t, sample_period(t)).told


def test_few_gaps_that_gather_are_not_even() -> None:
    lost = np.zeros(2000)
    lost[[100, 103, 108, 110, 900, 902, 909, 1500, 1501, 1506]] = 1.0
    assert not more_even_than_chance(lost)


def test_pieces_as_far_apart_as_they_are_known_to_be_all_count() -> None:
    """Rounded pieces: 30 of 40 are exactly alike."""
    pieces = np.repeat([0.0, 0.04], [30, 10])
    assert mean_of(pieces).value == 0.0
    assert mean_of(pieces, known=0.02).value == pytest.approx(0.01)
    assert mean_of(pieces, known=0.009).value == 0.0


def test_a_hundredth_of_a_second_is_a_step_and_its_rounding_no_jitter() -> None:
    samples = coarse(30.0, 3000, 0.01)
    assert resolution(samples.t) == 0.01
    found = timing_findings(samples, Claims(nominal_rate_hz=30.0), sound_phones())
    assert "timestamp_jitter" not in {f.effect for f in found}


def scattered(lost: float, *, by_intervals: bool, pause: float = 0.0) -> Grid:
    """Return the grid of 120000 stamps at 1 Hz, with a pause, s, that scatter by half a second.

    by_intervals: each interval by a tenth instead. lost: share of the samples.
    """
    rng = np.random.default_rng(6)
    noise = rng.standard_normal(120_000)
    t = np.sort(np.arange(noise.size) + (np.cumsum(0.1 * noise) if by_intervals else 0.5 * noise))
    t[9_000:] += pause
    t = t[rng.random(t.size) >= lost]
    return Grid.of(t, sample_period(t))


@pytest.mark.parametrize("pause", [0.0, 3000.0])
def test_where_equal_numbers_take_equal_times_nothing_is_lost_though_no_grid_is_seen(pause: float) -> None:
    grid = scattered(0.0, by_intervals=False, pause=pause)
    assert grid.told and grid.missing().value == 0.0
    assert not scattered(0.2, by_intervals=False).told


@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_intervals_that_each_scatter_tell_what_is_lost_where_they_gather_at_one_and_two(lost: float) -> None:
    grid = scattered(lost, by_intervals=True)
    assert grid.told
    assert grid.missing().value == pytest.approx(lost, abs=4e-3)
