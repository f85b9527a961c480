"""Effects with a formula add exactly what it says, to their sensor and to nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from stillcal.replay.phone import Simulation, simulate
from tests.support.affected import G3, M, V, effect, phone, scenario


class Truth:
    """The true input at the samples' times, from the plan and the heat and nothing of the sensor."""

    def __init__(self, simulation: Simulation, t: np.ndarray) -> None:
        motion = simulation.plan.motion(t)
        self.t, self.force, self.rate, self.rate_dot = t, motion.force, motion.rate, motion.rate_dot
        self.warmth = simulation.temperature_at(t) - 25.0
        self.charging = simulation.plan.surroundings.charging.at(t)
        self.use = simulation.plan.surroundings.use.at(t)

    def of(self, sensor: str) -> np.ndarray:
        return self.force if sensor == "accel" else self.rate


def lagged(t: np.ndarray, drive: np.ndarray, tau: float) -> np.ndarray:
    """First-order lag by stepping, settled on the first value."""
    level = np.empty_like(drive)
    level[0] = drive[0]
    for i, dt in enumerate(np.diff(t)):
        level[i + 1] = drive[i] + (level[i] - drive[i]) * math.exp(-dt / tau)
    return level


R = (0.03, 0.05, -0.01)


def slow(name: str, parameters: dict[str, Any], formula: Callable[[Truth, str], np.ndarray]) -> list[Any]:
    """The same effect on either sensor."""
    return [pytest.param(f"{s}_{name}", parameters, s, formula, id=f"{s}_{name}") for s in ("accel", "gyro")]


FORMULAS = [
    *slow("bias_temperature", {"slope": V}, lambda m, s: np.outer(m.warmth, V)),
    *slow("scale_temperature", {"slope": V}, lambda m, s: m.warmth[:, None] * np.array(V) * m.of(s)),
    *slow("warmup", {"amplitude": V, "tau_s": 40.0}, lambda m, s: np.outer(1 - np.exp(-m.t / 40.0), V)),
    *slow("bias_step", {"step": V, "at_s": 50.0}, lambda m, s: np.outer(m.t >= 50.0, V)),
    *slow("bias_drift", {"rate": V}, lambda m, s: np.outer(m.t, V)),
    *slow("charging_bias", {"step": V}, lambda m, s: np.outer(m.charging, V)),
    *slow(
        "nonlinearity",
        {"quadratic": V, "cubic": (0.01, 0.02, -0.01)},
        lambda m, s: np.array(V) * m.of(s) ** 2 + np.array([0.01, 0.02, -0.01]) * m.of(s) ** 3,
    ),
    *slow(
        "thermal_hysteresis",
        {"coefficient": V, "tau_s": 30.0},
        lambda m, s: np.outer(m.warmth - lagged(m.t, m.warmth, 30.0), V),
    ),
    pytest.param(
        "thermal_latent",
        {"amplitude": V, "tau_s": 30.0, "sensor": "gyro"},
        "gyro",
        lambda m, s: np.outer(lagged(m.t, m.use + m.charging, 30.0), V),
        id="thermal_latent",
    ),
    pytest.param(
        "gyro_g_sensitivity",
        {"matrix": G3},
        "gyro",
        lambda m, s: m.force @ np.array(G3).T,
        id="gyro_g_sensitivity",
    ),
    pytest.param(
        "lever_arm",
        {"position": R},
        "accel",
        lambda m, s: (np.cross(m.rate_dot, R) + np.cross(m.rate, np.cross(m.rate, R))) @ M.T,
        id="lever_arm",
    ),
    pytest.param(
        "vibration_tone",
        {"frequency": 17.0, "amplitude": V, "start_s": 20.0, "duration_s": 60.0},
        "accel",
        lambda m, s: np.outer(np.sin(34 * np.pi * m.t) * (m.t >= 20) * (m.t < 80), V) @ M.T,
        id="vibration_tone",
    ),
]


@pytest.mark.parametrize(("name", "parameters", "sensor", "formula"), FORMULAS)
def test_on_less_off_is_the_formula(name: str, parameters: Any, sensor: str, formula: Any) -> None:
    off = simulate(scenario(), phone(), seed=1)
    on = simulate(scenario(), phone(effect(name, **parameters)), seed=1)
    without, with_it = off.whole(), on.whole()
    a, g = without.accelerometer, without.gyroscope
    changes = {
        "accel": with_it.accelerometer.xyz - a.xyz,
        "gyro": with_it.gyroscope.xyz - g.xyz,
    }
    expected = formula(Truth(off, a.t), sensor)
    # a lag stepped from sample to sample meets the exact one only where steps fall between samples
    tolerance = 1e-3 if "thermal_" in name else 1e-9
    assert np.abs(changes.pop(sensor) - expected).max() < tolerance * (1.0 + np.abs(expected).max())
    assert np.abs(expected).max() > 1e-3
    assert np.all(next(iter(changes.values())) == 0.0)
    assert np.array_equal(a.t, with_it.accelerometer.t)
    assert np.array_equal(a.t_arrival, with_it.accelerometer.t_arrival)
