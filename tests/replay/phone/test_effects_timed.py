"""Effects on time: skew, jitter, samples dropped, doubled or held back, one sensor behind the other."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.replay.phone import simulate
from stillcal.replay.phone.settings import Noise
from tests.support.affected import M, both, effect, phone, scenario


def test_clock_skew_shortens_true_intervals_and_keeps_stamps() -> None:
    off, on = both(effect("clock_skew", relative=0.01))
    assert np.diff(on.accelerometer.t) == pytest.approx(0.01, abs=1e-9)
    assert np.diff(on.accelerometer.t_arrival) == pytest.approx(0.01 / 1.01, abs=1e-9)
    assert len(on.accelerometer) == pytest.approx(1.01 * len(off.accelerometer), abs=2)


def test_timestamp_jitter_scatters_stamps_only() -> None:
    off, on = both(effect("timestamp_jitter", sigma=5e-4))
    assert np.std(on.accelerometer.t - off.accelerometer.t) == pytest.approx(5e-4, rel=0.03)
    assert np.array_equal(on.accelerometer.xyz, off.accelerometer.xyz)
    assert np.diff(on.accelerometer.t).min() > 0.0


def test_wild_jitter_never_turns_time_back() -> None:
    _, on = both(effect("timestamp_jitter", sigma=0.05))
    assert np.diff(on.accelerometer.t).min() >= 0.0


def test_dropped_samples_leave_the_others_as_they_were() -> None:
    off, on = both(effect("dropped_samples", fraction=0.1), noise=Noise(white=0.002, flicker=0.001))
    assert 1.0 - len(on.accelerometer) / len(off.accelerometer) == pytest.approx(0.1, abs=0.01)
    kept = np.isin(off.accelerometer.t, on.accelerometer.t)
    assert np.array_equal(off.accelerometer.xyz[kept], on.accelerometer.xyz)


def test_doubled_samples_come_twice_whole() -> None:
    off, on = both(effect("doubled_samples", fraction=0.1), noise=Noise(white=0.002))
    twice = np.diff(on.accelerometer.t) == 0.0
    assert twice.mean() == pytest.approx(0.1 / 1.1, abs=0.01)
    assert np.all(np.diff(on.accelerometer.xyz, axis=0)[twice] == 0.0)
    assert np.array_equal(np.unique(on.accelerometer.t), off.accelerometer.t)


def test_arrival_bursts_hold_samples_back() -> None:
    off, on = both(effect("arrival_bursts", fraction=0.3, burst_s=0.2))
    late = on.accelerometer.t_arrival > off.accelerometer.t_arrival + 1e-9
    assert late.mean() == pytest.approx(0.3, abs=0.06)  # 750 windows: sd 0.017
    assert (on.accelerometer.t_arrival - on.accelerometer.t).max() <= 0.2 + 1e-9
    assert np.diff(on.accelerometer.t_arrival).min() >= 0.0
    assert np.array_equal(on.accelerometer.xyz, off.accelerometer.xyz)


def test_time_offset_delays_the_gyroscope_motion() -> None:
    delay = 0.03
    off, on = both(effect("accel_gyro_time_offset", delay=delay))
    simulation = simulate(scenario(), phone(), seed=1)
    earlier = simulation.plan.motion(off.gyroscope.t - delay).rate @ M.T + [0.1, -0.2, 0.3]
    assert on.gyroscope.xyz == pytest.approx(earlier, abs=1e-12)
    assert np.array_equal(on.accelerometer.xyz, off.accelerometer.xyz)
