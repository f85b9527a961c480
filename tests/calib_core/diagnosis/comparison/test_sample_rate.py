"""Rates of two recordings, of which both tell how many samples are missing, or one does not."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.sample_rate import PIECES, of_both
from stillcal.calib_core.diagnosis.direct.quantities import grid_of
from stillcal.calib_core.diagnosis.segments.sample_period import bunched
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE, COUNT = 50.0, 6000


def with_lost(scatter: float, seed: int) -> Samples:
    """Return samples of which a quarter is lost. scatter: of every interval, periods."""
    rng = np.random.default_rng(seed)
    every = np.cumsum(np.clip(rng.normal(1.0, scatter, COUNT), 0.1, None)) / RATE
    t = every[rng.uniform(size=COUNT) > 0.25]
    return Samples(Sensor.ACCELEROMETER, t, rng.normal([0.0, 0.0, 9.8], 0.01, (t.size, 3)))


def test_missing_samples_count_in_both_or_in_neither() -> None:
    """The delivered rates are the same; the one with what is missing was a third higher than the other."""
    sharp, blurred = with_lost(0.01, 1), with_lost(0.35, 2)
    told = [grid is not None and grid.told for grid in map(grid_of, (sharp, blurred))]
    assert told == [True, False]
    one, other = (float(np.exp(q.value[0])) for q in of_both([sharp, blurred]))
    assert one == pytest.approx(0.75 * RATE, rel=0.02) and other == pytest.approx(one, rel=0.02)
    both = [float(np.exp(q.value[0])) for q in of_both([sharp, with_lost(0.01, 3)])]
    assert both == pytest.approx([RATE, RATE], rel=1e-3)


def test_missing_samples_count_in_neither_beside_stamps_in_bursts() -> None:
    """Of both, 3 % are missing: the one without bursts was 3 % faster than the other."""
    rng = np.random.default_rng(0)
    found = []
    for together in (6, 1):
        number = np.arange(COUNT)
        last = number // together * together + together - 1
        ready = (last + 0.2 * rng.uniform(size=COUNT)[last % COUNT]) / RATE
        t = (ready - 3e-4 * (last - number))[rng.uniform(size=COUNT) > 0.03]
        found.append(Samples(Sensor.ACCELEROMETER, t, rng.normal([0.0, 0.0, 9.8], 0.01, (t.size, 3))))
    assert [bunched(one.t) for one in found] == [True, False]
    assert [float(np.exp(q.value[0])) for q in of_both(found)] == pytest.approx([0.97 * RATE] * 2, rel=5e-3)


def test_a_rate_that_goes_up_and_down_is_less_sure() -> None:
    """Another recording may have more of the fast minutes."""
    rng = np.random.default_rng(0)
    fast = np.repeat([0.0, 1.0, 0.0, 1.0, 1.0], COUNT // 5)
    t = np.cumsum(1.0 + 1e-4 * fast) / RATE + rng.normal(0.0, 1e-4, COUNT)
    samples = Samples(Sensor.ACCELEROMETER, t, rng.normal([0.0, 0.0, 9.8], 0.01, (COUNT, 3)))
    grid = grid_of(samples)
    assert grid is not None
    (found, _), by_itself = of_both([samples, samples]), grid.mean_rate(PIECES, 0.0)[0]
    assert np.sqrt(found.covariance[0, 0]) > 2.0 * by_itself.error
