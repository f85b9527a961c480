"""Steps and their patterns, on signals whose steps are known."""

import numpy as np
import pytest

from stillcal.replay.studies.methods.steps import (
    StepSettings,
    detect_steps,
    even,
    patterns,
    step_length,
    vertical_only,
)

G = 9.81
CADENCE = 1.8


def walking(duration: float = 30.0, rate: float = 100.0, amplitude: float = 2.5, cadence: float = CADENCE):
    t = np.arange(0.0, duration, 1.0 / rate)
    up = G + amplitude * np.sin(2 * np.pi * cadence * t)
    return t, np.column_stack((0.6 * up, np.zeros(t.size), 0.8 * up))


@pytest.mark.parametrize("rate", [25.0, 50.0, 200.0])
@pytest.mark.parametrize("cadence", [1.4, 1.8, 2.3])
def test_every_step_is_found_once_at_any_rate(rate: float, cadence: float) -> None:
    t, forces = walking(rate=rate, cadence=cadence)
    steps = detect_steps(t, forces, G)
    assert steps.start.size == pytest.approx(30.0 * cadence, abs=2)
    assert np.diff(steps.start) == pytest.approx(1.0 / cadence, abs=0.05)  # a sample of 25 Hz to either side


def test_a_phone_at_rest_or_in_a_car_walks_not_a_step() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.01)
    for rms in (0.02, 0.3):
        forces = np.array([0.0, 0.0, G]) + rms * rng.standard_normal((t.size, 3))
        assert detect_steps(t, forces, G).start.size == 0


def test_step_ends_at_the_next_or_after_its_longest_time() -> None:
    t, forces = walking(12.0)
    forces[(t > 5.0) & (t < 8.0)] = [0.0, 0.0, G - 0.01]
    steps = detect_steps(t, forces, G, StepSettings(most_s=0.9))
    gap = int(np.argmax(np.diff(steps.start)))
    assert steps.end[gap] == pytest.approx(steps.start[gap] + 0.9)
    assert steps.end[0] == pytest.approx(steps.start[1])


def test_patterns_of_a_sinusoid_are_those_of_calculus() -> None:
    t, forces = walking(30.0, amplitude=2.0)
    steps = detect_steps(t, forces, G, StepSettings(rate=200.0, cutoff=40.0))
    found = np.median(patterns(steps, G, vertical=steps.norm), axis=0)
    expected = [CADENCE, 2.0, 2.0, 4.0 * 2.0 / (2 * np.pi * CADENCE), 4.0, 4.0]
    assert found == pytest.approx(expected, rel=0.02)  # a sample of 200 Hz is 1 % of a step
    assert np.isnan(patterns(steps, G)[:, [2, 5]]).all()


def test_length_follows_eq_19() -> None:
    assert step_length(np.array([16.0]), 0.4, 0.25, 0.1) == pytest.approx([0.9])


def test_low_pass_and_grid_leave_a_slow_signal_alone() -> None:
    t = np.sort(np.random.default_rng(2).uniform(0.0, 20.0, 4000))
    grid, values = even(t, np.column_stack((np.sin(t), np.cos(t))))
    inner = (grid > 2.0) & (grid < 18.0)
    # (f / cutoff)^4 of a Butterworth run twice, and linear interpolation between some 200 samples a second
    assert values[inner] == pytest.approx(np.column_stack((np.sin(grid), np.cos(grid)))[inner], abs=2e-3)


def test_only_the_vertical_is_left_of_forces() -> None:
    t, forces = walking()
    up, level = np.array([0.6, 0.0, 0.8]), np.array([0.8, 0.0, -0.6])
    swinging = forces + np.sin(2 * np.pi * CADENCE * t)[:, None] * level  # whole periods: no mean
    assert vertical_only(swinging) == pytest.approx(forces, abs=0.02)
    assert vertical_only(swinging) @ level == pytest.approx(0.0, abs=0.02)
    assert np.abs(swinging @ level).max() > 0.9
    assert forces @ up == pytest.approx(np.linalg.norm(forces, axis=1))


def test_too_little_to_walk_in_is_refused() -> None:
    t, forces = walking(1.0)
    with pytest.raises(ValueError, match="two seconds"):
        detect_steps(t, forces, G)
