"""What one of two sensors on one motion has and the other has not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import MOTION, OF_TURNS
from stillcal.calib_core.diagnosis.comparison.ideal import compare_with_ideal
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Alignment
from stillcal.calib_core.diagnosis.comparison.pair.measured import (
    Alone,
    each_alone,
    measured_in_pair,
    none_of,
    taken_out,
)
from stillcal.calib_core.diagnosis.comparison.pair.search import examined_in_pair
from stillcal.calib_core.diagnosis.comparison.quantity import (
    Difference,
    Quantity,
    posterior,
    subtract,
    weighed,
)
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy, NotCompared
from stillcal.calib_core.diagnosis.comparison.stated import axes_of
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Alternative
from stillcal.calib_core.diagnosis.model.settings import CERTAIN, CERTAIN_NATS
from stillcal.calib_core.diagnosis.slow.statement import Stated

UNTOLD = "Rests in more attitudes decide it."
NOT_SOUGHT = "it is not looked for in a pair"


def compare_in_pair(exam: Examination, motion: Alignment | None = None) -> Comparison:
    """Return what the recording has and the other sensor has not. exam: from `examined_in_pair`.

    motion: what the two differ by in motion; without it (a witness) that, and bias, scale and misalignment of
    one against the other, are a matter of mounting.
    """
    found = compare_with_ideal(exam, samples=motion is None)
    found = _only_sought(found, motion, gyroscope=exam.gyroscope is not None)
    measured = [measured_in_pair(exam, residuals) for residuals in exam.sensors]
    constants = [q for of_one, _ in measured for q in of_one]
    constants += [] if motion is None else motion.quantities
    by_key = {(q.effect, q.sensor): subtract(q, none_of(q)) for q in constants}
    by_finding = {id(f): subtract(q, none_of(q)) for _, effects in measured for f, q in effects}
    out = [
        _sized(d, by_finding.get(id(d.recorded), by_key.get((d.effect, d.sensor))))
        for d in found.discrepancies
        if d.effect != "unknown"
    ]
    out += [d for d in found.discrepancies if d.effect == "unknown"]
    if motion is None:
        return replace(found, discrepancies=out)
    pairs = [d for (effect, _), d in by_key.items() if effect.endswith(("_bias", "_scale"))]
    count = found.comparisons + len(pairs)
    pairs = weighed(pairs, max(count, 1))
    pairs, stated = _constants(pairs, exam, count)
    out += stated
    return replace(
        found,
        discrepancies=sorted(out, key=lambda d: -d.log_bayes_factor),
        compared=pairs,
        comparisons=count,
        evidence=[*found.evidence, *((d.recorded.effect, d.log_bayes_factor) for d in pairs)],
    )


def _only_sought(found: Comparison, motion: Alignment | None, *, gyroscope: bool) -> Comparison:
    """Leave out what is not looked for in a pair: what motion shows where there is too little of it."""
    known = {(n.effect, n.sensor): n.reason for n in found.not_compared}
    of_turns = [(effect, "gyro") for effect in OF_TURNS if effect != "gyro_scale"] if gyroscope else []
    count = found.comparisons + len(known)
    if motion is None:
        reasons = known | dict.fromkeys(of_turns, NOT_SOUGHT)
        count -= len(reasons)
    else:
        still = "it moves too little in most of the recording" if gyroscope else "no gyroscope"
        every = [*of_turns, *MOTION]
        reasons = {key: why for key, why in known.items() if key not in every}
        missing = {key: known.get(key, still) for key in every if key not in motion.sought}
        missing |= motion.hidden
        count += len(MOTION) - len(reasons | missing)
        reasons |= missing
    return replace(
        found, not_compared=[NotCompared(*key, why) for key, why in reasons.items()], comparisons=count
    )


def without_found(
    exam: Examination, found: Comparison, direct: Sequence[Stated], motion: Alignment | None = None
) -> Comparison:
    """Take what was found out of the difference of readings, by its equations, and judge what is left.

    direct: what is stated besides; motion: what the corrected simulation differs by in motion.
    """
    told = {(d.effect, d.sensor): d.difference.value for d in found.discrepancies if d.difference}
    sensors = [taken_out(exam, residuals, told) for residuals in exam.sensors]
    after = examined_in_pair(exam, exam.bins, sensors, direct)
    return compare_in_pair(after, motion)


def without_equation(found: Comparison) -> list[str]:
    """Return the effects that no equation takes out of the difference of readings."""
    return [d.effect for d in found.discrepancies if d.difference is None]


def _sized(found: Discrepancy, difference: Difference | None) -> Discrepancy:
    return found if difference is None else replace(found, difference=difference)


def _constants(
    pairs: Sequence[Difference], exam: Examination, count: int
) -> tuple[list[Difference], list[Discrepancy]]:
    """Return the differences of bias and scale as they are known, and those of them that are stated."""
    known, stated = list[Difference](), list[Discrepancy]()
    for residuals in exam.sensors:
        own = [d for d in pairs if d.recorded.sensor == residuals.sensor]
        said = _of_sensor(own, each_alone(exam, residuals), count)
        differences = {d.effect: d.difference for d in said}
        known += [differences.get(d.recorded.effect) or d for d in own]
        stated += said
    return known, stated


def _of_sensor(own: Sequence[Difference], alone: Sequence[Alone], count: int) -> list[Discrepancy]:
    """Return what is stated of a sensor's bias and scale.

    Where one of them is sure and the other is not, it is as it is alone, for it alone is put right. As unsure
    as it is that the other is alike, its error is that of both.
    """
    sure = [d for d in own if d.probability >= CERTAIN]
    if not sure:
        return _of_either(alone, count)
    (first,) = (one for one in alone if one.quantity.effect == sure[0].recorded.effect)
    if len(sure) == 1:
        alone_or_not = _as_unsure(first, sure[0].recorded)
        sure = [replace(_apart(alone_or_not, first.nats), probability=sure[0].probability)]
    return [_of_constant(d) for d in sure]


def _as_unsure(alone: Alone, beside: Quantity) -> Quantity:
    """Return a constant as it is alone, with the variance about that of what it may be beside the other.

    Each of the two models counts by its probability (Hoeting et al., Statistical Science 14, 1999, eq. 3).
    """
    own, off = alone.quantity, beside.value - alone.quantity.value
    part = posterior(alone.both - alone.nats, 1)
    mixed = (1.0 - part) * own.covariance + part * (beside.covariance + np.outer(off, off))
    return replace(own, covariance=mixed)


def _of_either(alone: Sequence[Alone], count: int) -> list[Discrepancy]:
    """State that bias or scale differs, where that is sure though neither is sure beside the other.

    It has the name of the one that fits better. Where they fit alike it is a bias, which is simpler, and that
    is said.
    """
    nats = [one.nats for one in alone]
    either = float(np.logaddexp.reduce(nats)) - float(np.log(len(nats)))
    if posterior(either, max(count, 1)) < CERTAIN:
        return []
    bias, scale = alone
    untold = abs(bias.fit - scale.fit) < CERTAIN_NATS
    first = bias if untold or bias.fit > scale.fit else scale
    stated = _of_constant(*weighed([_apart(first.quantity, either)], max(count, 1)))
    if not untold:
        return [stated]
    beside = Alternative(scale.quantity.effect, scale.nats, True)
    return [replace(stated, alternatives=(beside,), note=UNTOLD)]


def _apart(quantity: Quantity, nats: float) -> Difference:
    return replace(subtract(quantity, none_of(quantity)), log_bayes_factor=nats)


def _of_constant(difference: Difference) -> Discrepancy:
    one = difference.recorded
    assert one.where is not None, "constants say where they were measured"
    return Discrepancy(one.effect, one.sensor, axes_of(difference), one.where, "lacking",
                       difference.probability, difference.log_bayes_factor, difference)  # fmt: skip
