"""A physical quantity as one recording shows it, and the decision whether two of them differ.

Both recordings are described by the same parameters, so that rate, length and motion need not agree. Whether
a parameter differs is a choice between two models: one value for both recordings, or a difference drawn from
normal priors of a stated size and of parts of it, down to a thousandth: with the largest one alone, data that
plainly speak for a small difference would speak against any (Lindley, Biometrika 44, 1957). The Bayes factor
of the two is in closed form (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995, eq. 1, with normal densities).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.bayes_factor import SIZES
from stillcal.calib_core.diagnosis.inference.likelihood import log_sum
from stillcal.calib_core.diagnosis.model.measurement import NINE_IN_TEN
from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.diagnosis.model.settings import CERTAIN, CERTAIN_NATS, MODELLED

Relation = Literal["lacking", "too_small", "too_large", "superfluous"]

TIMES = float(np.log(3.0))
"""Prior size of the logarithm of how far a simulation may be off: a factor of three, as datasheets and parts
are."""

EVEN = 0.5
"""Posterior probability of any difference from which there is no agreement."""

NONE_BEYOND = 0.01
"""Probability of a value as far from nothing, if nothing is there, below which a recording has an effect."""

NO_DOUBT = 1e-6
"""The same of a value that is less than a tenth of the other's: intervals know of the noise, and not of all
that a model leaves out."""

INFORMED = 0.5
"""Part of the prior's size that a standard deviation must be below, for a recording to show a parameter."""

MOST_SIGMA, FINE = 60.0, 3001
"""Standard deviations of a difference that are tried, and how many of them: to 0.02."""

HUNDREDFOLD = float(np.log(100.0))
"""Logarithm of a ratio from which the smaller of two positive quantities is as good as absent."""


Key = tuple[str, str]
"""Effect and sensor."""


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
    what was measured is as good as nothing, of which the values are the logarithms of the limit. error: of
    the number itself where that may be nothing, 0 elsewhere. counted: of how many it is a share, or 0.
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
    error: float = 0.0
    counted: int = 0
    axes: tuple[int, ...] = ()

    @property
    def sigma(self) -> Array:
        """Standard deviations (k,) of the values."""
        return np.asarray(np.sqrt(np.maximum(self.covariance.diagonal(), 0.0)))

    @property
    def informed(self) -> NDArray[np.bool_]:
        """Which of the numbers (k,) the recording shows clearly better than the prior does."""
        return np.asarray(self.sigma < INFORMED * self.size)

    def shows(self, chance: float = NONE_BEYOND) -> bool:
        """Whether the recording shows a value that is not nothing (chi-squared of all its numbers).

        chance: of a value as far from nothing if nothing is there, below which it is something.
        """
        if self.logarithmic:
            return True
        from scipy.special import chdtrc  # noqa: PLC0415 - scipy is loaded when something is computed

        whole = self.covariance + np.diag(self.tolerance**2)
        return bool(chdtrc(self.value.size, self.value @ np.linalg.solve(whole, self.value)) < chance)


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """Recorded less simulated. value: (k,); covariance: (k, k).

    log_bayes_factor: nats for a difference; of_usual_size: for one as large as a simulation may be off.
    probability: of a difference; agrees: whether one of the usual size is none, and a smaller one not likely.
    """

    recorded: Quantity
    simulated: Quantity
    value: Array
    covariance: Array
    log_bayes_factor: float
    of_usual_size: float
    probability: float = 0.0
    agrees: bool = False

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
        apart = np.hypot(self.recorded.tolerance, 1e-9 * self.recorded.size)
        weight = np.linalg.inv(self.covariance + np.diag(apart**2))
        sizes = [float(q.value @ weight @ q.value) for q in (self.recorded, self.simulated)]
        # Beside a value ten times as large, a small one is something only where there is no doubt of it.
        minor = [own < MODELLED**2 * other for own, other in (sizes, sizes[::-1])]
        sure = [NO_DOUBT if small else NONE_BEYOND for small in minor]
        if not self.simulated.shows(sure[1]):
            return "lacking"
        if not self.recorded.shows(sure[0]):
            return "superfluous"
        return "too_small" if sizes[1] < sizes[0] else "too_large"

    def visible_from(self, comparisons: int) -> Array:
        """Return the differences (k,), each by itself, that would be stated nine times in ten.

        With one number, the Bayes factor of a difference of z standard deviations is the mean over sizes s of
        exp(z^2 shrunk / 2) / sqrt(1 + s^2 / c), with variance c.
        """
        variance = self.covariance.diagonal() + self.recorded.tolerance**2
        ratio = (self.recorded.size[:, None] * SIZES) ** 2 / variance[:, None]
        needed = CERTAIN_NATS + np.log(comparisons)
        tried = np.linspace(0.0, MOST_SIGMA, FINE)
        shrunk = 0.5 * tried**2 * (ratio / (1.0 + ratio))[:, :, None] - 0.5 * np.log1p(ratio)[:, :, None]
        seen = np.logaddexp.reduce(shrunk, axis=1) - np.log(SIZES.size) >= needed
        z = np.where(seen.any(axis=1), tried[seen.argmax(axis=1)], np.inf)
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
    covariance = _beside(recorded, simulated) + _beside(simulated, recorded)
    noise = covariance + np.diag(recorded.tolerance**2)
    axes = [a for a in np.unique(recorded.axis_of) if a >= 0]
    single = [recorded.axis_of == a for a in axes] if len(axes) > 1 else []
    cases = np.array([np.ones(value.size), *single])
    prior = np.array([0.5, *(0.5 / len(single) for _ in single)]) if single else np.ones(1)
    factors = _log_bayes_factors(value, noise, recorded.size * cases) + np.log(prior)[:, None]
    mixed = log_sum(factors) - float(np.log(SIZES.size))
    return Difference(recorded, simulated, value, covariance, mixed, log_sum(factors[:, 0]))


def _beside(own: Quantity, other: Quantity) -> Array:
    """Return the covariance (k, k) of a quantity beside another recording's.

    Nothing has no logarithm. How far what may be nothing is below the other's number goes by the error of the
    number itself, and by what chance makes of a count half as far up.
    """
    if not own.error or bool((own.value >= other.value).any()):
        return own.covariance
    apart = np.exp(other.value) - np.exp(own.value)
    chance = apart / (2.0 * own.counted) if own.counted else 0.0
    return np.diag((own.error**2 + chance) * ((other.value - own.value) / apart) ** 2)


def _log_bayes_factors(value: Array, noise: Array, sizes: Array) -> Array:
    """Return log of N(value; 0, noise + s^2) / N(value; 0, noise) (c, p); s: p `SIZES` of c sizes."""
    scaled = SIZES[:, None] * sizes[:, None, :]
    both = noise + scaled[..., None] ** 2 * np.eye(value.size)
    room = np.linalg.slogdet(noise)[1] - np.linalg.slogdet(both)[1]
    solved = np.linalg.solve(both, np.broadcast_to(value[:, None], (*both.shape[:-1], 1)))[..., 0]
    return np.asarray(0.5 * (room + value @ np.linalg.solve(noise, value) - solved @ value))


def weighed(differences: Sequence[Difference], comparisons: int) -> list[Difference]:
    """Give every difference its posterior probability.

    Before the data one of `comparisons` quantities is expected to differ, so each has prior odds of one to
    `comparisons`: looking at many is paid for once, here.
    """
    return [_weighed(d, comparisons) for d in differences]


def _weighed(difference: Difference, comparisons: int) -> Difference:
    probability = posterior(difference.log_bayes_factor, comparisons)
    none = posterior(difference.of_usual_size, comparisons) <= 1.0 - CERTAIN
    return replace(difference, probability=probability, agrees=none and probability < EVEN)


def posterior(log_bayes_factor: float, comparisons: int) -> float:
    """Return the probability of a difference at prior odds of one to `comparisons`."""
    return float(1.0 / (1.0 + np.exp(-np.clip(log_bayes_factor - np.log(comparisons), -700.0, 700.0))))
