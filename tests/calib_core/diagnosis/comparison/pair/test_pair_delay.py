"""The delay of one sensor against another of the same motion, and what it is not taken for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.pair.delay import (
    LEAST_PIECES,
    PIECES,
    Late,
    _moving,
    aligned,
    delay_between,
    found_delays,
    late,
)
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.support.diagnosis.turned_pairs import RATE, turned

T = np.arange(0.0, 240.0, 0.02)


def shaken(
    delay: float = 0.0, seed: int = 1, gain: Array | None = None, sensor: Sensor = Sensor.GYROSCOPE
) -> Samples:
    """Return four minutes of a walk's rhythm, read late by a delay, s, with noise of 0.01."""
    t = T - delay
    true = np.stack([np.sin(11.0 * t) + 0.5 * np.sin(3.1 * t + a) for a in range(3)], axis=1)
    read = true @ (np.eye(3) if gain is None else gain).T
    return Samples(
        sensor, frozen(T), frozen(read + 0.01 * np.random.default_rng(seed).normal(size=read.shape))
    )


def found_between(force: Late, rate: Late, samples: Samples) -> list[Finding]:
    """Return the delays that are found between two sensors."""
    return found_delays(delay_between(force, rate), force, rate, samples)


@pytest.mark.parametrize("delay", [0.007, -0.024])
def test_a_delay_is_measured_beside_a_wrong_scale_and_taken_out(delay: float) -> None:
    own, true = shaken(delay, 2, np.eye(3) + 0.02), shaken()
    found = late(own, true, "gyro")
    assert found is not None
    assert found.delay.value == pytest.approx(delay, abs=3.0 * found.delay.error)
    assert 1e-5 < found.delay.error < 3e-4
    left = late(own, aligned(true, found), "gyro")
    assert left is not None and abs(left.delay.value) < 1e-4


@pytest.mark.parametrize("delay", [0.0, 0.015, -0.022])
def test_a_motor_that_turns_twice_in_a_delay_hides_none_of_it(delay: float) -> None:
    """Of 15 ms, two turns and a quarter of 150 Hz, the first that fits was told: 1.6 ms."""
    at, rng = np.arange(0.0, 120.0, 0.002), np.random.default_rng(3)
    hum = np.cumsum(rng.normal(0.0, 0.2, at.size))  # rad, by which a motor is ahead of 150 Hz

    def read(late_by: float) -> Samples:
        t = at - late_by
        flown = np.stack([np.sin(2.9 * t + a) + 0.4 * np.sin(7.3 * t - a) for a in range(3)], axis=1)
        motor = np.sin(2.0 * np.pi * 150.0 * t + np.interp(t, at, hum))
        noise = rng.normal(0.0, 5e-4, flown.shape)
        return Samples(
            Sensor.GYROSCOPE, frozen(at), frozen(0.2 * flown + np.outer(motor, [0.05, -0.04, 0.02]) + noise)
        )

    found = late(read(delay), read(0.0), "gyro")
    assert found is not None and found.delay.value == pytest.approx(delay, abs=5e-4)


def test_without_a_delay_nothing_is_said_and_nothing_moved() -> None:
    true = shaken()
    found = late(shaken(0.0, 2), true, "gyro")
    assert found is not None and aligned(true, found) is true
    assert found_between(found, found, true) == []


def test_readings_that_are_exactly_alike_have_no_delay() -> None:
    true = shaken()
    with np.errstate(divide="raise", invalid="raise"):
        found = late(true, true, "gyro")
        assert found is not None and not found.apart
        assert found.delay.value == 0.0 and aligned(true, found) is true
        assert found.equations.held_out().gain == 0.0


def test_what_both_sensors_are_late_by_is_none_between_them() -> None:
    true, late_one = shaken(), late(shaken(0.01, 2), shaken(), "gyro")
    assert late_one is not None and found_between(late_one, late_one, true) == []
    prompt = late(shaken(0.0, 3), true, "gyro")
    assert prompt is not None
    (said,) = found_between(prompt, late_one, true)
    assert said.effect == "accel_gyro_time_offset"
    low, high = np.asarray(said.parameters["delay"].ci95, dtype=np.float64)
    assert low < 0.01 < high


def test_rough_motion_between_rests_is_no_noise() -> None:
    """A rate whose power falls by 12 dB an octave only, as a motor's, changes from sample to sample."""
    rng = np.random.default_rng(5)
    rough = lfilter(
        [0.03], np.convolve([1.0, -0.85], [1.0, -0.85]), rng.normal(0.0, 1.0, (T.size, 3)), axis=0
    )
    rough[T % 40.0 < 10.0] = 0.0
    own, other = (
        Samples(Sensor.GYROSCOPE, frozen(T), frozen(xyz + rng.normal(0.0, 1e-3, xyz.shape)))
        for xyz in (np.roll(rough, 1, axis=0), rough)
    )
    found = late(own, other, "gyro")
    assert found is not None
    assert found.delay.value == pytest.approx(0.02, abs=1e-3)


def test_a_sensor_that_is_not_moved_tells_no_delay() -> None:
    """Noise changes from sample to sample too, and a delay by it would be nothing, and very sure."""
    for noise in (0.0, 0.01):
        rows = noise * np.random.default_rng(4).normal(size=(2, T.size, 3))
        one, other = (Samples(Sensor.GYROSCOPE, frozen(T), frozen(xyz)) for xyz in rows)
        assert late(one, other, "gyro") is None


@pytest.mark.parametrize(("turns", "told"), [(5, True), (1, False)])
def test_turns_of_some_seconds_tell_a_delay_wherever_they_begin(turns: int, told: bool) -> None:
    """Five turns hold fewer than twelve pieces of four seconds, and one turn is too little in any case."""
    true, own = (turned(seed, turns=turns).gyroscope for seed in (1, 2))
    assert true is not None and own is not None
    later = Samples(Sensor.GYROSCOPE, own.t, frozen(np.roll(own.xyz, 1, axis=0)))
    assert len(_moving(true, PIECES[0])) < LEAST_PIECES
    found = late(later, true, "gyro")
    assert (found is not None) is told
    if found is not None:
        assert found.delay.value == pytest.approx(1.0 / RATE, abs=3.0 * found.delay.error)


def test_a_smooth_hand_tells_a_delay_at_a_high_rate() -> None:
    """From one sample to the next it moved a sensor by less than its noise: gyroscopes 12 ms apart agreed."""
    t = np.arange(0.0, 300.0, 0.005)
    force = 9.8 * np.sin(0.6 * np.sin(2.0 * np.pi * 0.3 * t)[:, None] + [0.0, 0.5, 1.5])

    def read(late_by: float, seed: int) -> Samples:
        noise = np.random.default_rng(seed).normal(0.0, 0.015, force.shape)
        moved = np.stack([np.interp(t - late_by, t, axis) for axis in force.T], axis=1)
        return Samples(Sensor.ACCELEROMETER, t, moved + noise)

    found = late(read(0.012, 1), read(0.0, 2), "accel")
    assert found is not None and found.delay.error < 1e-4
    assert found.delay.value == pytest.approx(0.012, abs=4.0 * found.delay.error)
    assert found.pieces[-1].stop > t.size - 2000, "pieces are of all the samples"
