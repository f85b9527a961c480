"""Marking one answer against its key: names, intervals, places in time, and the gain of its model."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.keys import SIGNS, Exam, Key, TrueEffect
from stillcal.replay.blind_test.power import detectability as power
from stillcal.replay.blind_test.reading import Reading, Statement, read
from stillcal.replay.blind_test.world.day import Bins
from stillcal.replay.blind_test.world.forward_model import FORWARD, played
from stillcal.replay.blind_test.world.noise import Colour

ENTAILED = {
    "noise_unequal_axes": {"noise_level"},
    "noise_heavy_tailed": {"noise_level"},
    "accel_quantisation": {"noise_level"},
    "gyro_quantisation": {"noise_level"},
    "bandwidth": {"noise_level", "accel_gyro_time_offset"},
    "lever_arm": {"accel_gyro_time_offset"},
}
"""Names that are true beside another: an axis' noise is part of the level, a coarse step adds noise of
step^2 / 12, a low-pass takes noise off and delays one sensor. They are no misnaming, nor a right name."""

SENSOR_IS_PART = ("noise_level", "noise_unequal_axes", "noise_heavy_tailed", "bandwidth", "thermal_latent")
"""Names that are right only together with the right sensor."""

NOT_COMPARED = {"noise_heavy_tailed", "noise_unequal_axes"}
"""Effects whose `ratio` the documented layout leaves open (of what to what): intervals are not judged."""

GIVEN_A_SIMULATION = ("simulated", "phone_file")
"""Kinds of case in which a simulation is given; the baselines cannot answer these."""

NAMELESS = ("near_shape", "off_catalogue", "reserve")
"""Kinds of case in which `unknown` is a right answer."""

WHOLLY_FITTED = 4.0
"""d' of what a stated model leaves of a near-shape, below which nobody could ask for more: less than half of
the cases of that d' are detected, and the model is taken for the whole of it with reason."""


@dataclass(frozen=True, slots=True)
class EffectMark:
    """The result for one true effect.

    named: alone, set, unknown, other or missed. given: the first name given. covered, covered_90: whether
    each judged component lay in its 95 % and 90 % interval. gain, oracle: nats, None: not judged. overlap:
    of time spans, intersection over union. apart_s: of a step's time. axes: Jaccard index.
    """

    effect: str
    d_prime: float | None
    named: str
    given: str
    covered: list[bool]
    covered_90: list[bool]
    gain: float | None
    oracle: float | None
    overlap: float | None
    apart_s: float | None
    axes: float | None


@dataclass(frozen=True, slots=True)
class Claim:
    """A stated probability, and whether what it was stated of is true."""

    effect: str
    probability: float
    true: bool


@dataclass(frozen=True, slots=True)
class RelationMark:
    """What was said of an effect that a given simulation has none, some, all or more of.

    true, said: the relations; `nothing` where nothing was said. outcome: right, undecided, wrong or
    wrong_sign. can_tell: whether the two recordings can tell it. others: names given besides.
    """

    true: str
    said: str
    outcome: str
    can_tell: bool
    others: list[str]


@dataclass(frozen=True, slots=True)
class Mark:
    """The result of one answer.

    alarmed: whether anything was found. unknown: whether an unknown effect was. false_names: names given that
    are not true. near: of a near-shape, what was made of it: stated, fitted, unknown, plain, other or missed.
    relation: what was made of a given simulation.
    """

    name: str
    kind: str
    family: str
    maker: str
    variant: str | None
    full_length: bool
    verdict: str
    alarmed: bool
    unknown: bool
    false_names: list[str]
    effects: list[EffectMark] = field(default_factory=list)
    claims: list[Claim] = field(default_factory=list)
    ground: str = "firm"
    misfit: float | None = None
    near: str | None = None
    relation: RelationMark | None = None

    @property
    def right(self) -> bool:
        """Whether the whole answer is right."""
        if self.verdict == "failed":
            return False
        named = all(e.named in ("alone", "set") for e in self.effects)
        by_kind = {
            "null": not self.alarmed,
            "decoy": not self.alarmed,
            "near_shape": self.near in ("stated", "fitted", "unknown"),
            "simulated": self.relation is not None and self.relation.outcome == "right",
            "phone_file": self.verdict == "match",
        }
        nameless = self.unknown if self.kind in NAMELESS else named
        return by_kind.get(self.kind, nameless and not self.false_names)


def marked(name: str, key: Key, answer: dict[str, Any]) -> Mark:
    """Return the mark of an answer."""
    reading, true = read(answer), _true_names(key)
    wanted = {e.effect for e in key.effects} | set(key.nearest)
    false = [s for s in reading.named if s.effect not in true and not s.members & wanted]
    return Mark(
        name,
        key.kind,
        key.family,
        key.maker,
        key.variant,
        key.full_length,
        reading.verdict,
        bool(reading.statements),
        reading.unknown,
        [s.effect for s in false],
        [_effect_marked(effect, key, reading) for effect in key.effects],
        _claims(key, reading, {id(s) for s in false}),
        key.ground,
        key.misfit,
        _near(key, reading, bool(false)) if key.kind == "near_shape" else None,
        _relation_marked(key, reading) if key.kind == "simulated" else None,
    )


def _true_names(key: Key) -> set[str]:
    names = {e.effect for e in key.effects} | set(key.entailed) | set(key.nearest)
    return names.union(*(ENTAILED.get(name, set()) for name in names))


def _claims(key: Key, reading: Reading, false: set[int]) -> list[Claim]:
    """Return what was stated with a probability; `unknown` is true where something hidden has no name."""
    return [
        Claim(
            s.effect,
            float(s.probability),
            id(s) not in false if s.effect != "unknown" else key.kind in NAMELESS,
        )
        for s in reading.statements
        if s.probability is not None
    ]


def _near(key: Key, reading: Reading, false: bool) -> str:
    """Return what an answer made of a near-shape."""
    if not reading.statements:
        return "missed"
    if false:
        return "other"
    named = [s for s in reading.named if s.members & set(key.nearest)]
    if not named:
        return "unknown" if reading.unknown else "missed"
    if reading.unknown or reading.verdict == "partly_identified":
        return "stated"
    return "fitted" if _left(key, reading) < WHOLLY_FITTED else "plain"


def _left(key: Key, reading: Reading) -> float:
    """Return d' of what an answer's model leaves of what was added, infinite where no bins tell."""
    if key.exam is None or key.misfit is None:
        return float("inf")
    sensor, bins = key.effects[0].sensor, bins_of(key.exam)
    true, colour = _truth_of(key.exam, sensor)
    left = true - _model(bins, reading, sensor)
    return power.d_prime(power.precision(bins, sensor, colour), left)


ALWAYS_THERE = (
    "accel_bias", "gyro_bias", "accel_scale", "gyro_scale", "noise_level", "noise_unequal_axes",
    "accel_bias_random_walk", "gyro_bias_random_walk",
)  # fmt: skip
"""Of these every sensor has some: a simulation that lacks it has too little of it, and both are right."""


def _relation_marked(key: Key, reading: Reading) -> RelationMark:
    """Return what was made of an effect that a simulation has a share of.

    Right where it agrees: it is listed as agreed, and no finding is about it.
    """
    assert key.relation is not None, "keys of this kind have a relation"
    truth = key.effects[0]
    stated = [s for s in reading.statements if _is_about(s, truth)]
    others = [
        s.effect for s in reading.statements if not _is_about(s, truth) and s.effect not in _true_names(key)
    ]
    if stated:
        said = stated[0].relation or "none"
        turned = SIGNS.get(said, 0) * SIGNS[key.relation] < 0
        same = said == key.relation or (
            truth.effect in ALWAYS_THERE and SIGNS.get(said, 0) == SIGNS[key.relation]
        )
        outcome = "right" if same else "wrong_sign" if turned else "wrong"
    elif key.relation == "agreed":
        said = "agreed" if (truth.effect, truth.sensor) in reading.agreed else "nothing"
        outcome = "right" if said == "agreed" else "undecided"
    else:
        said = "agreed" if (truth.effect, truth.sensor) in reading.agreed else "nothing"
        outcome = "wrong" if said == "agreed" else "undecided"
    return RelationMark(key.relation, said, outcome, key.can_tell, others)


def _is_about(statement: Statement, truth: TrueEffect) -> bool:
    return truth.effect in statement.members and (
        truth.effect not in SENSOR_IS_PART or statement.sensor == truth.sensor
    )


def _effect_marked(truth: TrueEffect, key: Key, reading: Reading) -> EffectMark:
    match = _matching(truth, reading)
    named_alone = match is not None and match.effect == truth.effect
    gain, oracle = _score_gain(truth, key, reading)
    place = match
    if place is None and key.kind in NAMELESS:
        place = next((s for s in reading.statements if s.effect == "unknown"), None)
    overlap, time_error, axes = (None, None, None) if place is None else _where_scores(truth, place)
    covered = [
        _covered(truth, match, level) if match is not None and named_alone else [] for level in (0.95, 0.9)
    ]
    return EffectMark(
        truth.effect,
        truth.d_prime,
        ("alone" if named_alone else "set") if match is not None else _outcome_of_unnamed(reading),
        _first_name(truth, match, reading),
        covered[0],
        covered[1],
        gain,
        oracle,
        overlap,
        time_error,
        axes,
    )


def _matching(truth: TrueEffect, reading: Reading) -> Statement | None:
    """Return the finding that names an effect, or else one whose set has it."""
    fitting = [
        s for s in reading.statements if truth.effect not in SENSOR_IS_PART or s.sensor == truth.sensor
    ]
    by_name = [s for s in fitting if s.effect == truth.effect]
    return next(iter([*by_name, *(s for s in fitting if truth.effect in s.members)]), None)


def _outcome_of_unnamed(reading: Reading) -> str:
    if not reading.statements:
        return "missed"
    return "other" if reading.named else "unknown"


def _first_name(truth: TrueEffect, match: Statement | None, reading: Reading) -> str:
    if match is not None:
        return truth.effect
    return reading.statements[0].effect if reading.statements else "nothing"


def _covered(truth: TrueEffect, statement: Statement, level: float) -> list[bool]:
    """Return for each component of each parameter whether its interval of a level holds the truth."""
    if truth.effect in NOT_COMPARED:
        return []
    judged = [
        (e, truth.parameters[n])
        for n, e in statement.parameters.items()
        if truth.parameters.get(n) is not None
    ]
    return [inside for estimate, true in judged for inside in estimate.covers(true, level)]


def _where_scores(truth: TrueEffect, statement: Statement) -> tuple[float | None, float | None, float | None]:
    begin, end = statement.t_start, statement.t_end
    overlap = time_error = None
    if begin is not None and end is not None:
        common = min(end, truth.t_end) - max(begin, truth.t_start)
        overlap = max(common, 0.0) / max(max(end, truth.t_end) - min(begin, truth.t_start), 1e-9)
        time_error = abs(begin - truth.t_start) if truth.effect.endswith("_bias_step") else None
    true, axes = set(truth.axes), statement.axes
    return overlap, time_error, len(true & axes) / len(true | axes) if axes else None


def bins_of(exam: Exam) -> Bins:
    """Return the bins that a key stores."""
    table = {
        k: np.asarray(getattr(exam, k))
        for k in ("t", "rest", "force", "north", "temperature", "charging", "drive")
    }
    return Bins(exam.width, **table, since=np.asarray(exam.since))


def _truth_of(exam: Exam, sensor: str) -> tuple[Array, Colour]:
    """Return what was truly added to a sensor's bins (m, 3), and its noise."""
    return np.asarray(getattr(exam, sensor)), Colour(**getattr(exam, f"{sensor}_noise"))


def _score_gain(truth: TrueEffect, key: Key, reading: Reading) -> tuple[float | None, float | None]:
    """Return the score gain of the answer's model on new noise, and that of the oracle, nats."""
    if key.exam is None or key.kind != "single" or truth.effect not in FORWARD or truth.d_prime is None:
        return None, None
    sensor = "gyro" if truth.sensor == "gyro" else "accel"
    bins = bins_of(key.exam)
    true, colour = _truth_of(key.exam, sensor)
    weight = power.precision(bins, sensor, colour)
    oracle = 0.5 * power.form(weight, true)
    # Effects that only motion shows have no gain at rest.
    return (power.gain(weight, true, _model(bins, reading, sensor)), oracle) if oracle > 0.5 else (None, None)


def _model(bins: Bins, reading: Reading, sensor: str) -> Array:
    """Return what all findings together add to a sensor's bins (m, 3)."""
    models = [_predicted(bins, s, sensor) for s in reading.named]
    return np.asarray(sum(models, start=np.zeros((bins.t.size, 3))))


def _predicted(bins: Bins, statement: Statement, sensor: str) -> Array:
    """Return what a finding's model adds to a sensor's bins (m, 3); zeros where it cannot be computed."""
    nothing = np.zeros((bins.t.size, 3))
    if statement.sensor != sensor or statement.effect not in FORWARD:
        return nothing
    parameters: dict[str, Any] = {k: e.value for k, e in statement.parameters.items()}
    parameters.setdefault("at_s", statement.t_start)
    parameters["reference_c"] = statement.reference_c
    try:
        added = played(bins, statement.effect, parameters)
    except (KeyError, TypeError, ValueError):
        return nothing
    return added if np.isfinite(added).all() else nothing
