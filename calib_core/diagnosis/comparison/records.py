"""What a comparison says: what differs, what agrees, what cannot be compared and why."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import Smallest
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Quantity, Relation
from stillcal.calib_core.diagnosis.model.records import Alternative, Departure, Finding, Where
from stillcal.calib_core.diagnosis.model.settings import CERTAIN, STATEMENTS_TRUE

Verdict = Literal["match", "identified", "partly_identified", "unidentified", "not_judged"]
LEAST_JUDGED = 1.0 / 3.0
"""Part of the checks that must have been possible for a verdict."""

LEVEL = 0.01
"""p below which a simulation is rejected."""


@dataclass(frozen=True, slots=True, eq=False)
class Discrepancy:
    """One thing that differs. difference: None where only one of the two has the effect at all.

    probability: of a difference, against none; log_bayes_factor: nats for it. recorded, simulated: a single
    recording's finding where it comes from one. note: what was assumed, a sentence, "" for nothing.
    put_right: of exchanged axes, whose they are and that all else was compared without, "" if it was not.
    of_either: whether it is not known which of the two has it; the relation is then as if the recording had.
    alternatives: what else the two may differ by, beside those of a single recording's finding.
    """

    effect: str
    sensor: str
    axes: list[str]
    where: Where
    relation: Relation
    probability: float
    log_bayes_factor: float
    difference: Difference | None = None
    recorded: Finding | None = None
    simulated: Finding | None = None
    note: str = ""
    put_right: str = ""
    of_either: bool = False
    alternatives: tuple[Alternative, ...] = ()

    @property
    def true(self) -> float:
        """Probability that the statement is true: that there is a difference, and that this is what it is."""
        return STATEMENTS_TRUE * self.probability

    @property
    def departure(self) -> Departure | None:
        """How the effect departs from the form of its name, where one of the two alone has it."""
        own = self.recorded or self.simulated
        return None if own is None else own.departure

    @property
    def is_identified(self) -> bool:
        """Whether it has a name beyond doubt, and the form that the name gives."""
        return self.effect != "unknown" and self.probability >= CERTAIN and self.departure is None


@dataclass(frozen=True, slots=True)
class NotCompared:
    """An effect that could not be compared, and why. probability: of a difference that was not decided."""

    effect: str
    sensor: str
    reason: str
    probability: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Common:
    """What an ideal sensor does not do and sound phones do. note: how many of them do as much."""

    quantity: Quantity
    note: str


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """The whole answer. comparisons: how many effects and constants were compared.

    evidence: of all that was looked for, the effect and the log Bayes factor for a difference. undecided:
    compared, with a probability that is neither a difference nor agreement. smallest: how small a difference
    would have been seen. common: what is no difference because sound phones do it too.
    """

    discrepancies: list[Discrepancy] = field(default_factory=list)
    agreed: list[Difference] = field(default_factory=list)
    compared: list[Difference] = field(default_factory=list)
    not_compared: list[NotCompared] = field(default_factory=list)
    undecided: list[NotCompared] = field(default_factory=list)
    comparisons: int = 0
    evidence: list[tuple[str, float]] = field(default_factory=list)
    smallest: list[Smallest] = field(default_factory=list)
    common: list[Common] = field(default_factory=list)

    def and_of(self, other: Comparison) -> Comparison:
        """Return this comparison and another one, of other effects, as one."""
        found = sorted([*self.discrepancies, *other.discrepancies], key=lambda d: -d.log_bayes_factor)
        return Comparison(
            found,
            [*self.agreed, *other.agreed],
            [*self.compared, *other.compared],
            [*self.not_compared, *other.not_compared],
            [*self.undecided, *other.undecided],
            self.comparisons + other.comparisons,
            [*self.evidence, *other.evidence],
            [*self.smallest, *other.smallest],
            [*self.common, *other.common],
        )

    def on_some_axes(self) -> list[NotCompared]:
        """Return what was looked for on some axes and does not show on the others, and found on none.

        It does not show on an axis if none of its parameters does.
        """
        hidden: dict[tuple[str, str], set[str]] = {}
        for row in self.smallest:
            hidden.setdefault((row.effect, row.sensor), set(row.hidden)).intersection_update(row.hidden)
        told = {(d.effect, d.sensor) for d in self.discrepancies}
        return [
            NotCompared(
                *key, f"not on {' or '.join(sorted(axes))}: the attitudes and turns do not show it there"
            )
            for key, axes in hidden.items()
            if axes and key not in told
        ]

    def p(self, left_out: Collection[str] = ()) -> float:
        """Return a bound of p of no difference at all. left_out: effects that do not count."""
        return p_of([nats for effect, nats in self.evidence if effect not in left_out])

    def verdict(self, p_after: float | None) -> Verdict:
        """Return the verdict.

        p_after: p of the corrected simulation being like the recording, None where it could not be played.
        """
        checks = self.comparisons + len(self.not_compared)
        if self.comparisons < LEAST_JUDGED * checks:
            return "not_judged"
        if not self.discrepancies:
            return "match"
        if all(d.is_identified for d in self.discrepancies) and p_after is not None and p_after >= LEVEL:
            return "identified"
        named = any(d.effect != "unknown" and d.probability >= CERTAIN for d in self.discrepancies)
        return "partly_identified" if named else "unidentified"


def p_of(log_bayes_factors: Sequence[float]) -> float:
    """Return p of no difference at all: the inverse of the mean Bayes factor, at most 1.

    Under that hypothesis each Bayes factor has expectation one, hence their mean; by Markov's inequality it
    exceeds k with probability 1 / k at most (Vovk and Wang, Ann. Statist. 49, 2021, e-values).
    """
    if not log_bayes_factors:
        return 1.0
    mean = float(np.logaddexp.reduce(np.asarray(log_bayes_factors))) - float(np.log(len(log_bayes_factors)))
    return float(np.exp(-np.clip(mean, 0.0, 690.0)))
