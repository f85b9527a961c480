"""What single samples, values and stamps show: how likely an effect is, and how it is stated.

An effect is a choice between two models of the same data: a sound phone, and one that has the effect. Each
function below returns the logarithm of their Bayes factor, in nats, by a likelihood that it states:

- `of_measured`: a number with a normal error, against what real phones commonly show (`sound_phones`);
- `of_counts`: successes among trials, binomial with a Beta prior;
- `of_chance`: something that a sound phone does with a known small chance, certain with the effect;
- `of_vector`: a vector with a normal error, against nothing;
- `of_fit`: a gain in log likelihood by fitted parameters, by Schwarz's approximation.

A finding needs a posterior probability of `STATED`, and, where parts of the recording were predicted from the
others, that they were predicted better with the effect than without.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.records import (
    AXES,
    Alternative,
    Evidence,
    Finding,
    Number,
    Parameter,
    Where,
)
from stillcal.calib_core.diagnosis.model.settings import DIRECT_CHECKS, STATED
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.maths.robust import MAD_TO_SD

Index = NDArray[np.int64]

FOLDS = 5
NORMAL_95 = 1.96
"""Half the width of a 95 % interval of a normal distribution, in standard deviations."""

NINE_IN_TEN = 1.2816
"""Standard deviations that nine tenths of a normal distribution lie above, below its mean."""


IN_TIME, TOGETHER, LEAST_TOGETHER = 40, 8, 5
"""Pieces of a recording in which hits are counted, neighbouring ones of which one mean is taken, and the
fewest such means that tell how these scatter."""

BY_CHANCE = 1.6
"""Times their error as independent pieces that five means of eight scatter by in one case of twenty: the root
of the 95th percentile of F with 4 and 39 degrees of freedom."""


@dataclass(frozen=True, slots=True)
class Measured:
    """A number with its standard error."""

    value: float
    error: float

    def beyond(self, low: float, high: float) -> float:
        """Return by how many standard errors the value is outside [low, high]; 0 inside."""
        excess = max(self.value - high, low - self.value, 0.0)
        return excess / max(self.error, 1e-300)

    def parameter(self, unit: str) -> Parameter:
        """Return value and 95 % interval."""
        half = NORMAL_95 * self.error
        return Parameter(self.value, [self.value - half, self.value + half], unit)

    def log(self, floor: float = 0.0) -> Measured:
        """Return the common logarithm of a value of 0 or more, plus `floor`, with its error."""
        shifted = max(self.value, 0.0) + floor
        return Measured(float(np.log10(shifted)), self.error / shifted / float(np.log(10.0)))


def mean_of(pieces: Array, floor: float = 0.0, known: float = 0.0) -> Measured:
    """Robust mean of independent pieces (n,) with a standard error from their scatter, `floor` at least.

    known: standard deviation of pieces in which nothing is wrong, where it is known: more than half of
    pieces that are rounded may be exactly alike.
    """
    middle = float(np.median(pieces))
    scatter = max(MAD_TO_SD * float(np.median(np.abs(pieces - middle))), known)
    keep = np.abs(pieces - middle) <= 4.0 * scatter + 1e-300
    kept = pieces[keep] if keep.sum() >= 3 else pieces
    error = float(kept.std(ddof=1)) / np.sqrt(kept.size) if kept.size > 1 else float("inf")
    return Measured(float(kept.mean()), max(error, floor))


def mean_in_time(pieces: Array, floor: float = 0.0, known: float = 0.0) -> Measured:
    """Return `mean_of` of pieces (n,) in the order of time, whose neighbours may be alike.

    What comes and goes says how well another time is foretold: pieces that are left out of the mean count for
    its error, and so does what goes up and down over many of them, where it does by more than chance.
    """
    mean, whole = mean_of(pieces, floor, known), pieces.size // TOGETHER
    if whole < LEAST_TOGETHER:
        return mean
    error = max(mean.error, float(pieces.std(ddof=1) / np.sqrt(pieces.size)))
    means = pieces[: whole * TOGETHER].reshape(whole, TOGETHER).mean(axis=1)
    over = float(means.std(ddof=1) / np.sqrt(whole))
    return Measured(mean.value, over if over > BY_CHANCE * error else error)


def share_of(hits: float, trials: float, alike: float = 1.0) -> Measured:
    """Return the share of successes with the standard deviation of its posterior, Beta(1/2, 1/2) before.

    alike: how many successes come together, so that so many fewer are independent.
    """
    a, b = hits / alike + 0.5, (trials - hits) / alike + 0.5
    mean = a / (a + b)
    return Measured(hits / max(trials, 1.0), float(np.sqrt(mean * (1.0 - mean) / (a + b + 1.0))))


def share_in_time(hits: Array, trials: float, alike: float = 1.0) -> Measured:
    """Return `share_of` hits (n,) in the order of time, which may come and go as in `mean_in_time`."""
    share = share_of(float(hits.sum()), trials, alike)
    if not hits.size:
        return share
    of_each = hits.size / max(trials, 1.0)
    pieces = np.array([of_each * float(p.mean()) for p in np.array_split(hits, min(IN_TIME, hits.size))])
    return Measured(share.value, max(share.error, mean_in_time(pieces).error))


def vector(values: Array, errors: Array, unit: str) -> Parameter:
    """Return values (k,) with 95 % intervals."""
    ci = np.stack([values - NORMAL_95 * errors, values + NORMAL_95 * errors], axis=1)
    return Parameter(values.tolist(), ci.tolist(), unit)


@dataclass(frozen=True, slots=True)
class HeldOut:
    """What parts of the recording say that took no part in the fit.

    gain: log score with the effect less without it, nats; before, after: rms of what is left there.
    """

    gain: float
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class DirectEvidence:
    """What speaks for a direct finding.

    log_bayes_factor: nats for the effect against a sound phone. held_out: None where nothing is predicted.
    unusual: how rare this is among real phones, as a sentence; "" where that is not known.
    """

    log_bayes_factor: float
    held_out: HeldOut | None = None
    unusual: str = ""

    @property
    def probability(self) -> float:
        """The posterior probability of the effect."""
        return posterior(self.log_bayes_factor)

    @property
    def stated(self) -> bool:
        """Whether this is enough for a finding."""
        return self.probability >= STATED and (self.held_out is None or self.held_out.gain > 0.0)


def posterior(log_bayes_factor: float) -> float:
    """Return the probability of an effect; before the data, one of `DIRECT_CHECKS` is expected."""
    return float(1.0 / (1.0 + np.exp(-np.clip(log_bayes_factor - np.log(DIRECT_CHECKS), -700.0, 700.0))))


def of_measured(measured: Measured, usual: Usual, held_out: HeldOut | None = None) -> DirectEvidence:
    """Compare a measured number, normal about the phone's own, with what sound phones show.

    Sound: the number is one of the population's (`Usual.log_sound`). Faulty: it is anywhere in the range in
    which faults are, with equal probability (`Usual.log_faulty`).
    """
    value, error = measured.value, max(measured.error, 1e-12)
    gain = usual.log_faulty(value, error) - usual.log_sound(value, error)
    return DirectEvidence(gain, held_out, usual.rarity(value))


def of_counts(hits: float, trials: float, sound: float) -> float:
    """Return nats for a share of successes above `sound`, uniform up to 1, against one of `sound` at most.

    Binomial counts; both shares have a uniform prior over their ranges, so that the marginal likelihoods are
    incomplete Beta functions (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995).
    """
    from scipy.special import betainc  # noqa: PLC0415 - the daemon stays light

    a, b = hits + 1.0, trials - hits + 1.0
    below = float(betainc(a, b, sound))
    above = float(betainc(b, a, 1.0 - sound))
    low = np.log(below) if below > 1e-290 else _log_tail(a, b, sound)
    return float(np.log(max(above, 1e-300)) - np.log1p(-sound) - low + np.log(sound))


def _log_tail(a: float, b: float, x: float) -> float:
    """Return the logarithm of the regularised incomplete Beta function far in its lower tail (first term)."""
    from scipy.special import betaln  # noqa: PLC0415 - the daemon stays light

    return float(a * np.log(x) + b * np.log1p(-x) - np.log(a) - betaln(a, b))


def of_vector(value: Array, covariance: Array, size: float) -> float:
    """Return nats for a vector (k,) of prior standard deviation `size` on each axis, against nothing.

    Normal densities: log N(value; 0, covariance + size^2) - log N(value; 0, covariance).
    """
    both = covariance + size**2 * np.eye(value.size)
    room = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(both)[1]
    return float(
        0.5 * (room + value @ np.linalg.solve(covariance, value) - value @ np.linalg.solve(both, value))
    )


def of_chance(log_chance: float, tries: float = 1.0) -> float:
    """Return nats for what the effect makes certain and a sound phone does with chance exp(log_chance).

    tries: in how many places or ways it was looked for; the effect is in one of them.
    """
    return -log_chance - float(np.log(tries))


def of_fit(gain: float, parameters: float, pieces: float, tries: float = 1.0) -> float:
    """Return nats for a fitted effect: its gain in log likelihood less parameters / 2 ln(pieces).

    Schwarz's approximation to the Bayes factor (Ann. Statist. 6, 1978). tries: places it was looked for in.
    """
    return gain - 0.5 * parameters * float(np.log(max(pieces, 2.0))) - float(np.log(tries))


def direct_finding(
    effect: str,
    sensor: str,
    axes: Sequence[int],
    where: Where,
    parameters: dict[str, Parameter],
    *,
    statement: str,
    seen: DirectEvidence,
    alternatives: Sequence[Alternative] = (),
) -> Finding | None:
    """Build a finding of a direct measurement; None where the evidence does not carry it."""
    if not seen.stated:
        return None
    held = seen.held_out
    evidence = (
        Evidence(seen.log_bayes_factor)
        if held is None
        else Evidence(seen.log_bayes_factor, held.before, held.after, held.gain, folds=FOLDS)
    )
    names = [AXES[a] for a in axes]
    said = f"{statement} {seen.unusual}".strip()
    return Finding(effect, sensor, names, where, parameters, evidence, list(alternatives), said)


def sized(sizes: Mapping[str, tuple[Number, str]]) -> dict[str, Parameter]:
    """Return parameters without an interval, from numbers with their units."""
    return {name: Parameter(value, None, unit) for name, (value, unit) in sizes.items()}


__all__ = [
    "FOLDS",
    "DirectEvidence",
    "HeldOut",
    "Index",
    "Measured",
    "direct_finding",
    "mean_of",
    "of_chance",
    "of_counts",
    "of_fit",
    "of_measured",
    "of_vector",
    "posterior",
    "share_of",
    "sized",
    "vector",
]  # fmt: skip
