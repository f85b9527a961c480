"""How a simulation of the same motion stands to the recording: what it has by itself of what they differ by.

The difference of the readings says by how much the two differ, and not which of them has the effect. The
simulation's own rests and turns say what it has; the recording has that and the difference. Where those do
not show it, the recording's own are asked as well: what neither shows may be of either. Something without a
name is the one's whose own rests hold its course, else it may be of either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.coverage.assumed_drivers import warmed
from stillcal.calib_core.diagnosis.comparison.direct import delay_quantity
from stillcal.calib_core.diagnosis.comparison.linear.quantities import every_linear_quantity
from stillcal.calib_core.diagnosis.comparison.linear.wanted import Wanted, kind_of, settled, wanted_of
from stillcal.calib_core.diagnosis.comparison.pair.turns import Arm
from stillcal.calib_core.diagnosis.comparison.pair.vote import shares_alone
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Quantity
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy
from stillcal.calib_core.diagnosis.comparison.stated import differs, undecided, worth_telling
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.bayes_factor import log_bayes_factor
from stillcal.calib_core.diagnosis.inference.likelihood import reduce_residuals
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import Finding, Parameter
from stillcal.calib_core.diagnosis.model.settings import CERTAIN, CERTAIN_NATS
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.wander import NO_DRIVER, WALK, log_evidence

PAIRS = ((0, 1), (0, 2), (1, 2))
"""The axes of an accelerometer's three misalignments by rests, which tell no turn of all axes."""


def with_own_of_simulation(
    found: Comparison, exam: Examination, alone: tuple[Examination, Examination], names: tuple[str, str]
) -> Comparison:
    """Return a comparison that says of each difference what the simulation has of it by itself.

    Of bias and scale it also says which agree, and which are undecided. exam: of the pair; alone: of the
    recording and of the simulation by themselves, not searched; names: of both.
    """
    recorded, simulated = alone
    wanted = [*wanted_of(exam), *_at_moments(exam), *_of_turns(found)]
    no_thermometer = simulated.bins.temperature is None and exam.bins.temperature is not None
    simulated = warmed(simulated, exam.bins) if no_thermometer and len(simulated.bins) else simulated
    differences = [d.difference for d in found.discrepancies if d.difference is not None]
    later = {d.recorded.sensor for d in differences if d.recorded.reference.get(SETTLED)}
    wanted = [settled(w) if w.hypothesis.effect.sensor in later else w for w in wanted]
    at = _references(differences)
    sides = (simulated, recorded)
    own, others = ([*every_linear_quantity(e, wanted, at), *delay_quantity(e).values()] for e in sides)
    turned = any(d.effect == "accel_scale" for d in found.discrepancies)
    unsure = [undecided(d, names) for d in found.compared if not d.agrees and not differs(d)]
    return replace(
        found,
        discrepancies=[_standing(d, own, others, turned=turned) for d in found.discrepancies],
        agreed=[*found.agreed, *_agreed(found, own)],
        undecided=[*found.undecided, *unsure],
    )


def with_owner_of_unknown(
    found: Comparison, exam: Examination, recorded: Examination, simulated: Examination
) -> Comparison:
    """Return a comparison that says whose wander and what has no name are, or that this is not known.

    exam: of the pair; recorded, simulated: of each of the two by itself, not searched. The course that was
    found in the pair is the one's whose own rests hold it, and wander the one's whose own rests wander.
    """
    stated = {id(s.finding): s for s in exam.statements}
    out = []
    for one in found.discrepancies:
        if one.effect == "unknown" or one.effect.endswith(WALK):
            said = stated.get(id(one.recorded))
            beside = [s for s in exam.statements if s is not said]
            alone = [0.0 if said is None else _shown_at_rest(said, beside, e) for e in (recorded, simulated)]
            one = _owned(one, said, np.array(alone))  # noqa: PLW2901 - it is the same difference
        elif one.effect == Arm.name:
            has, had = (_stated(alone, one.effect) for alone in (recorded, simulated))
            if had is not None:
                one = _of_simulation(one) if has is None else _of_both(one, had)  # noqa: PLW2901 - as above
            elif has is None:
                one = replace(one, of_either=True)  # noqa: PLW2901 - as above
        out.append(one)
    return replace(found, discrepancies=out)


def _stated(alone: Examination, effect: str) -> Finding | None:
    """Return what one recording by itself states of an effect."""
    return next((s.finding for s in alone.statements if s.finding.effect == effect), None)


def _of_both(one: Discrepancy, had: Finding) -> Discrepancy:
    """Return a difference beside what the simulation itself states: the recording has both together."""
    apart = one.difference
    assert apart is not None, "an arm is measured"
    size = had.parameters[apart.recorded.parts[0].name]
    ends = np.asarray(size.value if size.ci95 is None else size.ci95, dtype=np.float64).reshape(3, -1)
    own = np.diag((np.ptp(ends, axis=1) / (2.0 * NORMAL_95)) ** 2)
    simulated = replace(apart.recorded, value=np.asarray(size.value, dtype=np.float64), covariance=own)
    value, covariance = simulated.value + apart.value, own + apart.covariance
    whole = replace(
        apart, recorded=replace(apart.recorded, value=value, covariance=covariance), simulated=simulated
    )
    return replace(one, relation=whole.relation(), difference=whole)


def _of_simulation(one: Discrepancy) -> Discrepancy:
    """Return a difference as what the simulation has and the recording has not."""
    apart = one.difference
    assert apart is not None, "an arm is measured"
    had = replace(apart.recorded, value=-apart.value, covariance=apart.covariance)
    none = replace(apart.recorded, value=np.zeros_like(apart.value))
    return replace(one, relation="superfluous", difference=replace(apart, recorded=none, simulated=had))


def _owned(one: Discrepancy, said: Stated | None, alone: Array) -> Discrepancy:
    """Return a difference without a name as the recording's, the simulation's, or that of either.

    alone: (2,) nats, how much the rests of each speak for it.
    """
    both_hold_it = bool((alone > CERTAIN_NATS).all())
    of_recording, of_simulation = shares_alone(alone)
    if both_hold_it or of_simulation < CERTAIN:
        sure = of_recording >= CERTAIN and not both_hold_it
        return one if sure else replace(one, of_either=True)
    assert said is not None, "rests speak for what has a course"
    had = _turned_about(said)
    return replace(one, relation="superfluous", recorded=None, simulated=had)


def _shown_at_rest(said: Stated, beside: Sequence[Stated], alone: Examination) -> float:
    """Return how much the rests of one recording by itself speak for what a pair shows, nats; at least 0."""
    residuals = next((s for s in alone.sensors if s.sensor == said.finding.sensor), None)
    if residuals is None or len(residuals.bins) < thresholds.LEAST_BINS:
        return 0.0
    if said.finding.effect.endswith(WALK) or said.finding.where.driver == NO_DRIVER:
        return max(log_evidence(residuals, reduce_residuals(residuals)), 0.0)
    if said.hypothesis is None or said.residuals is None:
        return 0.0
    own = _read_at(residuals, said.hypothesis, said.residuals)
    if not any(columns.any() for columns in own.columns):
        return 0.0
    others = [
        _read_at(residuals, s.hypothesis, s.residuals)
        for s in beside
        if s.hypothesis is not None and s.residuals is said.residuals
    ]
    return max(log_bayes_factor(reduce_residuals(residuals, [own], others, parts=True), 1, 1.0), 0.0)


def _read_at(residuals: SensorResiduals, hypothesis: Hypothesis, pair: SensorResiduals) -> Hypothesis:
    """Return a hypothesis of a pair's bins as the same course in one recording's rests, at their moments."""
    t, known = residuals.bins.t, pair.bins.t
    per_axis = [np.array([np.interp(t, known, c) for c in columns[0].T]) for columns in hypothesis.columns]
    response = np.moveaxis(np.stack(per_axis, axis=2), 0, 2)
    return replace(hypothesis, columns=residuals.columns_of(response, hypothesis.effect.blind))


def _turned_about(said: Stated) -> Finding:
    """Return what the recording shows against the simulation as what the simulation has: its negative."""
    if said.hypothesis is None:  # a size, which has no sign
        return said.finding
    linear = {p.name for p in said.hypothesis.effect.parameters}
    own = {name: _negative(p) if name in linear else p for name, p in said.finding.parameters.items()}
    return replace(said.finding, parameters=own)


def _negative(one: Parameter) -> Parameter:
    ends = None if one.ci95 is None else (-np.asarray(one.ci95, dtype=np.float64))[..., ::-1].tolist()
    return Parameter((-np.asarray(one.value, dtype=np.float64)).tolist(), ends, one.unit)


def _at_moments(exam: Examination) -> list[Wanted]:
    """Return the effects that came at a moment, as steps do: a simulation of the motion may have the same."""
    return [
        Wanted(kind_of(s.residuals), s.hypothesis, s.hypothesis.grid)
        for s in exam.statements
        if s.hypothesis is not None
        and s.residuals is not None
        and s.hypothesis.effect.recurs
        and s.hypothesis.effect.name != "unknown"
    ]


def _of_turns(found: Comparison) -> list[Wanted]:
    """Return the effects that turns show, to be measured in the turns of the simulation."""
    said = {(d.effect, d.sensor): d.difference.value.size for d in found.discrepancies if d.difference}
    return [
        Wanted("turn", Hypothesis(e, {}, ()), {})
        for e in effects_of("gyro", in_turns=True)
        if said.get(e.key) == sum(p.count for p in e.parameters)
    ]


def _references(differences: Sequence[Difference]) -> dict[str, float]:
    """Return, by sensor, the degC at which bias and scale of a pair are stated."""
    at = "temperature_c"
    return {d.recorded.sensor: d.recorded.reference[at] for d in differences if at in d.recorded.reference}


def _agreed(found: Comparison, own: Sequence[Quantity]) -> list[Difference]:
    """Return the constants of which the two agree, as both have them where the simulation shows them."""
    alike = [(d, _own_of(d, own)) for d in found.compared if d.agrees]
    both = [_with_own(apart, had) for apart, had in alike if had is not None]
    return [d for d in both if worth_telling(d, frozenset())]


def _with_own(apart: Difference, had: Quantity) -> Difference:
    """Return a difference beside what the simulation itself has."""
    more = replace(had, value=had.value + apart.value, covariance=had.covariance + apart.covariance)
    return replace(apart, recorded=more, simulated=had)


def _own_of(apart: Difference, own: Sequence[Quantity]) -> Quantity | None:
    """Return what the simulation's own rests and turns show of a difference, laid out as that; or None."""
    simulated = next((q for q in reversed(own) if _identity(q) == _identity(apart.recorded)), None)
    if simulated is None:
        return None
    laid = _laid(simulated.value.size, apart.value.size)
    return replace(
        apart.recorded, value=laid @ simulated.value, covariance=laid @ simulated.covariance @ laid.T
    )


def _standing(
    one: Discrepancy, own: Sequence[Quantity], others: Sequence[Quantity], *, turned: bool
) -> Discrepancy:
    """Return a difference beside what the simulation itself has, if it has anything.

    own, others: what the simulation's and the recording's own rests and turns show. turned: whether the
    simulation's accelerometer has axes of its own, by which its gyroscope is measured.
    """
    apart = one.difference
    if apart is None:
        return one
    had = _own_of(apart, own)
    if had is None or not had.shows():
        # Every sensor has a bias and a scale: a difference of those is of both, whoever is asked. Whose an
        # arm is, what each states by itself tells.
        told_otherwise = one.effect in (f"{one.sensor}_bias", f"{one.sensor}_scale", Arm.name)
        return one if told_otherwise else _of_whom(one, _own_of(apart, others), had)
    value = had.value
    both = _scaled(value, apart.value) if one.effect.endswith("_scale") else value + apart.value
    more = replace(had, value=both, covariance=had.covariance + apart.covariance)
    symmetric = one.effect == "accel_scale" or (turned and one.effect == "gyro_scale")
    if symmetric and not _without_turn(more).shows():
        # The recording has none of what is sure, so the turn of all axes besides is the simulation's too.
        return _of_simulation(one)
    whole = replace(apart, recorded=more, simulated=had, value=both - value)
    return replace(one, relation=whole.relation(), difference=whole)


def _of_whom(one: Discrepancy, recorded: Quantity | None, simulated: Quantity | None) -> Discrepancy:
    """Return a difference of which the simulation shows nothing as the recording's, its own, or of either.

    recorded, simulated: what each shows by itself, None where it cannot show such an effect. The simulation's
    part is nothing, as far as they show.
    """
    apart = one.difference
    assert apart is not None, "it stands beside what each has"
    nats = np.array([_nats_of_having(recorded, apart.value), _nats_of_having(simulated, -apart.value)])
    # What the motion leaves open it leaves open in both: two that agree are no more than one.
    of_recording, of_simulation = shares_alone(nats / max(np.count_nonzero(nats), 1))
    if of_simulation >= CERTAIN:
        return _of_simulation(one)
    shown = simulated or recorded
    none = apart.simulated if shown is None else replace(apart.simulated, covariance=shown.covariance)
    return replace(one, difference=replace(apart, simulated=none), of_either=of_recording < CERTAIN)


def _nats_of_having(own: Quantity | None, size: Array) -> float:
    """Return how much what one recording shows by itself speaks for a size (k,) against nothing, nats."""
    if own is None:
        return 0.0
    precision = np.linalg.inv(own.covariance + np.diag(own.tolerance**2))
    left = own.value - size
    return float(0.5 * (own.value @ precision @ own.value - left @ precision @ left))


def _identity(one: Quantity) -> tuple[str, str, float | None]:
    """Return effect, sensor and, of what came at a moment, that moment, s: what tells quantities apart."""
    return one.effect, one.sensor, one.reference.get("t_start")


def _scaled(own: Array, apart: Array) -> Array:
    """Return the scale (9,) of the recording's correction: to the simulation's readings, then by its own."""
    first, then = (np.eye(3) + value.reshape(3, 3) for value in (apart, own))
    return np.asarray((then @ first - np.eye(3)).ravel())


def _laid(own: int, k: int) -> Array:
    """Return the matrix (k, own) that lays out a simulation's own numbers as those of the difference.

    An accelerometer's scale and misalignment by rests are the symmetric part of the pair's nine numbers.
    """
    if own == k:
        return np.eye(k)
    spread = np.zeros((3, 3, own))
    spread[range(3), range(3), range(3)] = 1.0
    for number, (a, b) in enumerate(PAIRS, start=3):
        spread[[a, b], [b, a], number] = 1.0
    return spread.reshape(k, -1)


def _without_turn(scale: Quantity) -> Quantity:
    """Return scale and misalignment (9,) without the turn of all axes in them: the symmetric part."""
    rows = np.arange(9)
    told = 0.5 * (np.eye(9) + np.eye(9)[rows.reshape(3, 3).T.ravel()])
    return replace(scale, value=told @ scale.value, covariance=told @ scale.covariance @ told.T)
