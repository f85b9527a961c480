"""Differences of two recordings as they are stated: what differs, by name, relation and axes; what agrees."""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from stillcal.calib_core.diagnosis.comparison.direct import named
from stillcal.calib_core.diagnosis.comparison.noise import white_noise
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Key, posterior
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy, NotCompared
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.records import AXES, Finding
from stillcal.calib_core.diagnosis.model.settings import CERTAIN

Sole = tuple[Finding, bool]
"""What one recording alone has, and whether it is the recording, not SIM."""


def concluded(
    compared: list[Difference],
    alone: list[Sole],
    missing: list[NotCompared],
    names: tuple[str, str],
    *,
    among: int,
    checks: int,
    had: Set[Key] = frozenset(),
) -> Comparison:
    """Return what differs, what agrees and what is undecided of all that was compared.

    compared: with their probabilities; alone: what one of the two alone has; missing: what could not be
    compared; names: of both. among: quantities of which one is expected to differ; checks: those that were
    possible; had: effects that one of the two was asked for.
    """
    judged = [(one, posterior(one[0].evidence.log_bayes_factor, max(among, 1))) for one in alone]
    sure = [(one, odds) for one, odds in judged if is_sure(one[0], odds)]
    unsure = [
        undecided_finding(finding, odds, f"{names[0] if of_recording else names[1]} does not")
        for (finding, of_recording), odds in judged
        if not is_sure(finding, odds)
    ]
    agreed = [d for d in compared if d.agrees and worth_telling(d, had)]
    hidden = [d for d in agreed if key_of(d) in had and _of_one_alone(d)]
    found = [
        *(discrepancy(d) for d in compared if differs(d)),
        *(sole_discrepancy(*one) for one in sure),
    ]
    evidence = [(_stated_as(d), d.log_bayes_factor) for d in compared]
    return Comparison(
        discrepancies=sorted(found, key=lambda d: -d.log_bayes_factor),
        agreed=with_unequal([d for d in agreed if d not in hidden]),
        compared=compared,
        not_compared=missing,
        undecided=[
            *(undecided(d, names) for d in compared if not d.agrees and not differs(d)),
            *(_perhaps_absent(d, names) for d in hidden),
            *unsure,
        ],
        comparisons=checks,
        evidence=[*evidence, *((f.effect, f.evidence.log_bayes_factor) for f, _ in alone)],
    )


def told(compared: list[Difference], alone: list[Sole], missing: list[NotCompared]) -> set[Key]:
    """Return of which effects and sensors something is said already."""
    keys = {*map(key_of, compared), *((n.effect, n.sensor) for n in missing)}
    return keys | {(finding.effect, finding.sensor) for finding, _ in alone}


def differs(difference: Difference) -> bool:
    """Whether it is sure that the two differ."""
    return difference.probability >= CERTAIN


def _stated_as(difference: Difference) -> str:
    """Return the effect that a difference is stated as, or what was compared."""
    return discrepancy(difference).effect if differs(difference) else difference.recorded.effect


def key_of(difference: Difference) -> Key:
    """Return the effect and the sensor of a difference."""
    return difference.recorded.effect, difference.recorded.sensor


def worth_telling(difference: Difference, had: Set[Key]) -> bool:
    """Whether agreement says something: a noise, or an effect that one of the two was found to have."""
    if difference.recorded.none and difference.simulated.none:
        return False
    return difference.recorded.logarithmic or key_of(difference) in had or difference.recorded.shows()


def _of_one_alone(difference: Difference) -> bool:
    """Whether one recording shows an effect and the other one does not.

    Their difference may be no larger than its error and agree with none: that says how little the other shows
    where its interval holds nothing as well.
    """
    return difference.recorded.shows() != difference.simulated.shows()


def _perhaps_absent(difference: Difference, names: tuple[str, str]) -> NotCompared:
    """Return an effect of one recording that the other may have as well as not."""
    has, other = names if difference.recorded.shows() else names[::-1]
    why = f"{other}: it does not tell whether it has it, as {has} does, or has none"
    return NotCompared(*key_of(difference), why, difference.probability)


def undecided(difference: Difference, names: tuple[str, str]) -> NotCompared:
    """Return what was compared with a probability that is neither a difference nor agreement."""
    probability = difference.probability
    seen = f"{names[0]} and {names[1]} do not decide it: probability of a difference {probability:.2f}"
    return NotCompared(*key_of(difference), seen, probability)


def discrepancy(difference: Difference) -> Discrepancy:
    """Return what both have and differs, by its name and its relation."""
    recorded, axes = difference.recorded, axes_of(difference)
    effect, relation = recorded.effect, difference.relation()
    where = (difference.simulated if relation == "superfluous" else recorded).where
    assert where is not None, "every quantity says where it was measured"
    if effect == white_noise.LEVEL and (unequal := white_noise.unequal(difference, axes)) is not None:
        effect, relation = white_noise.UNEQUAL, unequal
    return Discrepancy(
        effect,
        recorded.sensor,
        axes,
        where,
        relation,
        difference.probability,
        difference.log_bayes_factor,
        difference,
    )


def with_unequal(agreed: list[Difference]) -> list[Difference]:
    """Return what agrees, the imbalance of a noise whose densities do under its own name too."""
    return [*agreed, *(white_noise.named_unequal(d) for d in agreed if white_noise.alike_unequal(d))]


def axes_of(difference: Difference) -> list[str]:
    """Return the axes whose numbers differ beyond their errors and tolerance, at least the clearest one."""
    error = np.hypot(difference.sigma, difference.recorded.tolerance)
    strength = np.abs(difference.value) / np.maximum(error, 1e-300)
    owner = difference.recorded.axis_of
    if (owner < 0).all():
        return [AXES[a] for a in difference.recorded.axes]
    by_axis = [float(strength[owner == a].max(initial=0.0)) for a in range(3)]
    least = min(thresholds.AXIS_SIGMA, max(by_axis))
    return [AXES[a] for a in range(3) if by_axis[a] >= least]


def sole_discrepancy(sole: Sole, probability: float) -> Discrepancy:
    """Return what one recording alone has."""
    finding, of_recording = sole
    return Discrepancy(
        finding.effect,
        finding.sensor,
        named(finding),
        finding.where,
        "lacking" if of_recording else "superfluous",
        probability,
        finding.evidence.log_bayes_factor,
        None,
        finding if of_recording else None,
        None if of_recording else finding,
    )


def is_sure(finding: Finding, probability: float) -> bool:
    """Whether an effect is beyond doubt, and predicts the parts that were left out of the fit."""
    return probability >= CERTAIN and not finding.evidence.contradicted


def undecided_finding(finding: Finding, probability: float, who: str) -> NotCompared:
    """Return an effect that is not sure. who: the start of a sentence, "NAME does not"."""
    odds = "above 0.99" if probability >= 0.995 else f"{probability:.2f}"
    seen = f"{who} decide it: probability {odds}"
    if finding.evidence.contradicted or probability >= CERTAIN:
        why = (
            f"the fit suggests it (probability {odds}), but it does not predict the parts of the recording"
            " that were left out of the fit"
        )
        return NotCompared(finding.effect, finding.sensor, why)
    return NotCompared(finding.effect, finding.sensor, seen, probability)
