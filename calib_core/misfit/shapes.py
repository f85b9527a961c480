"""The covariance shapes a view's noise may have: white plus wander of several kinds and strengths.

A shape is a covariance up to its scale. Strengths run over a logarithmic grid, so that hypotheses can be
judged under all of them (docs/misfit.md, 3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.misfit.views import View
from stillcal.calib_core.noise import flicker_covariance, gauss_markov_covariance, random_walk_covariance
from stillcal.calib_core.samples import Array

STRENGTHS = tuple(10.0 ** (x / 2.0) for x in range(-3, 10))
TAUS = (60.0, 240.0, 960.0)
MIXTURES = (
    ("walk", "gauss_markov_60"),
    ("walk", "gauss_markov_240"),
    ("walk", "flicker"),
    ("flicker", "gauss_markov_240"),
    ("flicker", "gauss_markov_960"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """One covariance shape (n, n). walk: variance rate of the random walk in it, unit^2/s."""

    family: str
    strength: float
    covariance: Array
    walk: float


def kinds(view: View) -> dict[str, tuple[Array, float]]:
    """Return unit wander covariances (n, n) of each family and the random walk's variance rate in them, 1/s.

    Turns have none: each begins anew.
    """
    if view.name == "turn":
        return {}
    walk = random_walk_covariance(view.t, view.duration)
    raw = {"flicker": flicker_covariance(view.t, view.duration), "walk": walk}
    raw |= {f"gauss_markov_{tau:.0f}": gauss_markov_covariance(view.t, view.duration, tau) for tau in TAUS}
    scatter = (view.rest[:, None] == view.rest[None, :]).astype(np.float64)
    spread = {name: _spread(c * view.coupling) for name, c in raw.items()}
    unit = {name: c * view.coupling / spread[name] for name, c in raw.items()}
    rate = 1.0 / spread["walk"]
    families = {name: (c, rate if name == "walk" else 0.0) for name, c in unit.items()}
    for one, other in MIXTURES:
        walks = 0.5 * rate * (one == "walk")
        families[f"{one}+{other}"] = (0.5 * (unit[one] + unit[other]), walks)
    if len(np.unique(view.rest)) >= 3 and view.name != "tangent":
        between = scatter / _spread(scatter)
        families["scatter"] = (between, 0.0)
        families["flicker+scatter"] = (0.5 * (unit["flicker"] + between), 0.0)
        families["walk+scatter"] = (0.5 * (unit["walk"] + between), 0.5 * rate)
    return families


def _spread(covariance: Array) -> float:
    """Mean over pairs of bins of half the variance of their difference."""
    n = len(covariance)
    total = n * float(np.trace(covariance)) - float(covariance.sum())
    return max(total / max(n * (n - 1), 1), 1e-30)


def shapes(view: View) -> Iterator[tuple[Shape, float]]:
    """Yield every shape of a view with its prior weight; families weigh alike, white alone as one of them."""
    white = np.diag(view.variance)
    median = float(np.median(view.variance))
    families = kinds(view)
    weight = 1.0 / (len(families) + 1)
    yield Shape("white", 0.0, white, 0.0), weight
    for name, (unit, rate) in families.items():
        for strength in STRENGTHS:
            size = strength * median
            yield Shape(name, strength, white + size * unit, size * rate), weight / len(STRENGTHS)
