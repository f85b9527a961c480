"""Strapdown navigation against motion in closed form, dead reckoning against its own geometry."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.replay.studies.methods.navigation import (
    dead_reckoning,
    direction_cosines,
    headings,
    step_headings,
    strapdown,
    up_in_body,
)

G = 9.81
T = np.arange(0.0, 60.0, 0.01)


def test_direction_cosines_are_those_of_scipy_and_of_eq_7() -> None:
    p = np.array([0.3, -1.1, 0.7])
    size, cross = np.linalg.norm(p), np.array([[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]])
    eq7 = np.eye(3) + np.sin(size) / size * cross + (1 - np.cos(size)) / size**2 * cross @ cross
    assert direction_cosines(p) == pytest.approx(eq7, abs=1e-14)
    assert direction_cosines(p) == pytest.approx(Rotation.from_rotvec(p).as_matrix(), abs=1e-14)
    assert direction_cosines(np.zeros(3)) == pytest.approx(np.eye(3), abs=0.0)


def test_rest_in_any_attitude_stays_where_it_is() -> None:
    attitude = Rotation.from_euler("xyz", [0.5, -0.8, 2.0]).as_matrix()
    forces = np.tile(attitude.T @ [0.0, 0.0, G], (T.size, 1))
    track = strapdown(T, np.zeros((T.size, 3)), forces, attitude, G)
    assert np.abs(track.position).max() < 1e-10


def test_circle_that_turns_closes() -> None:
    rate, radius = 0.5, 3.0  # drives along a circle, x ahead, y towards its centre
    rates = np.tile([0.0, 0.0, rate], (T.size, 1))
    forces = np.tile([0.0, radius * rate**2, G], (T.size, 1))
    track = strapdown(T, rates, forces, np.eye(3), G, velocity=np.array([radius * rate, 0.0, 0.0]))
    truth = radius * np.column_stack((np.sin(rate * T), 1.0 - np.cos(rate * T), 0.0 * T))
    # trapezoids of a sinusoid lose (rate h)^2 / 12 of it: of the start's velocity all along, of the radius
    lost = (rate * 0.01) ** 2 / 12.0 * radius * (rate * T[-1] + 4.0)
    assert np.abs(track.position - truth).max() < lost


def test_bias_of_forces_grows_with_the_square_and_of_rates_with_the_cube() -> None:
    still = np.tile([0.0, 0.0, G], (T.size, 1))
    none = np.zeros((T.size, 3))
    accel = strapdown(T, none, still + np.array([0.01, 0.0, 0.0]), np.eye(3), G).position[-1]
    assert accel[0] == pytest.approx(0.5 * 0.01 * T[-1] ** 2, rel=1e-9)
    drift = 1e-5
    gyro = strapdown(T, none + np.array([0.0, drift, 0.0]), still, np.eye(3), G).position[-1]
    # a tilt grows as drift t; gravity leaks in as its sine: g drift t^3 / 6
    assert gyro[0] == pytest.approx(G * drift * T[-1] ** 3 / 6.0, rel=1e-4)


def test_up_is_found_while_the_phone_swings_and_turns() -> None:
    angle = 1.2 * np.sin(2 * np.pi * 0.9 * T) + 0.3 * T
    truth = Rotation.from_rotvec(angle[:, None] * np.array([0.6, 0.0, 0.8]))
    rates = np.gradient(angle, T)[:, None] * np.array([0.6, 0.0, 0.8])
    shake = 2.0 * np.sin(2 * np.pi * 1.8 * T)[:, None] * np.array([1.0, 0.5, 2.0])
    forces = truth.inv().apply(shake + np.array([0.0, 0.0, G]))
    up = truth.inv().apply([0.0, 0.0, 1.0])
    error = np.degrees(np.arccos(np.clip(np.sum(up_in_body(T, rates, forces, 8.0) * up, axis=1), -1, 1)))
    # what is left of 2 m/s^2 at 1.8 Hz in the mean of 8 s (at the ends) is below 2 / (pi 1.8 8) of g
    assert error.max() < np.degrees(np.hypot(2.0, 1.0) / (np.pi * 1.8 * 8.0) / G)


def test_headings_and_steps_follow_equations_20_to_22() -> None:
    t = np.arange(0.0, 10.0, 0.1)
    heading = headings(t, np.full(t.size, 0.2), start=0.1)
    assert heading == pytest.approx(0.1 + 0.2 * t)
    start = np.array([0.0, 1.0, 2.0])
    means = step_headings(t, heading, start, start + 1.0)
    assert means == pytest.approx([0.1 + 0.2 * (s + 0.45) for s in start])  # ten samples from s to s + 0.9
    assert dead_reckoning(np.array([1.0, 2.0]), np.array([0.0, np.pi / 2])) == pytest.approx(
        np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    )
