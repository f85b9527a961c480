"""Rotation from angular rates: quaternions, coning, products in logarithmic depth.

Quaternions are arrays of shape (4, ...), scalar first, with Hamilton's product. A gyroscope's rates are those
of the body, in body axes. Attitude q(t) takes vectors from the body at t to the body at the start. A fixed
vector u of the world, in body axes, obeys du/dt = -w x u, so u_end = R u_start with R = matrix(q_end)
transposed.

Grammenos et al. 2018, Eq. 12-14, print this with four slips, two of them contradicting each other. Their
quaternion is our conjugate p (start to body), with dp/dt = -w p / 2:

- Eq. 12 closes a parenthesis too late: the step is cos(|d|/2) I + sin(|d|/2) C / |d|.
- C's second row ends in -d_y, not -d_z: it is (-d_x, 0, d_z, -d_y). Only so is C antisymmetric.
- Eq. 13's element (2, 3) is 2 (c d + a b), not 2 (c d + a d). Only so is R orthogonal.
- With that, Eq. 13 is the matrix of p's conjugate, while Eq. 12 steps p: together they would turn gravity
  the wrong way. Eq. 14 needs the transpose (or Eq. 12 the opposite sign of C).

The step itself follows Bortz 1971 and Miller 1983: the rotation vector is the integral of the rate plus half
the integral of (angle so far x rate). The second term is the coning correction.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array

_SMALL_ANGLE = 1e-4  # rad; below it the series of sin(x / 2) / x to x^2 is exact to a rounding error


def multiply(p: Array, q: Array) -> Array:
    """Return the Hamilton product of quaternions (4, ...): matrix(p q) = matrix(p) matrix(q)."""
    a, b, c, d = p
    e, f, g, h = q
    return np.stack(
        (
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        )
    )


def conjugate(q: Array) -> Array:
    """Return the inverse of unit quaternions of shape (4, ...)."""
    return np.concatenate((q[:1], -q[1:]))


def exponential(vectors: Array) -> Array:
    """Return unit quaternions (4, ...) of rotation vectors (..., 3), rad."""
    squared = np.einsum("...i,...i->...", vectors, vectors)
    angle = np.sqrt(squared)
    small = angle < _SMALL_ANGLE
    ratio = np.where(small, 0.5 - squared / 48.0, np.sin(0.5 * angle) / np.where(small, 1.0, angle))
    return np.concatenate((np.cos(0.5 * angle)[None], np.moveaxis(vectors, -1, 0) * ratio))


def matrix(q: Array) -> Array:
    """Return rotation matrices (..., 3, 3) of unit quaternions (4, ...), by Eq. 13 corrected."""
    a, b, c, d = q
    rows = (
        (a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)),
        (2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)),
        (2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d),
    )
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def running_product(q: Array) -> Array:
    """Return all products q_0 q_1 ... q_k, shape (4, n), from quaternions of shape (4, n).

    Neighbours are multiplied in pairs, and the run of half the length is scanned in the same way: 2 n
    products in 2 log2(n) vectorised steps. Rounding errors grow with log2(n) instead of n.
    """
    n = q.shape[1]
    if n < 2:
        return q.copy()
    pairs = running_product(multiply(q[:, 0 : n - 1 : 2], q[:, 1:n:2]))
    out = np.empty_like(q)
    out[:, 0] = q[:, 0]
    out[:, 1::2] = pairs
    out[:, 2::2] = multiply(pairs[:, : (n - 1) // 2], q[:, 2::2])
    return out


def product(q: Array) -> Array:
    """Return the product q_0 q_1 ... q_n, shape (4,), from quaternions of shape (4, n), n at least 1.

    It is the last of `running_product`, in half as many products.
    """
    while q.shape[1] > 1:
        n = q.shape[1]
        pairs = multiply(q[:, 0 : n - 1 : 2], q[:, 1:n:2])
        q = np.concatenate((pairs, q[:, n - 1 :]), axis=1) if n % 2 else pairs
    return q[:, 0]


def mean_rate_angles(t: Array, rates: Array) -> Array:
    """Return the integral of rates (n, 3), rad/s, over every interval of t (n,), s: (n - 1, 3) rad.

    The rule is the trapezoid with its end correction -h^2/12 (w'_1 - w'_0), w' from neighbouring samples. It
    is linear in the rates, of fourth order for even stamps and never below the trapezoid's order for others.
    """
    h = np.diff(t)[:, None]
    trapezoid = 0.5 * h * (rates[1:] + rates[:-1])
    if t.size < 3:
        return trapezoid
    return trapezoid - h * h / 12.0 * np.diff(_derivative(h, rates), axis=0)


def coning_angles(t: Array, rates: Array) -> Array:
    """Return the coning correction of every interval, h^2/12 (w_0 x w_1), (n - 1, 3) rad.

    It is Bortz' half integral of (angle x rate) for a rate linear in time, exact to fifth order in h.
    """
    h = np.diff(t)[:, None]
    return h * h / 12.0 * np.cross(rates[:-1], rates[1:])


def attitudes(t: Array, rates: Array) -> Array:
    """Return the attitudes q(t), (4, n), from the body at each sample to the body at the first one.

    t: (n,) s, never decreasing. rates: (n, 3) rad/s, calibrated. Repeated stamps add no rotation.
    """
    return running_product(_steps(t, rates))


def rotation(t: Array, rates: Array) -> Array:
    """Return R (3, 3) with u_end = R u_start for any vector u fixed in the world (Eq. 14)."""
    return matrix(product(_steps(t, rates))).T


def _steps(t: Array, rates: Array) -> Array:
    """Return the rotation of every interval, after one of none at all, (4, n)."""
    steps = exponential(mean_rate_angles(t, rates) + coning_angles(t, rates))
    start = np.array([[1.0], [0.0], [0.0], [0.0]])
    return np.concatenate((start, steps), axis=1)


def _derivative(h: Array, rates: Array) -> Array:
    """Return the derivative at every sample, (n, 3), by parabolas through three; 0 at repeated stamps."""
    safe = np.where(h > 0.0, h, 1.0)
    slope = np.where(h > 0.0, np.diff(rates, axis=0) / safe, 0.0)
    before, after = safe[:-1], safe[1:]
    inner = (slope[:-1] * after + slope[1:] * before) / (before + after)
    first = 2.0 * slope[:1] - inner[:1]
    last = 2.0 * slope[-1:] - inner[-1:]
    return np.concatenate((first, inner, last))
