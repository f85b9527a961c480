"""Effects on the values read: clipping, rounding, filtering, noise, walks, spikes, rectification, creep."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from stillcal.replay.phone import Scenario, simulate
from stillcal.replay.phone.effects.base import Effect
from stillcal.replay.phone.settings import Noise
from tests.support.affected import M, both, effect, phone, scenario


def test_saturation_clips_what_was_read() -> None:
    off, on = both(effect("accel_saturation", limit=7.0), effect("gyro_saturation", limit=1.5))
    assert np.array_equal(on.accelerometer.xyz, np.clip(off.accelerometer.xyz, -7.0, 7.0))
    assert np.array_equal(on.gyroscope.xyz, np.clip(off.gyroscope.xyz, -1.5, 1.5))


def test_saturation_of_the_element_comes_before_bias_and_scale() -> None:
    off, on = both(effect("accel_saturation", limit=7.0, before_filter=True))
    true = (off.accelerometer.xyz - [0.1, -0.2, 0.3]) @ np.linalg.inv(M).T
    expected = np.clip(true, -7.0, 7.0) @ M.T + [0.1, -0.2, 0.3]
    assert on.accelerometer.xyz == pytest.approx(expected, abs=1e-9)


def test_quantisation_rounds_noise_and_all() -> None:
    steps = effect("accel_quantisation", step=0.02), effect("gyro_quantisation", step=0.005)
    off, on = both(*steps, noise=Noise(white=0.002))
    assert on.accelerometer.xyz == pytest.approx(np.rint(off.accelerometer.xyz / 0.02) * 0.02, abs=1e-12)
    assert on.gyroscope.xyz == pytest.approx(np.rint(off.gyroscope.xyz / 0.005) * 0.005, abs=1e-12)


def test_bandwidth_halves_the_power_at_its_cutoff() -> None:
    """A tone at the cutoff comes out 3 dB down; white noise is cut as a Butterworth filter cuts it."""
    tone = effect("vibration_tone", frequency=10.0, amplitude=(0.0, 0.0, 1.0), sensor="both")
    slow_off = simulate(scenario(), phone(effect("bandwidth", cutoff=10.0)), seed=1).whole()
    slow_on = simulate(scenario(), phone(tone, effect("bandwidth", cutoff=10.0)), seed=1).whole()
    for stream in ("accelerometer", "gyroscope"):
        response = (getattr(slow_on, stream).xyz - getattr(slow_off, stream).xyz)[500:]
        rms = np.sqrt(np.mean(response**2, axis=0)) * math.sqrt(2.0)
        assert rms == pytest.approx(np.abs(M[:, 2]) / math.sqrt(2.0), rel=0.01)


def test_bandwidth_leaves_rests_alone() -> None:
    off, on = both(effect("bandwidth", cutoff=20.0))
    simulation = simulate(scenario(), phone(), seed=1)
    assert simulation.truth.rests and np.abs(off.accelerometer.xyz - on.accelerometer.xyz).max() > 1e-3
    for rest in simulation.truth.rests:
        late = [r.accelerometer.between(rest.t_start + 1.0, rest.t_end).xyz for r in (off, on)]
        assert np.abs(late[0] - late[1]).max() < 1e-6


def test_held_samples_repeat_the_one_before() -> None:
    off, on = both(effect("held_samples", fraction=0.2, sensor="accel"), noise=Noise(white=0.002))
    repeats = (np.diff(on.accelerometer.xyz, axis=0) == 0.0).all(axis=1)
    # 15000 draws: one standard deviation is 0.0033
    assert repeats.mean() == pytest.approx(0.2, abs=0.015)
    fresh = np.flatnonzero(~repeats) + 1
    assert np.array_equal(on.accelerometer.xyz[fresh], off.accelerometer.xyz[fresh])
    assert np.array_equal(on.gyroscope.xyz, off.gyroscope.xyz)


def noise_of(*effects: Effect) -> dict[str, np.ndarray]:
    """What noise adds, by sensor."""
    silent = simulate(scenario(), phone(), seed=1).whole()
    loud = simulate(scenario(), phone(*effects, noise=Noise(white=0.002)), seed=1).whole()
    return {s: getattr(loud, s).xyz - getattr(silent, s).xyz for s in ("accelerometer", "gyroscope")}


def test_noise_effects_scale_the_very_same_noise() -> None:
    plain = noise_of()
    louder = noise_of(effect("noise_level", ratio=3.0, sensor="accel"))
    assert louder["accelerometer"] == pytest.approx(3.0 * plain["accelerometer"], abs=1e-12)
    assert np.array_equal(louder["gyroscope"], plain["gyroscope"])
    uneven = noise_of(effect("noise_unequal_axes", ratio=(1.0, 2.0, 0.5)))
    for stream in plain:
        assert uneven[stream] == pytest.approx(plain[stream] * [1.0, 2.0, 0.5], abs=1e-12)


def test_heavy_tails_come_as_often_as_told() -> None:
    tails = noise_of(effect("noise_heavy_tailed", ratio=50.0, fraction=0.05))["accelerometer"]
    sd = 0.002 * math.sqrt(50.0)
    # beyond 5 sigma only the tails reach, and 92 % of them do (|x| > 0.1)
    assert np.mean(np.abs(tails) > 5.0 * sd) == pytest.approx(0.05 * 0.92, rel=0.1)


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_bias_random_walk_walks(sensor: str) -> None:
    name = {"accel": "accelerometer", "gyro": "gyroscope"}
    off, on = both(effect(f"{sensor}_bias_random_walk", density=(0.01, 0.02, 0.0)))
    walked = {s: getattr(on, n).xyz - getattr(off, n).xyz for s, n in name.items()}
    steps = walked[sensor][::100][1:] - walked[sensor][::100][:-1]
    # 149 steps of 1 s: good to 6 %
    assert steps.std(axis=0)[:2] == pytest.approx([0.01, 0.02], rel=0.25)
    assert np.abs(walked[sensor][:, 2]).max() < 1e-12
    assert np.all(walked["gyro" if sensor == "accel" else "accel"] == 0.0)


def test_spikes_are_rare_single_samples() -> None:
    off, on = both(effect("spikes", amplitude=(0.0, 0.0, 5.0), per_hour=1200.0, sensor="accel"))
    change = on.accelerometer.xyz - off.accelerometer.xyz
    hit = np.abs(change[:, 2]) > 1e-9
    assert 25 <= hit.sum() <= 80  # 50 expected
    assert np.abs(change[hit, 2]) == pytest.approx(5.0)
    assert np.abs(change[:, :2]).max() == 0.0


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_vibration_rectifies_into_bias(sensor: str) -> None:
    """A tone of amplitude A leaves k A^2 / 2 behind on average, less what the lag of 0.5 s takes."""
    tone = effect("vibration_tone", frequency=20.0, amplitude=(0.0, 0.0, 2.0))
    kind = effect(f"{sensor}_vibration_rectification", coefficient=(0.0, 0.0, 0.1))
    name = {"accel": "accelerometer", "gyro": "gyroscope"}[sensor]
    text = '{"segment": [{"activity": "rest", "duration_s": 60.0}]}'
    rest = msgspec.json.decode(text, type=Scenario)
    quiet, loud = (simulate(rest, phone(*e), seed=1).whole() for e in ((tone,), (tone, kind)))
    change = (getattr(loud, name).xyz - getattr(quiet, name).xyz)[1000:]
    keep = math.exp(-1.0 / 50.0)
    passed = 1.0 - (1.0 - keep) / (1.0 - keep * np.exp(-2j * np.pi * 20.0 / 100.0))
    expected = 0.1 * (2.0 * abs(passed)) ** 2 / 2.0
    assert change.mean(axis=0) == pytest.approx([0.0, 0.0, expected], abs=0.002 * expected)


def test_tilt_creep_moves_across_gravity_and_keeps_the_norm() -> None:
    creeping = phone(effect("tilt_creep", amplitude=0.01, tau_s=5.0))
    simulation = simulate(scenario(), creeping, seed=1)
    moved = []
    for rest in simulation.truth.rests:
        t = np.linspace(rest.t_start, rest.t_end, 50)
        force = simulation.plan.motion(t).force
        assert np.linalg.norm(force, axis=1) == pytest.approx(rest.gravity, rel=1e-12)
        span = rest.t_end - rest.t_start
        angle = math.asin(np.linalg.norm(np.cross(force[0], force[-1])) / rest.gravity**2)
        moved.append(angle / (0.01 * (1.0 - math.exp(-span / 5.0))))
    assert moved == pytest.approx(np.ones(len(moved)), rel=1e-3)
