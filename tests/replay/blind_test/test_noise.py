"""The examiner's noise, motion and weights: each drawn one way and checked another."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.replay.blind_test.power import detectability as power
from stillcal.replay.blind_test.power.rotation import turn_d_prime
from stillcal.replay.blind_test.world.day import Bins, binned, lagged
from stillcal.replay.blind_test.world.days import Day, play
from stillcal.replay.blind_test.world.forward_model import played
from stillcal.replay.blind_test.world.noise import FAMILIES, Colour, drawn_colour
from stillcal.replay.blind_test.world.turning import minimum_jerk, rotated


@pytest.fixture(scope="module")
def bins() -> Bins:
    return binned(play(Day(1200.0, 25.0), np.random.default_rng(1)))


def allan_deviation(x: np.ndarray, m: int) -> float:
    means = x[: len(x) // m * m].reshape(-1, m).mean(axis=1)
    return float(np.sqrt(0.5 * np.mean(np.diff(means) ** 2)))


def test_flicker_has_the_floor_it_is_told() -> None:
    colour, rng = Colour(0.0, floor=2e-4), np.random.default_rng(2)
    for m in (8, 32, 128):
        seen = [allan_deviation(colour.drawn(4000.0, rng)[:, 0], m) ** 2 for _ in range(30)]
        assert math.sqrt(np.mean(seen)) == pytest.approx(2e-4, rel=0.1)


def test_gauss_markov_has_its_variance_and_correlation_time() -> None:
    colour, rng = Colour(0.0, sigma=1e-3, tau_s=100.0), np.random.default_rng(3)
    drawn = np.concatenate([colour.drawn(3000.0, rng) for _ in range(30)], axis=1)
    assert drawn.std() == pytest.approx(1e-3, rel=0.06)
    after = np.mean(drawn[:-100] * drawn[100:]) / np.mean(drawn**2)
    assert after == pytest.approx(math.exp(-1.0), abs=0.06)


def test_a_random_walk_grows_as_the_root_of_time() -> None:
    drawn = np.concatenate(
        [Colour(0.0, walk=1e-4).drawn(400.0, np.random.default_rng(i)) for i in range(300)], axis=1
    )
    assert drawn[401].std() == pytest.approx(1e-4 * 20.0, rel=0.08)


def bin_means(slow: np.ndarray, bins: Bins, white: float, rng: np.random.Generator) -> np.ndarray:
    """Integrate the linearly interpolated grid exactly, bin by bin."""
    grid = np.arange(len(slow))
    whole = np.concatenate([np.zeros((1, 3)), np.cumsum((slow[1:] + slow[:-1]) / 2.0, axis=0)])
    at = [
        np.column_stack([np.interp(t, grid, whole[:, a]) for a in range(3)])
        for t in (bins.t - bins.width / 2, bins.t + bins.width / 2)
    ]
    return (at[1] - at[0]) / bins.width + white / math.sqrt(2.0 * bins.width) * rng.standard_normal(
        (bins.t.size, 3)
    )


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_the_matched_filter_has_unit_variance_on_drawn_noise(family: str, sensor: str, bins: Bins) -> None:
    """If it had not, d' would not be what it says: 400 draws give its deviation to 3.5 %; four of these."""
    rng = np.random.default_rng(4)
    colour = drawn_colour(family, sensor, rng)
    weight = power.precision(bins, sensor, colour)
    delta = played(bins, "accel_bias_temperature", {"slope": [1e-3, 5e-4, 0.0]})
    filtered = delta.T.ravel() @ weight / power.d_prime(weight, delta)
    scores = [
        filtered @ bin_means(colour.drawn(1200.0, rng), bins, colour.white, rng).T.ravel() for _ in range(400)
    ]
    assert np.mean(scores) == pytest.approx(0.0, abs=0.2)
    assert np.std(scores) == pytest.approx(1.0, abs=0.14)


def test_what_calibration_absorbs_has_next_to_no_weight(bins: Bins) -> None:
    weight = power.precision(bins, "accel", Colour(2e-3))
    up = bins.force / 9.80665
    bias = np.broadcast_to([0.02, -0.01, 0.03], up.shape)
    scale = up @ np.array([[0.05, 0.0, 0.01], [0.0, -0.03, 0.0], [0.02, 0.0, 0.01]])
    tilt = np.cross([0.01, 0.0, -0.02], up) * (bins.rest == bins.rest[0])[:, None] * 9.8
    for absorbed in (bias, scale, tilt):
        assert power.d_prime(weight, absorbed) < 0.3
    assert power.d_prime(weight, up * np.sin(bins.t / 100.0)[:, None] * 0.02) > 20.0


def test_the_oracle_gains_half_of_d_prime_squared_and_nothing_more_can_be_had(bins: Bins) -> None:
    weight = power.precision(bins, "gyro", Colour(1e-4, floor=3e-5))
    delta = played(bins, "gyro_bias_temperature", {"slope": [1e-5, 0.0, 2e-5]})
    best = 0.5 * power.d_prime(weight, delta) ** 2
    assert power.gain(weight, delta, delta) == pytest.approx(best)
    assert power.gain(weight, delta, 0.0 * delta) == pytest.approx(0.0, abs=1e-9 * best)
    assert power.gain(weight, delta, 2.0 * delta) == pytest.approx(0.0, abs=1e-6 * best)
    assert power.gain(weight, delta, 0.7 * delta) == pytest.approx(best * (1.0 - 0.3**2))


def test_gravity_turns_as_the_rate_says() -> None:
    world = play(Day(120.0, 400.0, pivot=True), np.random.default_rng(5))
    up = world.force / np.linalg.norm(world.force, axis=1, keepdims=True)
    changed = np.gradient(up, 1.0 / 400.0, axis=0)
    assert np.abs(changed + np.cross(world.rate, up)).max() < 0.05 * np.abs(changed).max()
    assert np.abs(np.gradient(world.rate, 1.0 / 400.0, axis=0) - world.rate_dot).max() < 0.05


@pytest.mark.parametrize("ground", ["foam", "cushion", "breathing", "sagging"])
def test_what_tilts_a_resting_phone_is_seen_by_both_sensors(ground: str) -> None:
    """In rests and through the turns between them, gravity turns by what the gyroscope turns."""
    day = Day(120.0, 200.0, rest_s=(30.0, 40.0), ground=ground, pivot=True, earth_rotation=False)
    world = play(day, np.random.default_rng(6))
    up = world.force / 9.80665
    turning = -np.cross(world.rate, up)
    for begin, end in world.rests:
        rows = slice(*np.searchsorted(world.t, (begin + 0.1, end - 0.1)))
        turned = np.cumsum(turning[rows], axis=0) / 200.0
        assert np.abs((up[rows] - up[rows][0]) - (turned - turned[0])).max() < 1e-4
        assert np.abs(up[rows] - up[rows][0]).max() > 1e-6
        assert np.abs(np.linalg.norm(up[rows], axis=1) - 1.0).max() < 1e-9
    assert np.abs(np.gradient(up, 1.0 / 200.0, axis=0) - turning).max() < 0.1, "no jump that only one feels"


@given(st.floats(-3.0, 3.0), st.floats(0.3, 5.0))
@settings(max_examples=30, deadline=None)
def test_a_turn_begins_and_ends_at_rest(angle: float, length: float) -> None:
    place, speed, change = minimum_jerk(np.array([0.0, length]), length, angle)
    assert place == pytest.approx([0.0, angle], abs=1e-12)
    assert speed == pytest.approx([0.0, 0.0], abs=1e-9)
    assert change == pytest.approx([0.0, 0.0], abs=1e-9)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_rotation_keeps_lengths_and_its_axis(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis, vector = rng.standard_normal(3), rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    turned = rotated(vector, axis, rng.uniform(-6.0, 6.0, 4))
    assert np.linalg.norm(turned, axis=1) == pytest.approx(np.linalg.norm(vector))
    assert turned @ axis == pytest.approx(vector @ axis)


def test_a_lag_is_the_solution_of_its_equation() -> None:
    drive = np.array([[0.0, 0.0], [100.0, 1.0], [400.0, 0.0]])
    t = np.arange(0.0, 900.0, 0.1)
    answer = lagged(drive, 150.0, t)
    target = drive[np.searchsorted(drive[:, 0], t, side="right") - 1, 1]
    stepwise = np.zeros(t.size)
    for i in range(1, t.size):
        stepwise[i] = stepwise[i - 1] + 0.1 * (target[i - 1] - stepwise[i - 1]) / 150.0
    assert np.abs(answer - stepwise).max() < 1e-3


def test_scale_and_bias_of_the_gyroscope_are_absorbed_in_turns_too() -> None:
    world = play(Day(1200.0, 25.0), np.random.default_rng(7))
    colour = Colour(1e-4)
    linear = world.rate @ np.array([[0.02, 0.0, 0.01], [0.0, 0.01, 0.0], [0.0, 0.0, -0.02]]) + 0.01
    assert turn_d_prime(world, linear, colour) < 1.0
    assert (
        turn_d_prime(world, played(world, "gyro_nonlinearity", {"quadratic": [0.02, 0.02, 0.02]}), colour)
        > 20.0
    )


def test_one_vector_of_the_ground_is_absorbed_and_one_a_rest_is_not(bins: Bins) -> None:
    weight = power.precision(bins, "gyro", Colour(2e-5))
    up = bins.force / np.linalg.norm(bins.force, axis=1, keepdims=True)
    east = np.cross(bins.north, up)
    assert power.d_prime(weight, 7e-5 * (0.3 * up + 0.8 * bins.north + 0.5 * east)) < 2.0
    heading = np.where(bins.rest % 2.0 == 0.0, 0.0, math.pi)[:, None]
    jumping = 7e-5 * (np.cos(heading) * bins.north + np.sin(heading) * east)
    assert power.d_prime(weight, jumping) > 8.0


def test_the_earth_turns_under_every_rest() -> None:
    """Its rate keeps its length and its part along up, and is carried through turns as the ground is."""
    day = Day(400.0, 100.0, attitudes=4)
    with_it, without = (play(replace(day, earth_rotation=e), np.random.default_rng(8)) for e in (True, False))
    np.testing.assert_array_equal(with_it.force, without.force)
    still = with_it.rest_of(with_it.t) >= 0
    felt, up = with_it.rate - without.rate, with_it.force / day.gravity
    np.testing.assert_allclose(np.linalg.norm(felt, axis=1), 7.292115e-5, rtol=1e-9)
    vertical = (felt * up).sum(axis=1)[still]
    np.testing.assert_allclose(vertical, vertical[0], atol=1e-12)
    carried = felt[0] + np.cumsum(-np.cross(without.rate, felt), axis=0) / day.rate_hz
    assert np.abs(carried - felt).max() < 0.03 * 7.292115e-5
