"""Stamps that are wrong together are found; stamps or intervals that are each off by themselves are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.model.records import Claims, Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.stamps.clock import timing_findings
from stillcal.calib_core.diagnosis.stamps.timestamps import Grid, jitter
from stillcal.calib_core.streams.samples import Samples

RATE, COUNT = 50.0, 30_000
Array = np.ndarray
EVEN = np.arange(COUNT) / RATE


def spread_evenly(rng: np.random.Generator, late_s: float, batch: int = 20) -> Array:
    """Return stamps of batches that come late by up to `late_s`, each spread to the one before it."""
    ends = np.arange(0, COUNT, batch)
    return np.asarray(np.interp(np.arange(COUNT), ends, EVEN[ends] + rng.uniform(0.0, late_s, ends.size)))


def lost(rng: np.random.Generator) -> Array:
    return np.sort(rng.choice(EVEN, int(0.98 * COUNT), replace=False)) + rng.normal(
        0.0, 2e-4, int(0.98 * COUNT)
    )


SOUND: dict[str, Callable[[np.random.Generator], Array]] = {
    "even": lambda _rng: EVEN,
    "each stamp off": lambda rng: EVEN + rng.normal(0.0, 0.01 / RATE, COUNT),
    "each interval off": lambda rng: np.cumsum(1.0 / RATE + rng.normal(0.0, 0.01 / RATE, COUNT)),
    "a slow clock": lambda _rng: EVEN + 2e-3 * np.sin(2.0 * np.pi * EVEN / 300.0),
    "samples lost": lost,
    "spread evenly, by little": lambda rng: spread_evenly(rng, 2e-4),
}


def drivers(t: Array) -> list[str]:
    samples = Samples("accel", t, np.zeros((t.size, 3)))
    found = timing_findings(samples, Claims(), sound_phones())
    return [f.where.driver for f in found if f.effect == "unknown"]


@pytest.mark.parametrize("kind", SOUND)
def test_stamps_that_are_each_off_by_themselves_are_silent(kind: str) -> None:
    assert not drivers(SOUND[kind](np.random.default_rng(4)))


@pytest.mark.parametrize("late_s", [0.06, 0.1])
def test_batches_that_are_spread_evenly_are_found_and_sized(late_s: float) -> None:
    t = spread_evenly(np.random.default_rng(5), late_s)
    (found,) = timing_findings(Samples("accel", t, np.zeros((t.size, 3))), Claims(), sound_phones())
    assert (found.effect, found.sensor, found.where.driver) == ("unknown", "timing", "neighbouring intervals")
    off = t - np.polyval(np.polyfit(np.arange(COUNT), t, 1), np.arange(COUNT))
    assert found.parameters["sigma"].value == pytest.approx(off.std(), rel=0.3)


def test_it_stands_in_place_of_jitter() -> None:
    """Stamps of a batch that are off by the same have no scatter of their own to be named."""
    samples = Samples("accel", spread_evenly(np.random.default_rng(5), 0.25), np.zeros((COUNT, 3)))
    grid = Grid.of(samples.t, 1.0 / RATE)
    assert (
        jitter(grid, sound_phones()["timestamp_jitter_declared"], Where(0.0, 600.0, (0.0, 25.0), ""))
        is not None
    )
    (found,) = timing_findings(samples, Claims(nominal_rate_hz=RATE), sound_phones())
    assert found.effect == "unknown"


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.7, 1.0])
def test_jitter_is_of_one_size_however_much_of_it_adds_up(share: float) -> None:
    """Stamps off by themselves and intervals that are: it was 1.7 times larger where the second prevailed."""
    rng = np.random.default_rng(0)
    sigma, alone = 0.02 / RATE, np.sqrt([1.0 - share, share])
    of_stamps, of_intervals = (a * rng.normal(0.0, sigma, COUNT) for a in alone)
    found = Grid.of(EVEN + of_stamps + np.cumsum(of_intervals), 1.0 / RATE).jitter()
    assert found is not None and found.value == pytest.approx(sigma, rel=0.13)
    assert found.error < 0.05 * sigma
