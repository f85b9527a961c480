"""The comparison as a whole: what differs, what agrees, what cannot be compared and why."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from stillcal.calib_core.diagnosis.comparison import noise, not_logged
from stillcal.calib_core.diagnosis.comparison.direct import (
    MEASURED_ELSEWHERE,
    direct_statements,
    named,
    partner,
    quantities_of,
    stamp_quantities,
    why_not_shown,
)
from stillcal.calib_core.diagnosis.comparison.linear import (
    Wanted,
    kind_of,
    linear_quantities,
    proposed,
    wanted_of,
)
from stillcal.calib_core.diagnosis.comparison.looked_for import (
    checks_of,
    obstacle,
    uninformed,
    why_not_logged,
)
from stillcal.calib_core.diagnosis.comparison.not_logged import NotLogged
from stillcal.calib_core.diagnosis.comparison.quantity import (
    CERTAIN,
    Difference,
    Quantity,
    Relation,
    posterior,
    subtract,
    weighed,
)
from stillcal.calib_core.diagnosis.comparison.sensitivity import Smallest, each_once, of_difference, sought
from stillcal.calib_core.diagnosis.diagnose import Examination
from stillcal.calib_core.diagnosis.inference.noise_models import AVERAGED
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.records import AXES, Finding, Where
from stillcal.calib_core.diagnosis.segments.static_bins import Bins

Verdict = Literal["match", "identified", "partly_identified", "unidentified", "not_judged"]
Key = tuple[str, str]

LEAST_JUDGED = 1.0 / 3.0
"""Part of the checks that must have been possible for a verdict."""

LEVEL = 0.01
"""p below which a simulation is rejected."""

CROSSING_SPREAD_K = 10.0
"""K: how far from a recording's mean temperature the one lies at which a sensor was trimmed."""

FARTHEST = 2.6
"""Standard deviations of that temperature beyond which it is none (two-sided 1 %)."""

GYROSCOPE_ONLY = ("gyro_bias", "gyro_scale", "gyro_slow_noise")


@dataclass(frozen=True, slots=True, eq=False)
class Discrepancy:
    """One thing that differs. difference: None where only one of the two has the effect at all.

    finding: the single recording's finding where it comes from one (`recorded` or `simulated` has it).
    log_bayes_factor: nats for a difference, against none.
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


@dataclass(frozen=True, slots=True)
class NotCompared:
    """An effect that could not be compared, and why."""

    effect: str
    sensor: str
    reason: str


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
        names = [d.effect != "unknown" for d in self.discrepancies]
        if all(names) and p_after is not None and p_after >= LEVEL:
            return "identified"
        return "partly_identified" if any(names) else "unidentified"


def compare(recorded: Examination, simulated: Examination, names: tuple[str, str]) -> Comparison:
    """Compare a recording with a simulation. names: of both, for the reasons given."""
    had = (wanted_of(recorded), wanted_of(simulated))
    wanted, exams = _union(*had), (recorded, simulated)
    unlogged = not_logged.not_logged(exams, had, names)
    reference = _mean_temperature(recorded.bins, simulated.bins)
    sides = [_quantities(exam, wanted, reference) for exam in exams]
    crossing = crossing_temperatures(sides, reference)
    if crossing:
        sides = [
            side | linear_quantities(e, wanted, reference | crossing)
            for e, side in zip(exams, sides, strict=True)
        ]
    sides = not_logged.with_unknown_temperature(sides, unlogged)
    keys = list(dict.fromkeys([*_expected(recorded, simulated, wanted), *sides[0], *sides[1]]))
    pairs: list[Difference] = []
    missing: list[NotCompared] = []
    for key in keys:
        one, other = (side.get(key) for side in sides)
        reason = _why_not(key, (one, other), exams, names, wanted)
        if reason is None and one is not None and other is not None:
            pairs.append(subtract(one, other))
        else:
            missing.append(NotCompared(*key, reason or "neither of the two shows it"))
    looked = [_looked_for(exam) for exam in exams]
    direct, more, unseen = _direct(exams, looked, names, unlogged)
    pairs += direct
    pairs = weighed(pairs, max(len(pairs) + len(more), 1))
    hidden = {id(d): why for d in pairs if _differs(d) and (why := not_logged.of_difference(unlogged, d))}
    missing += [NotCompared(*_key(d), hidden[id(d)]) for d in pairs if id(d) in hidden]
    pairs = [d for d in pairs if id(d) not in hidden]
    count = len(pairs) + len(more)
    found = [_discrepancy(d) for d in pairs if _differs(d)]
    sole = [_sole(finding, gain, of_recording, count) for finding, gain, of_recording in more]
    found += [d for d in sole if d.probability >= CERTAIN]
    asked = {(w.hypothesis.effect.name, w.hypothesis.effect.sensor) for w in wanted}
    agreed = [d for d in pairs if d.agrees and _worth_telling(d, asked)]
    agreed += [noise.named_unequal(d) for d in agreed if noise.alike_unequal(d)]
    missing += unseen
    undecided = [_undecided(d, names) for d in pairs if not d.agrees and not _differs(d)]
    evidence = [(d.recorded.effect, d.log_bayes_factor) for d in pairs]
    evidence += [(finding.effect, gain) for finding, gain, _ in more]
    found.sort(key=lambda d: -d.log_bayes_factor)
    told = {*map(_key, pairs), *((n.effect, n.sensor) for n in missing)}
    told |= {(finding.effect, finding.sensor) for finding, _, _ in more}
    neither, not_both = _in_neither(looked, told, names)
    smallest = [row for d in pairs for row in of_difference(d, max(count, 1))]
    smallest += [row for key in neither if key in looked[0].sought for row in _of_both(looked, key)]
    checks = count + len(neither)
    return Comparison(found, agreed, pairs, [*missing, *not_both], undecided, checks, evidence, smallest)


@dataclass(frozen=True, slots=True)
class _LookedFor:
    """What one recording was asked for. reasons: by effect and sensor, None where it was looked for."""

    sought: Mapping[Key, tuple[Smallest, ...]]
    reasons: Mapping[Key, str | None]


def _looked_for(exam: Examination) -> _LookedFor:
    found = sought(exam)
    rows: dict[Key, tuple[Smallest, ...]] = {}
    for one in found:
        rows[one.effect, one.sensor] = each_once([*rows.get((one.effect, one.sensor), ()), *one.smallest])
    return _LookedFor(rows, {(c.effect, c.sensor): c.reason for c in checks_of(exam, found)})


def _in_neither(
    looked: Sequence[_LookedFor], told: set[Key], names: tuple[str, str]
) -> tuple[list[Key], list[NotCompared]]:
    """Return what was looked for in both and found in neither, and what one of the two cannot show."""
    neither, missing = [], []
    for key in dict.fromkeys([*looked[0].reasons, *looked[1].reasons]):
        if key in told or key[0].endswith(MEASURED_ELSEWHERE):
            continue
        reasons = [one.reasons.get(key, _why_not_sought(key[0])) for one in looked]
        cannot = [f"{name}: {why}" for name, why in zip(names, reasons, strict=True) if why is not None]
        if cannot:
            same = reasons[0] is not None and reasons[0] == reasons[1]
            missing.append(NotCompared(*key, f"both: {reasons[0]}" if same else "; ".join(cannot)))
        else:
            neither.append(key)
    return neither, missing


def _why_not_sought(effect: str) -> str:
    """Say why an effect is not in a recording's list at all."""
    if effect == "thermal_latent":
        return "its temperature was recorded"
    return "it has no such column" if "_bias_" in effect else "no such sensor"


def _of_both(looked: Sequence[_LookedFor], key: Key) -> list[Smallest]:
    """Return the smallest difference that shows: each recording hides as much as it alone would."""
    other = {row.parameter: row for row in looked[1].sought.get(key, ())}
    return [
        replace(row, value=float(np.hypot(row.value, other[row.parameter].value)))
        for row in looked[0].sought[key]
        if row.parameter in other
    ]


def p_of(log_bayes_factors: Sequence[float]) -> float:
    """Return p of no difference at all: the inverse of the mean Bayes factor, at most 1.

    Under that hypothesis each Bayes factor has expectation one, hence their mean; by Markov's inequality it
    exceeds k with probability 1 / k at most (Vovk and Wang, Ann. Statist. 49, 2021, e-values).
    """
    if not log_bayes_factors:
        return 1.0
    mean = float(np.logaddexp.reduce(np.asarray(log_bayes_factors))) - float(np.log(len(log_bayes_factors)))
    return float(np.exp(-np.clip(mean, 0.0, 690.0)))


def _union(one: Sequence[Wanted], other: Sequence[Wanted]) -> list[Wanted]:
    """Return the effects of both, each once, with the most parameters; the recording's grid goes first."""
    out: dict[tuple[str, str, str], Wanted] = {}
    for wanted in (*one, *other):
        known = out.setdefault(wanted.key, wanted)
        if len(wanted.hypothesis.effect.parameters) > len(known.hypothesis.effect.parameters):
            out[wanted.key] = wanted
    return list(out.values())


def crossing_temperatures(
    sides: Sequence[Mapping[Key, Quantity]], reference: Mapping[str, float]
) -> dict[str, float]:
    """Return, by sensor, the degC at which the biases of both agree best, where their slopes differ.

    A slope that is missing has a temperature at which it adds nothing. At any other one the bias would seem
    to differ too. It is the least squares crossing of the two lines of bias, with a prior about the mean.
    Biases that meet beyond `FARTHEST` standard deviations of it differ anyway, and are stated at the mean.
    """
    out = {}
    for sensor, mean in reference.items():
        keys = ((f"{sensor}_bias_temperature", sensor), (f"{sensor}_bias", sensor))
        if not all(key in side for key in keys for side in sides):
            continue
        slope, bias = (subtract(sides[0][key], sides[1][key]) for key in keys)
        line = slope.value[:3]
        if posterior(slope.log_bayes_factor, len(sides[0])) < CERTAIN:
            continue
        weight = np.linalg.inv(bias.covariance + np.diag(bias.recorded.tolerance**2))
        pull = float(line @ weight @ bias.value)
        away = -pull / (float(line @ weight @ line) + CROSSING_SPREAD_K**-2.0)
        if abs(away) <= FARTHEST * CROSSING_SPREAD_K:
            out[sensor] = mean + away
    return out


def _mean_temperature(recorded: Bins, simulated: Bins) -> dict[str, float]:
    """Return the degC at which constants are compared: the recording's mean, if both have a thermometer."""
    if recorded.temperature is None or simulated.temperature is None:
        return {}
    mean = float(recorded.temperature.mean()) if len(recorded) and len(simulated) else None
    return {} if mean is None else {"accel": mean, "gyro": mean}


def _quantities(
    exam: Examination, wanted: Sequence[Wanted], reference_c: Mapping[str, float]
) -> dict[Key, Quantity]:
    """Return all that one recording shows, by effect and sensor."""
    out = linear_quantities(exam, wanted, reference_c)
    for stream in exam.streams:
        if (level := noise.density(stream)) is not None:
            out["noise_level", stream.sensor] = level
    for scene in exam.scenes:
        if len(scene.bins) < thresholds.LEAST_BINS:
            continue
        own = [w for w in wanted if w.kind == kind_of(scene)]
        asked = [h for w in own if (h := proposed(scene, w)) is not None]
        if (slow := noise.slow_noise(exam, scene, asked)) is not None:
            out[slow.effect, slow.sensor] = slow
    out["sample_rate", "timing"] = noise.rate(exam.accelerometer)
    out |= stamp_quantities(exam)
    return out


def _expected(recorded: Examination, simulated: Examination, wanted: Sequence[Wanted]) -> list[Key]:
    """Return what every comparison looks at, whether the two recordings can show it or not."""
    keys: list[Key] = [("accel_bias", "accel"), ("accel_scale", "accel"), ("noise_level", "accel")]
    keys.append(("accel_slow_noise", "accel"))
    if recorded.gyroscope is not None or simulated.gyroscope is not None:
        keys += [(effect, "gyro") for effect in (*GYROSCOPE_ONLY, "noise_level")]
    return [*keys, *((w.hypothesis.effect.name, w.hypothesis.effect.sensor) for w in wanted)]


def _why_not(
    key: Key,
    pair: tuple[Quantity | None, Quantity | None],
    exams: tuple[Examination, Examination],
    names: tuple[str, str],
    wanted: Sequence[Wanted],
) -> str | None:
    """Say why a quantity cannot be compared; None where it can."""
    for quantity, exam, name in zip(pair, exams, names, strict=True):
        if quantity is None:
            return f"{name}: {_why_absent(key, exam, wanted)}"
        if not quantity.logarithmic and not quantity.informed.any():
            return f"{name}: {uninformed(key[0])}"
    one, other = pair
    assert one is not None and other is not None, "a missing one was told of above"
    if key[0] == "sample_rate" and np.abs(one.value - other.value).max() < noise.ALIKE_RATE:
        even = [n for e, n in zip(exams, names, strict=True) if noise.exactly_even(e.accelerometer.t)]
        if names[0] in even:
            return (
                f"{names[0]}: its stamps are exactly even, so they were computed and say nothing of its clock"
            )
    if not one.logarithmic and not (one.informed & other.informed).any():
        return "the two show it on different axes"
    return None


def _why_absent(key: Key, exam: Examination, wanted: Sequence[Wanted]) -> str:
    """Say why a recording has no such quantity: the first reason that applies."""
    effect, sensor = key
    drivers = [w.hypothesis.effect for w in wanted]
    unlogged = [why_not_logged(exam, e) for e in drivers if (e.name, e.sensor) == key]
    if effect == "noise_level":
        return _why_no_density(exam, sensor)
    first = obstacle(exam, effect, sensor)
    if first is None and effect.endswith("slow_noise"):
        return f"too few rests of {AVERAGED:.0f} s"
    return first or next((why for why in unlogged if why), None) or uninformed(effect)


def _why_no_density(exam: Examination, sensor: str) -> str:
    streams = [s for s in exam.streams if s.sensor == sensor]
    return noise.why_no_density(streams[0]) if streams else "no such sensor"


def _differs(difference: Difference) -> bool:
    return difference.probability >= CERTAIN


def _key(difference: Difference) -> Key:
    return difference.recorded.effect, difference.recorded.sensor


def _worth_telling(difference: Difference, had: set[Key]) -> bool:
    """Whether agreement says something: a noise, or an effect that one of the two was found to have."""
    return difference.recorded.logarithmic or _key(difference) in had or difference.recorded.shows()


def _undecided(difference: Difference, names: tuple[str, str]) -> NotCompared:
    odds = f"probability of a difference {difference.probability:.2f}"
    return NotCompared(*_key(difference), f"{names[0]} and {names[1]} do not decide it: {odds}")


def _discrepancy(difference: Difference) -> Discrepancy:
    recorded, axes = difference.recorded, axes_of(difference)
    assert recorded.where is not None, "every quantity says where it was measured"
    effect, relation = recorded.effect, difference.relation()
    if effect == noise.LEVEL and (unequal := noise.unequal(difference, axes)) is not None:
        effect, relation = noise.UNEQUAL, unequal
    return Discrepancy(
        effect,
        recorded.sensor,
        axes,
        recorded.where,
        relation,
        difference.probability,
        difference.log_bayes_factor,
        difference,
    )


def axes_of(difference: Difference) -> list[str]:
    """Return the axes whose numbers differ beyond their errors and tolerance, at least the clearest one."""
    error = np.hypot(difference.sigma, difference.recorded.tolerance)
    strength = np.abs(difference.value) / np.maximum(error, 1e-300)
    owner = difference.recorded.axis_of
    if (owner < 0).all():
        return []
    by_axis = [float(strength[owner == a].max(initial=0.0)) for a in range(3)]
    least = min(thresholds.AXIS_SIGMA, max(by_axis))
    return [AXES[a] for a in range(3) if by_axis[a] >= least]


Sole = tuple[Finding, float, bool]


def _direct(
    exams: tuple[Examination, Examination],
    looked: Sequence[_LookedFor],
    names: tuple[str, str],
    unlogged: Sequence[Sequence[NotLogged]],
) -> tuple[list[Difference], list[Sole], list[NotCompared]]:
    """Compare the effects that samples show directly.

    Returned are differences of what both have; what one alone has, with its evidence (nats) and whether
    it is the recording; what the other could not show, or was found by its driver.
    """
    sides = (direct_statements(exams[0]), direct_statements(exams[1]))
    both: list[Difference] = []
    sole: list[Sole] = []
    unseen: list[NotCompared] = []
    for own, others, other, name, of_recording in (
        (sides[0], sides[1], 1, names[1], True),
        (sides[1], sides[0], 0, names[0], False),
    ):
        for finding in own:
            pair = partner(finding, own, others)
            if pair is not None:
                both += _paired(finding, pair) if of_recording else []
                continue
            unlooked = looked[other].reasons.get((finding.effect, finding.sensor))
            reason = why_not_shown(finding, exams[other]) or unlooked
            hidden = not_logged.of_finding(unlogged[1 - other], exams[1 - other], finding)
            if reason is not None or hidden is not None:
                why = hidden or f"{name}: {reason}"
                unseen.append(NotCompared(finding.effect, finding.sensor, why))
            elif (evidence := _evidence(finding)) > 0.0:
                sole.append((finding, evidence, of_recording))
    return both, sole, unseen


def _evidence(finding: Finding) -> float:
    """Return the evidence, nats, for a finding: no more than parts left out of the fit confirm."""
    gain = finding.evidence.heldout_log_score_gain
    whole = finding.evidence.log_bayes_factor
    return whole if gain is None else min(gain, whole)


def _paired(one: Finding, other: Finding) -> list[Difference]:
    pair = quantities_of(one, other)
    return [] if pair is None else [subtract(*pair)]


def _sole(finding: Finding, gain: float, of_recording: bool, count: int) -> Discrepancy:
    return Discrepancy(
        finding.effect,
        finding.sensor,
        named(finding),
        finding.where,
        "lacking" if of_recording else "superfluous",
        posterior(gain, max(count, 1)),
        gain,
        None,
        finding if of_recording else None,
        None if of_recording else finding,
    )
