"""Sample periods of even stamps, stamps with gaps, jittered ones, and stamps in bursts."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.sample_rate import rate as rate_of
from stillcal.calib_core.diagnosis.direct.quantities import of_stamps
from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.segments.bursts import measured_evenly
from stillcal.calib_core.diagnosis.segments.sample_period import bunched, sample_period
from stillcal.calib_core.diagnosis.stamps.clock import timing_findings
from stillcal.calib_core.streams.samples import Samples, Sensor

N = 20000


def in_bursts(seed: int = 1) -> np.ndarray:
    """100 samples a second that a host fetches some at a time and stamps 2 ms apart as it reads them."""
    rng = np.random.default_rng(seed)
    fetched = np.cumsum(rng.integers(1, 9, N // 3))
    fetched = fetched[fetched < N]
    last = fetched[np.searchsorted(fetched, np.arange(fetched[-1]), side="right")]
    stamps = last / 100.0 + 0.002 * (np.arange(last.size) - (last - 1))
    return np.asarray(np.maximum.accumulate(stamps - stamps[0] + rng.uniform(0, 2e-4, stamps.size)))


def test_stamps_in_bursts_have_the_rate_of_samples_over_time() -> None:
    t = in_bursts()
    assert np.median(np.diff(t)) < 0.003, "the usual interval is the host's"
    assert bunched(t) and sample_period(t) == pytest.approx(0.01, rel=0.01)


def test_samples_of_bursts_count_as_measured_at_equal_intervals() -> None:
    """Packets of six at 50 Hz come late by chance, and two packets are lost."""
    rng = np.random.default_rng(8)
    packet = np.repeat(np.arange(80), 6)
    t = (6 * packet + 5) / 50.0 + rng.exponential(0.012, 80)[packet] + 1e-4 * (np.arange(480) % 6)
    kept = ~np.isin(packet, (20, 55))
    assert bunched(t[kept])
    for rows in (kept, np.ones(480, dtype=bool)):
        even, unsure = measured_evenly(t[rows])
        stretched = np.polyfit(np.arange(480)[rows] / 50.0, even, 1)[0] - 1.0
        assert np.ptp(even - np.arange(480)[rows] / 50.0) < 0.01, "as delivered, it is 0.1 s"
        assert abs(stretched) < 3.0 * unsure < 2e-3


def test_samples_of_bursts_of_any_size_count_as_measured_at_equal_intervals() -> None:
    t = in_bursts()[:1000]
    assert np.ptp(measured_evenly(t)[0] - np.arange(1000) / 100.0) < 0.005


def test_few_bursts_do_not_tell_how_long_a_turn_lasts() -> None:
    few = in_bursts()[:20]
    even, unsure = measured_evenly(few)
    assert (even == few).all() and unsure == 1.0


@pytest.mark.parametrize(("rounded", "heel"), [(1e-3, 0.001), (1e-3, 0.002), (1e-4, 2e-4)])
def test_rounded_stamps_in_bursts_are_no_samples_that_are_missing(rounded: float, heel: float) -> None:
    """Five at a time, 1 ms apart, and 95 ms of waiting are no 1000 Hz of which 94 in 100 samples are lost."""
    rng = np.random.default_rng(3)
    for size in (np.full(N // 5, 5), rng.integers(2, 8, N // 5), np.full(N // 2, 2)):
        last = np.repeat(np.cumsum(size), size)
        t = last / 50.0 - heel * (last - 1 - np.arange(last.size))
        t = rounded * np.rint(t / rounded)
        assert all(map(bunched, (t, t[1:], t[2:-1]))), "of pairs the median interval is either of two"
        assert sample_period(t) == pytest.approx(0.02, rel=1e-3)
        rate = np.exp(rate_of(Samples.checked(Sensor.ACCELEROMETER, t, np.zeros((t.size, 3)))).value)
        assert rate == pytest.approx(50.0, rel=1e-2)


def test_an_outage_now_and_then_makes_no_bursts() -> None:
    """Two thirds of the samples are lost, some hundred at a time, or some ten."""
    rng = np.random.default_rng(4)
    for on, off in ((100, 200), (20, 40), (4, 12)):
        runs = np.column_stack([rng.geometric(1 / on, 400), rng.geometric(1 / off, 400)]).ravel()
        t = np.flatnonzero(np.repeat(np.arange(runs.size) % 2 == 0, runs)) / 50.0
        assert not bunched(t) and sample_period(t) == pytest.approx(0.02, rel=1e-3)


def test_missing_samples_and_jitter_are_no_bursts() -> None:
    rng = np.random.default_rng(2)
    even = np.arange(N) / 50.0
    for t in (even, even[rng.random(N) > 0.4], np.sort(even + rng.normal(0.0, 0.004, N))):
        assert not bunched(t) and sample_period(t) == pytest.approx(0.02, rel=0.02)


def test_bursts_are_named_and_no_fraction_is_beyond_one() -> None:
    t = in_bursts()
    samples = Samples.checked(Sensor.ACCELEROMETER, t, np.zeros((t.size, 3)))
    assert of_stamps(samples) == {}, "neither jitter nor missing samples"
    found = timing_findings(samples, Claims(), sound_phones())
    assert [f.effect for f in found] == ["arrival_bursts"]
    assert 0.0 < float(found[0].parameters["fraction"].value) < 1.0  # type: ignore[arg-type]
    assert "100 Hz" in found[0].statement
