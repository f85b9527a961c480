"""The observability of an accelerometer's parameters from a set of attitudes, and which attitude to add.

It is judged from directions alone, before and apart from any fit: each attitude counts as one rest of unit
noise. The measure, called amplification, is that of G-optimal design (Kiefer and Wolfowitz 1960): the
standard error that a fit to these attitudes would leave in the norm of a force along the worst direction of
the sphere, in units of one rest's noise. At 1 or below no direction is extrapolated to.

Axes are Android's: x to the right, y to the top, z out of the screen; the axis that points up reads +g.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np

from stillcal.calib_core.accelerometer.parameters import Form, basis, names, norm_rows, variances_along
from stillcal.calib_core.arrays import Array, frozen

FACES = (
    ("on its left edge (x axis up)", "on its right edge (x axis down)"),
    ("upright on its bottom edge (y axis up)", "upside down on its top edge (y axis down)"),
    ("on its back, screen up (z axis up)", "on its face, screen down (z axis down)"),
)
"""How a phone lies when +x or -x, +y or -y, +z or -z points up."""

_RIDGE = 1e-6  # information, in rests, that makes the ranking of candidates finite before the first rest
_SINGULAR = 1e-9  # eigenvalues of the information below this part of the largest are rounding errors
_MOST_MISSING = 9  # attitudes proposed at most: nine suffice for any model even where there are none yet


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """A way to lay the phone.

    up: (3,) unit vector in body axes that points up. words: the attitude in words; part of stored records.
    """

    up: Array
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """What a set of attitudes supports. Directions are those of raw forces, which is close enough.

    parameters, names: of the model asked about. n_attitudes: number of distinct attitudes. amplification:
    standard error of the calibrated norm along the worst direction over one rest's noise, infinite where a
    parameter is not determined. observability: (p,) for each parameter, its standard error from as many
    evenly spread attitudes over that from these: 1 is as good as evenly spread, 0 is not observed.
    unobservable: what no rest can show. weakest: the attitude that would help most.
    """

    parameters: int
    names: tuple[str, ...]
    n_attitudes: int
    amplification: float
    observability: Array
    unobservable: tuple[str, ...]
    weakest: Attitude


def describe(up: Array) -> str:
    """Say in words how to lay a phone so that `up` (3,), body axes, points up, to the nearest 45 degrees.

    >>> describe(np.array([9.7, 0.3, -0.2]))
    'lay it on its left edge (x axis up)'
    """
    unit = np.asarray(up, dtype=np.float64) / np.linalg.norm(up)
    place = places()[int(np.argmax(places() @ unit))]
    faces = [FACES[k][0 if place[k] > 0 else 1] for k in range(3) if abs(place[k]) > 0.1]
    if len(faces) == 1:
        return f"lay it {faces[0]}"
    return f"prop it up halfway between {', '.join(faces[:-1])} and {faces[-1]}"


def coverage(up: Array, parameters: int = 9, form: Form = "symmetric") -> Coverage:
    """Return what distinct attitudes, unit vectors (n, 3), support of a model of 6, 9 or 12 parameters.

    Gravity alone shows 9 of 12 parameters; the other three are one rotation common to all axes.
    """
    information = _information(up, parameters)
    return Coverage(
        parameters,
        names(parameters, form),
        len(up),
        _amplification(information, parameters),
        _observability(up, parameters, form),
        ("rotation common to all axes",) if parameters == 12 else (),
        _weakest(information, parameters),
    )


def amplification(up: Array, parameters: int = 9) -> float:
    """Return the worst standard error of a calibrated norm over one rest's noise, inf where undetermined."""
    return _amplification(_information(up, parameters), parameters)


def determined(up: Array, parameters: int = 9) -> bool:
    """Tell whether distinct attitudes, unit vectors (n, 3), determine every parameter of a model."""
    return _determined(_information(up, parameters))


def most_helpful_attitude(up: Array, parameters: int = 9) -> Attitude:
    """Return the attitude to add to distinct ones `up`, unit vectors (n, 3); n may be 0.

    >>> all_but_one_face = np.delete(places()[:6], 0, axis=0)
    >>> most_helpful_attitude(all_but_one_face, parameters=6).words
    'lay it on its left edge (x axis up)'
    """
    return _weakest(_information(up, parameters), parameters)


def missing_attitudes(up: Array, parameters: int, limit: float, least: int = 0) -> tuple[Attitude, ...]:
    """Return the attitudes to add until `amplification` is within `limit`, most helpful first.

    up: unit vectors (n, 3). least: number of distinct attitudes required. Empty where nothing is missing.
    """
    wanted: list[Attitude] = []
    with_wanted = up
    while len(wanted) < _MOST_MISSING and (
        len(with_wanted) < least or amplification(with_wanted, parameters) > limit
    ):
        wanted.append(most_helpful_attitude(with_wanted, parameters))
        with_wanted = np.vstack((with_wanted, wanted[-1].up))
    return tuple(wanted)


def _gauge(parameters: int) -> Array:
    """Return the basis (12, p) of what rests can show: a symmetric scale stands for all its rotations."""
    return basis(min(parameters, 9))


def _information(up: Array, parameters: int) -> Array:
    """Return the information of unit rests along directions, (p, p)."""
    rows = norm_rows(np.reshape(up, (-1, 3)), _gauge(parameters))
    return np.asarray(rows.T @ rows)


def _determined(information: Array) -> bool:
    """Tell whether the information determines every parameter."""
    eigenvalues = np.linalg.eigvalsh(information)
    return bool(eigenvalues[0] > _SINGULAR * eigenvalues[-1])


def _amplification(information: Array, parameters: int) -> float:
    if not _determined(information):
        return float("inf")
    variances = variances_along(_sphere_rows(parameters), frozen(np.linalg.inv(information)))
    return float(np.sqrt(variances.max()))


def _weakest(information: Array, parameters: int) -> Attitude:
    """Return the named attitude of largest predicted variance: adding it shrinks the covariance most."""
    eased = frozen(np.linalg.inv(information + _RIDGE * np.eye(len(information))))
    variances = variances_along(norm_rows(places(), _gauge(parameters)), eased)
    first = int(np.argmax(variances >= 0.999 * variances.max()))
    return Attitude(frozen(places()[first]), describe(places()[first]))


def _observability(up: Array, parameters: int, form: Form) -> Array:
    """Return each parameter's observability, (p,); see Coverage."""
    if parameters == 12:
        # in the symmetric gauge entries (i, j) and (j, i) are one number
        entries = np.abs(basis(12).T @ basis(9)).argmax(axis=1)
        return frozen(_observability(up, 9, "symmetric")[entries])
    matrix = basis(parameters, form)
    rows = norm_rows(up, matrix)
    values, vectors = np.linalg.eigh(rows.T @ rows)
    known = values > _SINGULAR * max(values[-1], 1e-300)
    hidden = (vectors[:, ~known] ** 2).sum(axis=1)
    variances = (vectors[:, known] ** 2 / values[known]).sum(axis=1)
    even = _even_variances(parameters, form) / max(len(up), 1)
    return frozen(np.where(hidden > 1e-9, 0.0, np.sqrt(even / np.maximum(variances, 1e-300))))


@cache
def _even_variances(parameters: int, form: Form) -> Array:
    """Return each parameter's variance by one rest spread evenly over the sphere, (p,).

    By the 14-point rule exact to degree 5 (McLaren 1963).
    """
    cube, matrix = places(), basis(parameters, form)
    faces, corners = cube[:6], cube[18:]
    weights = np.r_[np.full(6, 1 / 15), np.full(8, 3 / 40)]
    rows = norm_rows(np.vstack((faces, corners)), matrix)
    return frozen(np.diag(np.linalg.inv(rows.T @ (weights[:, None] * rows))))


@cache
def places() -> Array:
    """Return the 26 directions of a cube's faces (first 6), edges (12) and corners (8), as unit vectors."""
    cube = np.array([p for p in product((1.0, 0.0, -1.0), repeat=3) if any(p)])
    cube = cube[np.argsort(np.abs(cube).sum(axis=1), kind="stable")]
    return frozen(cube / np.linalg.norm(cube, axis=1, keepdims=True))


@cache
def sphere(n: int = 400) -> Array:
    """Return `n` directions spread evenly (a Fibonacci lattice), and the 26 places."""
    k = np.arange(n) + 0.5
    z = 1.0 - 2.0 * k / n
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z * z)
    return frozen(np.vstack((np.column_stack((ring * np.cos(turn), ring * np.sin(turn), z)), places())))


@cache
def _sphere_rows(parameters: int) -> Array:
    return frozen(norm_rows(sphere(), _gauge(parameters)))
