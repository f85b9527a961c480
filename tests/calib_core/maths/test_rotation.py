"""Rotation integrator: against scipy, against the analytic coning motion, against the printed equations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths import rotation


def scipy_of(q: Array) -> Rotation:
    return Rotation.from_quat(np.moveaxis(q, 0, -1)[..., [1, 2, 3, 0]])


def random_quaternions(seed: int, n: int) -> Array:
    q = np.random.default_rng(seed).normal(size=(4, n))
    return q / np.linalg.norm(q, axis=0)


def coning(t: Array, half_angle: float = 0.2, frequency: float = 2.0) -> tuple[Array, Rotation]:
    """Body rates, and attitude, of a body whose tilt of `half_angle` runs around at `frequency` Hz.

    The attitude's rotation vector is half_angle (cos, sin, 0) at all times: it returns every turn,
    while the z rate is steady at 2 pi f (cos(half_angle) - 1) and sums up to a rotation that never was.
    """
    omega = 2 * np.pi * frequency
    c, s = np.cos(omega * t), np.sin(omega * t)
    steady = np.full_like(t, omega * (np.cos(half_angle) - 1))
    rates = np.column_stack((-omega * np.sin(half_angle) * s, omega * np.sin(half_angle) * c, steady))
    return rates, Rotation.from_rotvec(half_angle * np.column_stack((c, s, np.zeros_like(t))))


def coning_error(rate_hz: float, steps: object) -> float:
    """Angle between the true rotation over ten seconds of coning and the integrated one, rad."""
    t = np.arange(0.0, 10.0 + 1e-9, 1.0 / rate_hz)
    rates, attitude = coning(t)
    true = attitude[-1].inv() * attitude[0]
    found = rotation.matrix(rotation.running_product(rotation.exponential(steps(t, rates)))[:, -1]).T  # type: ignore[operator]
    return float((Rotation.from_matrix(found) * true.inv()).magnitude())


def full_steps(t: Array, rates: Array) -> Array:
    return rotation.mean_rate_angles(t, rates) + rotation.coning_angles(t, rates)


def trapezoid_steps(t: Array, rates: Array) -> Array:
    return 0.5 * np.diff(t)[:, None] * (rates[1:] + rates[:-1])


def order(steps: object, rates_hz: tuple[float, ...] = (25.0, 50.0, 100.0, 200.0)) -> float:
    errors = [coning_error(f, steps) for f in rates_hz]
    return float(-np.polyfit(np.log(rates_hz), np.log(errors), 1)[0])


def test_product_matrix_and_exponential_agree_with_scipy() -> None:
    p, q = random_quaternions(1, 50), random_quaternions(2, 50)
    np.testing.assert_allclose(rotation.matrix(p), scipy_of(p).as_matrix(), atol=1e-14)
    product = (scipy_of(p) * scipy_of(q)).as_matrix()
    np.testing.assert_allclose(rotation.matrix(rotation.multiply(p, q)), product, atol=1e-14)
    inverse = scipy_of(p).inv().as_matrix()
    np.testing.assert_allclose(rotation.matrix(rotation.conjugate(p)), inverse, atol=1e-14)
    vectors = np.random.default_rng(3).normal(size=(60, 3)) * np.logspace(-12, 0.6, 60)[:, None]
    vectors[0] = 0.0
    expected = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotation.matrix(rotation.exponential(vectors)), expected, atol=1e-14)


@given(st.integers(1, 200), st.integers(0, 2**32 - 1))
def test_running_product_is_the_product_taken_one_by_one(n: int, seed: int) -> None:
    q = random_quaternions(seed, n)
    expected = [q[:, 0]]
    for k in range(1, n):
        expected.append(rotation.multiply(expected[-1], q[:, k]))
    np.testing.assert_allclose(rotation.running_product(q), np.array(expected).T, atol=1e-13)
    np.testing.assert_allclose(rotation.product(q), expected[-1], atol=1e-13)


def test_printed_equations_12_and_13_with_their_slips_undone() -> None:
    def printed_c(x: float, y: float, z: float, slip: bool) -> Array:
        return np.array([[0, x, y, z], [-x, 0, z, -z if slip else -y], [-y, -z, 0, x], [-z, y, -x, 0]])

    def printed_r(a: float, b: float, c: float, d: float, slip: bool) -> Array:
        last = c * d + a * d if slip else c * d + a * b
        return np.array(
            [
                [a * a + b * b - c * c - d * d, 2 * (b * c + a * d), 2 * (b * d - a * c)],
                [2 * (b * c - a * d), a * a - b * b + c * c - d * d, 2 * last],
                [2 * (b * d + a * c), 2 * (c * d - a * b), a * a - b * b - c * c + d * d],
            ]
        )

    turn = np.array([0.3, -0.5, 0.8])
    angle = float(np.linalg.norm(turn))
    as_printed, c = printed_c(*turn, slip=True), printed_c(*turn, slip=False)
    assert not np.allclose(as_printed, -as_printed.T)
    np.testing.assert_allclose(c, -c.T)
    q0 = random_quaternions(4, 1)[:, 0]
    stepped = (np.cos(angle / 2) * np.eye(4) + np.sin(angle / 2) / angle * c) @ q0
    ours = rotation.multiply(rotation.conjugate(rotation.exponential(turn)), q0)
    np.testing.assert_allclose(stepped, ours, atol=1e-15)

    assert not np.allclose(printed_r(*stepped, slip=True) @ printed_r(*stepped, slip=True).T, np.eye(3))
    np.testing.assert_allclose(printed_r(*stepped, slip=False), rotation.matrix(stepped).T, atol=1e-15)


def test_a_fixed_vector_turns_against_the_body() -> None:
    """Body turns +90 degrees about z: what was along x of the body is then along -y."""
    t = np.linspace(0.0, 2.0, 201)
    rates = np.tile([0.0, 0.0, np.pi / 4], (201, 1))
    np.testing.assert_allclose(rotation.rotation(t, rates) @ [1, 0, 0], [0, -1, 0], atol=1e-12)


def test_u_obeys_its_differential_equation() -> None:
    t = np.linspace(0.0, 1e-3, 3)
    w, u = np.array([0.4, -1.1, 0.7]), np.array([0.6, 0.0, -0.8])
    change = (rotation.rotation(t, np.tile(w, (3, 1))) @ u - u) / 1e-3
    np.testing.assert_allclose(change, -np.cross(w, u), atol=2e-3)


def test_coning_is_integrated_to_fourth_order() -> None:
    assert order(full_steps) == pytest.approx(4.0, abs=0.15)
    assert coning_error(25.0, full_steps) < 0.01
    assert coning_error(100.0, full_steps) < 4e-5


def test_without_both_terms_coning_is_second_order_and_far_worse_at_25_hz() -> None:
    def without_end_correction(t: Array, rates: Array) -> Array:
        return trapezoid_steps(t, rates) + rotation.coning_angles(t, rates)

    for steps in (trapezoid_steps, without_end_correction, rotation.mean_rate_angles):
        assert order(steps) == pytest.approx(2.0, abs=0.15)
        assert coning_error(25.0, steps) > 10 * coning_error(25.0, full_steps)


@pytest.mark.parametrize("rate_hz", [25.0, 50.0])
def test_hand_motion_at_low_rates_against_dense_scipy_products(rate_hz: float) -> None:
    """A turn by hand, 0 to 3 Hz, against 10 000 products a second of scipy's."""
    rng = np.random.default_rng(5)
    phase, size = rng.uniform(0, 2 * np.pi, (3, 3)), rng.normal(size=(3, 3))

    def hand(t: Array) -> Array:
        wave = np.sin(2 * np.pi * np.array([0.7, 1.5, 2.7])[:, None] * t[:, None, None] + phase)
        return np.sin(np.pi * t / 4)[:, None] ** 2 * (size * wave).sum(axis=-1)

    fine = np.linspace(0.0, 4.0, 40_001)
    middle = hand(0.5 * (fine[1:] + fine[:-1]))
    parts = Rotation.from_rotvec(middle * np.diff(fine)[:, None])
    while len(parts) > 1:
        odd = parts[-1:] if len(parts) % 2 else None
        half = parts[: len(parts) // 2 * 2]
        parts = half[0::2] * half[1::2]
        parts = parts if odd is None else Rotation.concatenate([parts, odd])
    true = parts[0].inv()
    t = np.arange(0.0, 4.0 + 1e-9, 1.0 / rate_hz)
    error = (Rotation.from_matrix(rotation.rotation(t, hand(t))) * true.inv()).magnitude()
    naive = rotation.matrix(
        rotation.running_product(rotation.exponential(trapezoid_steps(t, hand(t))))[:, -1]
    ).T
    naive_error = (Rotation.from_matrix(naive) * true.inv()).magnitude()
    assert error < 2e-3 * (25.0 / rate_hz) ** 4
    assert error < naive_error / 5


def test_repeated_stamps_add_no_rotation() -> None:
    t = np.linspace(0.0, 1.0, 51)
    rates, _ = coning(t)
    held = np.sort(np.concatenate((t, t[10:40:7])))
    again = rates[np.searchsorted(t, held)]
    apart = Rotation.from_matrix(rotation.rotation(held, again) @ rotation.rotation(t, rates).T)
    assert apart.magnitude() < 2e-3


def test_uneven_stamps_lose_little() -> None:
    rng = np.random.default_rng(6)
    t = np.sort(np.arange(0.0, 10.0, 0.01) + rng.uniform(-0.003, 0.003, 1000))
    rates, attitude = coning(t)
    true = attitude[-1].inv() * attitude[0]
    assert (Rotation.from_matrix(rotation.rotation(t, rates)) * true.inv()).magnitude() < 2e-4


@pytest.mark.parametrize("n", [1, 2, 3])
def test_shortest_runs(n: int) -> None:
    t, rates = np.arange(n) * 0.01, np.full((n, 3), 0.5)
    expected = Rotation.from_rotvec(-rates[0] * t[-1]).as_matrix()
    np.testing.assert_allclose(rotation.rotation(t, rates), expected, atol=1e-14)
