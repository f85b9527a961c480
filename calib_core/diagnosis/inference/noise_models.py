"""The covariance shapes a view's noise may have: white plus wander of several kinds and strengths.

A shape is a covariance up to its scale. Strengths run over a logarithmic grid, so that hypotheses can be
judged under all of them (docs/diagnosis.md, 3). A family is diagonalised once; its strengths are then as many
diagonals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.noise.covariance import (
    flicker_covariance,
    gauss_markov_covariance,
    random_walk_covariance,
)

STRENGTHS = 10.0 ** np.array([-1.5, *np.arange(-1.0, 3.1, 0.25), *np.arange(3.5, 6.1, 0.5)])
TAUS = (60.0, 240.0, 960.0)
SLOW = TAUS[1:]
"""Correlation times of processes that are hardly to be told from a random walk, as which they begin, s."""

WANDERS: dict[str, Callable[[Array, Array], Array]] = {
    "flicker": flicker_covariance,
    "walk": random_walk_covariance,
    **{f"gauss_markov_{tau:.0f}": partial(gauss_markov_covariance, tau=tau) for tau in TAUS},
}
"""Covariance (n, n) of bin means at middles (n,) and durations (n,), s, by kind, in a unit of its own."""

MIXTURES = (
    ("walk", "gauss_markov_60", 0.5),
    ("walk", "gauss_markov_240", 0.5),
    ("walk", "flicker", 0.2),
    ("walk", "flicker", 0.5),
    ("walk", "flicker", 0.8),
    ("flicker", "gauss_markov_240", 0.5),
    ("flicker", "gauss_markov_960", 0.5),
)
"""Two kinds of wander, and the share of the first in their power.

With one share of walk and flicker, and strengths half a decade apart, the true covariance was six nats
behind, and a ramp with the wrong noise came before it.
"""

AVERAGED = 100.0
"""s: the averages by which strengths of wander are told to people; rests of some minutes show them."""

NEIGHBOURS = np.array([0.5, 1.5]) * AVERAGED, np.full(2, AVERAGED)
"""Middles and durations, s, of two averages whose half squared difference is the Allan variance."""

FAINTEST = 1e-12
"""Part of the largest variance in a view that every bin has, lest rounding make the covariance singular."""


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """One kind of wander at unit strength: covariance (n, n), what of it walks (variance rate, 1/s) or jumps.

    The rate of a slow Gauss-Markov process is that with which it begins; what jumps is the variance that
    all bins of a rest share and the next rest does not. allan: Allan variance of averages over `AVERAGED`
    within a rest.
    """

    covariance: Array
    walk: float = 0.0
    jump: float = 0.0
    allan: float = 0.0

    def beside(self, other: Kind, share: float) -> Kind:
        """Return a mixture with another kind; share: this one's part of the power."""
        mine, its = share, 1.0 - share
        return Kind(
            mine * self.covariance + its * other.covariance,
            mine * self.walk + its * other.walk,
            mine * self.jump + its * other.jump,
            mine * self.allan + its * other.allan,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """One kind of wander beside white noise, at G strengths.

    strengths, weight: (G,), prior; power: (G,) variance by which it makes two bins differ, half of it, over
    all pairs, unit^2; walk: (G,) variance rate of the random walk in it, unit^2/s; jump: (G,) variance of
    what is another in every rest, unit^2; allan: (G,) Allan variance of averages over `AVERAGED`, unit^2.
    rotation: (n, n), takes data into axes where the shapes are diagonal; diagonals: (G, n).
    """

    name: str
    strengths: Array
    weight: Array
    power: Array
    walk: Array
    jump: Array
    allan: Array
    rotation: Array
    diagonals: Array

    def covariance(self, g: int) -> Array:
        """Return the shape (n, n) at strength number `g`."""
        back = np.linalg.inv(self.rotation)
        return np.asarray((back * self.diagonals[g]) @ back.T)


def families(view: View) -> list[Family]:
    """Return every family of a view; they weigh alike, white alone as one of them."""
    if "families" not in view.memo:
        view.memo["families"] = _diagonalised(view)
    made: list[Family] = view.memo["families"]
    return made


def of_same_noise(made: View, view: View) -> View:
    """Return a view made of another one, with other data or baseline: its families are that one's."""
    made.memo["families"] = families(view)
    return made


def _diagonalised(view: View) -> list[Family]:
    whiten = np.linalg.inv(np.linalg.cholesky(covariance_of(view)))
    made = kinds(view)
    n, weight = view.t.size, 1.0 / (len(made) + 1)
    none, alone = np.zeros(1), np.array([weight])
    found = [Family("white", none, alone, none, none, none, none, whiten, np.ones((1, n)))]
    prior = strength_prior() * weight
    median = float(np.median(view.variance))
    for name, kind in made.items():
        values, vectors = np.linalg.eigh(whiten @ (kind.covariance * median) @ whiten.T)
        diagonals = 1.0 + STRENGTHS[:, None] * np.maximum(values, 0.0)
        power = STRENGTHS * median
        rotation = vectors.T @ whiten
        walk, jump, allan = (power * part for part in (kind.walk, kind.jump, kind.allan))
        found.append(Family(name, STRENGTHS, prior, power, walk, jump, allan, rotation, diagonals))
    return found


def covariance_of(view: View) -> Array:
    """White noise, errors of motion, of whole rests, what is absorbed: part of every shape (n, n)."""
    base = np.diag(view.variance if view.moving is None else view.variance + view.excess * view.moving)
    for columns in view.shared:
        base = base + columns @ columns.T
    if view.absorbed is not None:
        base = base + view.absorbed @ view.absorbed.T
    return np.asarray(base + FAINTEST * float(base.diagonal().max()) * np.eye(len(base)))


def strength_prior() -> Array:
    """Return the prior (G,) of strengths: broad about what phones have, with tails to either side."""
    away = (np.log10(STRENGTHS) - thresholds.WANDER_MIDDLE) / thresholds.WANDER_DECADES
    weight = (np.exp(-0.5 * away**2) + thresholds.WANDER_TAIL) * np.gradient(np.log10(STRENGTHS))
    return np.asarray(weight / weight.sum())


def kinds(view: View) -> dict[str, Kind]:
    """Return the kinds of wander at unit strength.

    All views of a sensor have the same families in the same unit, a bias that scatters between the view's
    bins like their white noise. Turns begin anew each, but their errors may grow with the angle.
    """
    if view.name == "turn":
        return {"growing": Kind(np.diag((view.duration / np.median(view.duration)) ** 2))}
    rates = {"walk": 1.0} | {f"gauss_markov_{tau:.0f}": 2.0 / tau for tau in SLOW}
    found = {}
    for name, covariance_of in WANDERS.items():
        covariance = covariance_of(view.t, view.duration)
        spread = _spread(covariance)
        allan = _spread(covariance_of(*NEIGHBOURS))
        found[name] = Kind(
            covariance * view.coupling / spread, rates.get(name, 0.0) / spread, allan=allan / spread
        )
    for one, other, share in MIXTURES:
        found[f"{share} {one}+{other}"] = found[one].beside(found[other], share)
    if len(np.unique(view.rest)) >= 3:
        scatter = (view.rest[:, None] == view.rest[None, :]).astype(np.float64)
        spread = _spread(scatter)
        found["scatter"] = Kind(scatter / spread, 0.0, 1.0 / spread)
        found["flicker+scatter"] = found["flicker"].beside(found["scatter"], 0.5)
        found["walk+scatter"] = found["walk"].beside(found["scatter"], 0.5)
    return found


def _spread(covariance: Array) -> float:
    """Mean over pairs of bins of half the variance of their difference."""
    n = len(covariance)
    total = n * float(np.trace(covariance)) - float(covariance.sum())
    return max(total / max(n * (n - 1), 1), 1e-30)
