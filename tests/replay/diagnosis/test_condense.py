"""A long recording is diagnosed from every second's statistics and a bounded number of its samples."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.condense import Condenser, LongRecording
from stillcal.replay.diagnosis.condense import condensed as as_needed
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording

RATE = 20.0
BLOCK_S = 200
KEPT, HELD = 40_000, 80_000
LENGTH = 8000
ABOUT = Recording(
    Samples.empty(Sensor.ACCELEROMETER), Samples.empty(Sensor.GYROSCOPE), [], Claims(), [], "long"
)


def _blocks(seconds: int) -> Iterator[tuple[Samples, Samples]]:
    """Yield rests of 170 s in four attitudes, with 30 s of turning between, warming by 1 K an hour."""
    rng = np.random.default_rng(0)
    for block in range(seconds // BLOCK_S):
        t = block * BLOCK_S + np.arange(0.0, BLOCK_S, 1.0 / RATE)
        turning = t - t[0] >= BLOCK_S - 30.0
        angle = block * np.pi / 2.0 + np.where(turning, (t - t[0] - BLOCK_S + 30.0) / 30.0, 0.0) * np.pi / 2.0
        force = 9.80665 * np.stack([np.sin(angle), np.zeros_like(t), np.cos(angle)], axis=1)
        rate = np.zeros_like(force)
        rate[turning, 1] = np.pi / 2.0 / 30.0 + np.sin(t[turning])
        yield (
            _samples(Sensor.ACCELEROMETER, t, force + rng.normal(size=force.shape) * 0.01),
            _samples(Sensor.GYROSCOPE, t, rate + rng.normal(size=rate.shape) * 0.001),
        )


def _samples(sensor: Sensor, t: Array, xyz: Array) -> Samples:
    return Samples.checked(sensor, t, xyz, 25.0 + t / 3600.0)


def _condensed(seconds: int, whole: int) -> Recording:
    condenser = Condenser(whole, KEPT)
    for accelerometer, gyroscope in _blocks(seconds):
        condenser.add(accelerometer, gyroscope)
    return condenser.recording(ABOUT)


@pytest.fixture(scope="module")
def whole() -> Recording:
    return _condensed(LENGTH, 10**9)


@pytest.fixture(scope="module")
def condensed() -> LongRecording:
    found = _condensed(LENGTH, HELD)
    assert isinstance(found, LongRecording)
    return found


def _overview(recording: LongRecording) -> Overview:
    assert recording.overview is not None
    return recording.overview


def test_a_short_recording_stays_whole(whole: Recording) -> None:
    assert not isinstance(whole, LongRecording)
    assert len(whole.accelerometer) == LENGTH * RATE


def test_its_rests_are_those_of_the_whole(whole: Recording, condensed: LongRecording) -> None:
    assert len(condensed.accelerometer) < 1.5 * KEPT
    every = cut(whole.accelerometer, whole.gyroscope)
    some = cut(condensed.accelerometer, condensed.gyroscope, overview=_overview(condensed))
    assert len(some) == len(every) > 50
    assert some.rate is not None and every.rate is not None
    assert some.temperature is not None and every.temperature is not None
    np.testing.assert_allclose(some.t, every.t)
    np.testing.assert_allclose(some.force, every.force, atol=1e-9)
    np.testing.assert_allclose(some.rate, every.rate, atol=1e-9)
    np.testing.assert_allclose(some.temperature, every.temperature, atol=1e-6)


def test_both_sensors_keep_the_same_whole_seconds(condensed: LongRecording) -> None:
    assert condensed.gyroscope is not None and condensed.kept is not None
    np.testing.assert_array_equal(condensed.accelerometer.t, condensed.gyroscope.t)
    steps = np.diff(condensed.accelerometer.t)
    # What is left out is a pause and no lost samples: those are looked for in gaps of up to 50 periods.
    assert steps[steps > 1.5 / RATE].min() > 50.0 / RATE
    assert condensed.kept.sum() * RATE == pytest.approx(len(condensed.accelerometer), abs=2 * RATE)


def test_turns_and_the_largest_value_are_kept() -> None:
    condenser = Condenser(HELD, KEPT)
    for i, (accelerometer, gyroscope) in enumerate(_blocks(LENGTH)):
        struck = accelerometer.xyz.copy()
        struck[1000, 1] += 30.0 * (i == 7)
        condenser.add(_samples(Sensor.ACCELEROMETER, accelerometer.t, struck), gyroscope)
    found = condenser.recording(ABOUT)
    assert found.accelerometer.xyz[:, 1].max() > 29.0
    assert isinstance(found, LongRecording) and found.kept is not None
    turns = np.append(found.kept, False).reshape(-1, BLOCK_S)[:, -30:]
    assert turns.all(axis=1).sum() >= 8


def test_memory_does_not_grow_with_length() -> None:
    peaks = []
    lengths = 6000, 18000
    for seconds in lengths:
        tracemalloc.start()
        _condensed(seconds, HELD)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    samples = 2 * 5 * 8 * RATE * (lengths[1] - lengths[0])
    # Statistics of seconds grow. At 20 Hz they are no small part of the samples; at 100 Hz they are.
    assert peaks[1] - peaks[0] < 0.6 * samples


def test_a_gap_of_years_is_refused_before_it_takes_memory() -> None:
    """One log joined to another of nine years later: every second between would be held."""
    condenser = Condenser(name="log.csv")
    blocks = list(_blocks(2 * BLOCK_S))
    condenser.add(*blocks[0])
    later = [Samples.checked(s.sensor, s.t + 9 * 365.25 * 86400.0, s.xyz) for s in blocks[1]]
    with pytest.raises(UserError, match=r"log\.csv: .* span 3287 days, .* --from and --to"):
        condenser.add(*later)
    both = (np.concatenate([a.t, b.t]) for a, b in zip(blocks[0], later, strict=True))
    xyz = (np.concatenate([a.xyz, b.xyz]) for a, b in zip(blocks[0], later, strict=True))
    accelerometer, gyroscope = (Samples.checked(s, *x) for s, *x in zip(Sensor, both, xyz, strict=True))
    with pytest.raises(UserError, match="span 3287 days"):
        as_needed(replace(ABOUT, accelerometer=accelerometer, gyroscope=gyroscope))
