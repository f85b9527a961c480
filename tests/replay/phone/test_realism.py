"""The simulated walk against recorded ones (UCI HAR, Anguita et al. 2013), rests against draws, memory."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import msgspec
import numpy as np
import pytest

from stillcal.replay.phone import Phone, Scenario, draw_rests, simulate
from stillcal.replay.phone.settings import ClockSettings, Noise, SensorSettings

WINDOW, RATE = 128, 50.0
WALK, UPSTAIRS = 1, 2


def features(acceleration: np.ndarray, rate: np.ndarray) -> dict[str, np.ndarray]:
    """Of windows (n, 128, 3): spread of the force's norm, rms of the rate, strongest frequency."""
    norm = np.linalg.norm(acceleration, axis=2)
    swing = (norm - norm.mean(axis=1, keepdims=True)) * np.hanning(WINDOW)
    power = np.abs(np.fft.rfft(swing, axis=1)) ** 2
    strongest = np.fft.rfftfreq(WINDOW, 1.0 / RATE)[1 + np.argmax(power[:, 1:], axis=1)]
    return {
        "norm_sd": norm.std(axis=1),
        "rate_rms": np.sqrt((rate**2).mean(1).sum(1)),
        "strongest": strongest,
    }


def recorded(data_dir: Path, activity: int) -> dict[str, np.ndarray]:
    parts = np.load(data_dir / "ucihar" / "ucihar_subset.npz")
    label = np.concatenate([parts[f"{p}_y"] for p in ("train", "test")]).ravel()
    g, w = (
        np.concatenate([parts[f"{p}_{c}"] for p in ("train", "test")]) for c in ("total_acc", "body_gyro")
    )
    return features(g[label == activity] * 9.80665, w[label == activity])


def simulated(activity: str) -> dict[str, np.ndarray]:
    scenario = msgspec.convert({"segment": [{"activity": activity, "duration_s": 120.0}]}, type=Scenario)
    forces, rates = [], []
    for seed in range(8):
        motion = simulate(scenario, Phone(), seed).plan.motion(10.0 + np.arange(39 * WINDOW) / RATE)
        forces.append(motion.force.reshape(-1, WINDOW, 3))
        rates.append(motion.rate.reshape(-1, WINDOW, 3))
    return features(np.concatenate(forces), np.concatenate(rates))


@pytest.mark.parametrize(("label", "activity"), [(WALK, "walk"), (UPSTAIRS, "stairs")])
def test_a_simulated_walk_lies_among_recorded_ones(data_dir: Path, label: int, activity: str) -> None:
    real, ours = recorded(data_dir, label), simulated(activity)
    for name, values in real.items():
        low, high = np.percentile(values, [10.0, 90.0])
        assert low <= np.median(ours[name]) <= high, name


def test_drawn_and_simulated_rests_have_the_scatter_that_they_claim() -> None:
    """Means of simulated rests about the true model, in units of the uncertainty that draw_rests states."""
    noise = Noise(white=0.002)
    sensor = SensorSettings(bias=(0.1, -0.2, 0.3), lsb=0.001, noise=noise)
    phone = Phone(accel=sensor, gyro=None, clock=ClockSettings(shared=True))
    segment = {"activity": "poses", "count": 26, "rest_s": 20.0}
    simulation = simulate(msgspec.convert({"segment": [segment] * 4}, type=Scenario), phone, seed=1)
    run, rests = simulation.whole().accelerometer, simulation.truth.rests
    means = np.array([run.between(r.t_start + 1e-6, r.t_end).xyz.mean(axis=0) for r in rests])
    sampled = means - np.array([r.up * r.gravity for r in rests]) - sensor.bias
    drawn = draw_rests(phone, 104, seed=2, duration_s=20.0)
    direct = drawn.forces - drawn.true_forces - sensor.bias
    for residual in (sampled, direct):
        # 312 values: the root mean square is good to 4 %
        assert np.sqrt(np.mean((residual / drawn.uncertainties[0]) ** 2)) == pytest.approx(1.0, abs=0.15)


def test_memory_does_not_grow_with_the_recording() -> None:
    def peak(duration: float) -> int:
        segment = {"activity": "rest", "duration_s": duration}
        phone = Phone(accel=SensorSettings(noise=Noise(white=1e-3, flicker=1e-3)))
        simulation = simulate(msgspec.convert({"segment": [segment]}, type=Scenario), phone, seed=1)
        tracemalloc.start()
        try:
            for _ in simulation.chunks(30.0):
                pass
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(300.0)  # what is loaded once is not the recording's
    assert peak(3600.0) < 1.2 * peak(600.0)
