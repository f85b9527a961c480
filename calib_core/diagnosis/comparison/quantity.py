"""A physical quantity as one recording shows it, and the decision whether two of them differ.

Both recordings are described by the same parameters, so that rate, length and motion need not agree. Whether
a parameter differs is a choice between two models: one value for both recordings, or a difference drawn from
a normal prior of stated size. The Bayes factor of the two is in closed form (Kass and Raftery, J. Am. Stat.
Assoc. 90, 1995, eq. 1, with normal densities).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import NINE_IN_TEN
from stillcal.calib_core.diagnosis.model.records import Where

Relation = Literal["lacking", "too_small", "too_large", "superfluous"]

CERTAIN = 0.95
"""Posterior probability from which a difference is stated, and one minus it from which agreement is."""

NONE_BEYOND = 0.01
"""Probability of a value as far from nothing, if nothing is there, below which a recording has an effect."""

INFORMED = 0.5
"""Part of the prior's size that a standard deviation must be below, for a recording to show a parameter."""

HUNDREDFOLD = float(np.log(100.0))
"""Logarithm of a ratio from which the smaller of two positive quantities is as good as absent."""


@dataclass(frozen=True, slots=True)
class Part:
    """One named parameter of a quantity: `count` numbers in `unit`, three by three where `count` is 9."""

    name: str
    unit: str
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """The parameters of one effect as one recording shows them.

    value: (k,), the parts one after another, in their units, or the logarithms of positive numbers where
    `logarithmic`. covariance: (k, k). size: (k,) standard deviation of how far a simulation may be off.
    tolerance: (k,) standard deviation of a difference that two recordings of one phone have anyway. axis_of:
    (k,) the axis each number belongs to, -1 for none. reference: what the values are stated at. none: whether
    what was measured is as good as nothing, of which the values are the logarithms of the limit.
    """

    effect: str
    sensor: str
    parts: tuple[Part, ...]
    value: Array
    covariance: Array
    size: Array
    tolerance: Array
    axis_of: NDArray[np.int64]
    logarithmic: bool = False
    reference: Mapping[str, float] = field(default_factory=dict)
    where: Where | None = None
    none: bool = False

    @property
    def sigma(self) -> Array:
        """Standard deviations (k,) of the values."""
        return np.asarray(np.sqrt(np.maximum(self.covariance.diagonal(), 0.0)))

    @property
    def informed(self) -> NDArray[np.bool_]:
        """Which of the numbers (k,) the recording shows clearly better than the prior does."""
        return np.asarray(self.sigma < INFORMED * self.size)

    def shows(self) -> bool:
        """Whether the recording shows a value that is not nothing (chi-squared of all its numbers)."""
        if self.logarithmic:
            return True
        from scipy.special import chdtrc  # noqa: PLC0415 - scipy is loaded when something is computed

        whole = self.covariance + np.diag(self.tolerance**2)
        return bool(chdtrc(self.value.size, self.value @ np.linalg.solve(whole, self.value)) < NONE_BEYOND)


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """Recorded less simulated. log_bayes_factor: nats for a difference; value: (k,); covariance: (k, k)."""

    recorded: Quantity
    simulated: Quantity
    value: Array
    covariance: Array
    log_bayes_factor: float
    probability: float = 0.0

    @property
    def sigma(self) -> Array:
        """Standard deviations (k,) of the difference."""
        return np.asarray(np.sqrt(np.maximum(self.covariance.diagonal(), 0.0)))

    def relation(self) -> Relation:
        """Return how the simulation stands to the recording: in size, whatever the signs."""
        if self.recorded.none != self.simulated.none:
            return "superfluous" if self.recorded.none else "lacking"
        if self.recorded.logarithmic:
            return _of_logarithms(self.value)
        if not self.simulated.shows():
            return "lacking"
        if not self.recorded.shows():
            return "superfluous"
        weight = np.linalg.inv(self.covariance + np.diag((1e-9 * self.recorded.size) ** 2))
        sizes = [float(q.value @ weight @ q.value) for q in (self.recorded, self.simulated)]
        return "too_small" if sizes[1] < sizes[0] else "too_large"

    def visible_from(self, comparisons: int) -> Array:
        """Return the differences (k,), each by itself, that would be stated nine times in ten.

        With one number, the log Bayes factor of a difference of z standard deviations is
        (z^2 shrunk - ln(1 + s^2 / c)) / 2, with prior size s and variance c.
        """
        variance = self.covariance.diagonal() + self.recorded.tolerance**2
        ratio = self.recorded.size**2 / variance
        needed = np.log(CERTAIN / (1.0 - CERTAIN) * comparisons)
        z = np.sqrt((2.0 * needed + np.log1p(ratio)) * (1.0 + 1.0 / ratio))
        return np.asarray((z + NINE_IN_TEN) * np.sqrt(variance))


def _of_logarithms(ratio: Array) -> Relation:
    largest = float(ratio[np.argmax(np.abs(ratio))])
    if abs(largest) > HUNDREDFOLD:
        return "lacking" if largest > 0.0 else "superfluous"
    return "too_small" if largest > 0.0 else "too_large"


def subtract(recorded: Quantity, simulated: Quantity) -> Difference:
    """Return the difference of one quantity in two recordings, with the evidence for it.

    The difference may be on all axes or on one: the four cases are averaged, half of the prior on the first.
    """
    value = recorded.value - simulated.value
    covariance = recorded.covariance + simulated.covariance
    noise = covariance + np.diag(recorded.tolerance**2)
    cases = [(np.ones(value.size, dtype=np.bool_), 0.5)]
    axes = [a for a in np.unique(recorded.axis_of) if a >= 0]
    if len(axes) > 1:
        cases += [(recorded.axis_of == a, 0.5 / len(axes)) for a in axes]
    else:
        cases = [(cases[0][0], 1.0)]
    terms = [_log_bayes_factor(value, noise, recorded.size * chosen) + np.log(w) for chosen, w in cases]
    return Difference(recorded, simulated, value, covariance, float(np.logaddexp.reduce(terms)))


def _log_bayes_factor(value: Array, noise: Array, size: Array) -> float:
    """Return log N(value; 0, noise + diag(size^2)) - log N(value; 0, noise)."""
    both = noise + np.diag(size**2)
    room = np.linalg.slogdet(noise)[1] - np.linalg.slogdet(both)[1]
    gain = value @ np.linalg.solve(noise, value) - value @ np.linalg.solve(both, value)
    return float(0.5 * (room + gain))


def weighed(differences: Sequence[Difference], comparisons: int) -> list[Difference]:
    """Give every difference its posterior probability.

    Before the data one of `comparisons` quantities is expected to differ, so each has prior odds of one to
    `comparisons`: looking at many is paid for once, here.
    """
    return [replace(d, probability=posterior(d.log_bayes_factor, comparisons)) for d in differences]


def posterior(log_bayes_factor: float, comparisons: int) -> float:
    """Return the probability of a difference at prior odds of one to `comparisons`."""
    return float(1.0 / (1.0 + np.exp(-np.clip(log_bayes_factor - np.log(comparisons), -700.0, 700.0))))
