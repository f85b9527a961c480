"""What a recording tells another: what comes and goes is there by chance."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.direct.quantities import grid_of, of_stamps, of_values
from stillcal.calib_core.diagnosis.direct.repeated_values import LEAST_SHARE as LEAST_HELD
from stillcal.calib_core.diagnosis.direct.repeated_values import Repeats
from stillcal.calib_core.diagnosis.stamps.clock import LEAST_SHARE as LEAST_BURSTS
from stillcal.calib_core.diagnosis.stamps.clock import burst_share, waited
from stillcal.calib_core.diagnosis.stamps.timestamps import LEAST_SHARE as LEAST_LOST
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE, COUNT = 50.0, 20_000

NOW_AND_THEN = np.arange(COUNT) // (COUNT // 5) == 1
"""The fifth of the time in which something happens."""


def samples(rng: np.random.Generator) -> Samples:
    """Return samples on an even grid, with noise."""
    t = np.arange(COUNT) / RATE + rng.normal(0.0, 1e-5, COUNT)
    return Samples.checked(Sensor.ACCELEROMETER, t, rng.normal([0.0, 0.0, 9.8], 0.01, (COUNT, 3)))


def test_samples_lost_for_a_while_tell_another_recording_less() -> None:
    rng = np.random.default_rng(0)
    one = samples(rng).where(~(NOW_AND_THEN & (rng.uniform(size=COUNT) < 0.2)))
    grid, found = grid_of(one), of_stamps(one)["dropped_samples"]
    assert grid is not None
    by_itself = grid.share(grid.dropped()).log(LEAST_LOST)
    assert found.value == by_itself.value and found.error > 5.0 * by_itself.error


def test_samples_held_for_a_while_tell_another_recording_less() -> None:
    rng = np.random.default_rng(0)
    every = samples(rng)
    again = NOW_AND_THEN & (rng.uniform(size=COUNT) < 0.2)
    rows = np.maximum.accumulate(np.where(again, 0, np.arange(COUNT)))
    one = Samples.checked(every.sensor, every.t, every.xyz[rows])
    seen = Repeats.of(one)
    assert seen is not None
    by_itself, found = seen.share().log(LEAST_HELD), of_values(one)["held_samples"]
    assert found.value == by_itself.value and found.error > 5.0 * by_itself.error


def test_bursts_of_a_while_tell_another_recording_less() -> None:
    rng = np.random.default_rng(0)
    every = samples(rng)
    waits = NOW_AND_THEN & (np.arange(COUNT) % 40 < 10)
    last = np.where(waits, np.arange(COUNT) // 40 * 40 + 10, np.arange(COUNT))
    arrived = every.t[last] + 0.01 + 1e-4 * np.where(waits, np.arange(COUNT) % 40 - 10, 0)
    one = Samples.checked(every.sensor, every.t, every.xyz, t_arrival=arrived)
    by_itself = burst_share(waited(one.t, arrived, 1.0 / RATE)).log(LEAST_BURSTS)
    found = of_stamps(one)["arrival_bursts"]
    assert found.value == by_itself.value and found.error > 2.0 * by_itself.error
