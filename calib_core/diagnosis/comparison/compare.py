"""A recording against a simulation of other motion: constants, slow effects, noise, samples and stamps."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison import noise
from stillcal.calib_core.diagnosis.comparison.coverage import not_logged
from stillcal.calib_core.diagnosis.comparison.coverage.assumed_drivers import driven, excluded, of_any_course
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import (
    checks_of,
    direct_checks,
    obstacle,
    uninformed,
    why_not_logged,
)
from stillcal.calib_core.diagnosis.comparison.coverage.not_logged import NotLogged
from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import (
    Smallest,
    each_once,
    of_difference,
    sought,
)
from stillcal.calib_core.diagnosis.comparison.direct import delay_quantity, stamp_quantities
from stillcal.calib_core.diagnosis.comparison.linear import (
    SHIFTED,
    Wanted,
    hidden_shifts,
    kind_of,
    linear_quantities,
    moved_rows,
    proposed,
    settled,
    wanted_of,
)
from stillcal.calib_core.diagnosis.comparison.of_samples import Reasons, differences_of_samples, in_neither
from stillcal.calib_core.diagnosis.comparison.quantity import (
    Difference,
    Key,
    Quantity,
    posterior,
    subtract,
    weighed,
)
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy, NotCompared
from stillcal.calib_core.diagnosis.comparison.stated import Sole, concluded, key_of, told
from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.noise_models import AVERAGED
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.records import Alternative, Finding
from stillcal.calib_core.diagnosis.model.settings import CERTAIN
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.wander import NO_DRIVER

CROSSING_SPREAD_K = 10.0
"""K: how far from a recording's mean temperature the one lies at which a sensor was trimmed."""

FARTHEST = 2.6
"""Standard deviations of that temperature beyond which it is none (two-sided 1 %)."""

GYROSCOPE_ONLY = ("gyro_bias", "gyro_scale", "gyro_slow_noise")


def compare(recorded: Examination, simulated: Examination, names: tuple[str, str]) -> Comparison:
    """Compare a recording with a simulation. names: of both, for the reasons given."""
    exams = recorded, simulated = _named_by(simulated, recorded), _named_by(recorded, simulated)
    had = wanted_of(recorded), wanted_of(simulated)
    wanted, unlogged = _union(*had), not_logged.not_logged(exams, had, names)
    steady = excluded(exams, wanted, unlogged[1])
    unlogged = unlogged[0], [m for m in unlogged[1] if m not in steady]
    measured = (recorded, driven(simulated, recorded, steady))
    asked = _without(wanted, unlogged[1])
    sides = _sides(measured, (wanted, asked), unlogged)
    if steady:
        sides[1] = of_any_course(measured[1], asked, steady, sides[1])
    pairs, missing = _paired(exams, sides, wanted, names)
    looked = [_looked_for(exam) for exam in exams]
    reasons = [one.reasons for one in looked]
    direct, alone, unseen = differences_of_samples(exams, reasons, names, unlogged)
    count = len(pairs) + len(direct) + len(alone)
    pairs, hidden = not_logged.without_hidden(weighed([*pairs, *direct], max(count, 1)), unlogged)
    missing += [*hidden, *unseen]
    wander = [one for one in alone if _is_slow_noise(one[0], pairs) or _is_motion(one, exams)]
    alone = [one for one in alone if one not in wander]
    neither, not_both = in_neither(reasons, told(pairs, alone, missing), names)
    count -= len(hidden) + len(wander)
    smallest = [row for d in pairs for row in of_difference(d, max(count, 1))]
    smallest += [row for key in neither if key in looked[0].sought for row in _of_both(looked, key)]
    whole = concluded(
        pairs,
        alone,
        [*missing, *not_both],
        names,
        among=count,
        checks=count + len(neither),
        had={(w.hypothesis.effect.name, w.hypothesis.effect.sensor) for w in wanted},
    )
    found = [replace(d, note=_assumed(d, steady, names)) for d in whole.discrepancies]
    return replace(whole, discrepancies=found, smallest=smallest)


def _named_by(other: Examination, own: Examination) -> Examination:
    """Return an examination without what has no name but may be an effect that the other one has by name.

    That is one which cannot be told from it, or which foretells what was left out at least as well. It is
    measured and compared as that effect: beside a curve that may take any course, neither would be known.
    """
    named = {(s.finding.effect, s.finding.sensor) for s in other.statements if s.finding.effect != "unknown"}

    def is_named(finding: Finding) -> bool:
        alike = {(a.effect, finding.sensor) for a in finding.alternatives if _foretells(a, finding)}
        return finding.effect == "unknown" and not named.isdisjoint(alike)

    kept = [s for s in own.statements if not is_named(s.finding)]
    # As it is, it keeps what was worked out of it.
    return own if len(kept) == len(own.statements) else replace(own, statements=kept)


def _foretells(name: Alternative, found: Finding) -> bool:
    """Whether a name explains what was left out as well as what was stated, or cannot be told from it."""
    stated = found.evidence.heldout_log_score_gain
    return name.indistinguishable or (stated is not None and name.heldout_log_score_gain >= stated)


def _without(wanted: Sequence[Wanted], missing: Sequence[NotLogged]) -> list[Wanted]:
    """Return the effects that are not among those whose driver is missing."""
    keys = {(m.effect.name, m.effect.sensor) for m in missing}
    return [w for w in wanted if (w.hypothesis.effect.name, w.hypothesis.effect.sensor) not in keys]


def _assumed(found: Discrepancy, steady: Sequence[NotLogged], names: tuple[str, str]) -> str:
    """Say of an effect that the simulation did not log what drives it; "" of any other difference."""
    own = [m for m in steady if (m.effect.name, m.effect.sensor) == (found.effect, found.sensor)]
    if not own:
        return ""
    driver = own[0].effect.column if isinstance(own[0].effect, CovariateBias) else "temperature"
    return (
        f"The {driver} of {names[1]} is not known: it was judged as if it had changed as that of"
        f" {names[0]} did, and shows no such change. Simulated at one {driver}, it may have this all the"
        " same."
    )


def _is_slow_noise(finding: Finding, pairs: Sequence[Difference]) -> bool:
    """Whether wander that one recording has is the slow noise that is measured in both."""
    compared = {key_of(d) for d in pairs}
    return finding.where.driver == NO_DRIVER and (f"{finding.sensor}_slow_noise", finding.sensor) in compared


def _is_motion(one: Sole, exams: tuple[Examination, Examination]) -> bool:
    """Whether wander that one recording has may be motion of what the phone lay on."""
    finding, of_recording = one
    return finding.where.driver == NO_DRIVER and noise.moves(exams[not of_recording], finding.sensor)


def _paired(
    exams: tuple[Examination, Examination],
    sides: Sequence[Mapping[Key, Quantity]],
    wanted: Sequence[Wanted],
    names: tuple[str, str],
) -> tuple[list[Difference], list[NotCompared]]:
    """Return the differences of the quantities that both show, and why others cannot be compared."""
    pairs: list[Difference] = []
    missing: list[NotCompared] = []
    for key in dict.fromkeys([*_expected(*exams, wanted), *sides[0], *sides[1]]):
        one, other = (side.get(key) for side in sides)
        reason = _why_not(key, (one, other), exams, names, wanted)
        if reason is None and one is not None and other is not None:
            pairs.append(subtract(one, other))
        else:
            missing.append(NotCompared(*key, reason or "neither of the two shows it"))
    return pairs, missing


def _sides(
    exams: tuple[Examination, Examination],
    wanted: tuple[Sequence[Wanted], Sequence[Wanted]],
    unlogged: Sequence[Sequence[NotLogged]],
) -> list[dict[Key, Quantity]]:
    """Return what either recording shows, the constants at the recording's mean temperature.

    They are those at the temperature where both agree best, if they do agree there: elsewhere they would only
    repeat that a slope differs. So of a bias that settles it is that of the start or the settled one, where
    both agree better: the other would only repeat the amplitude. Of a simulation whose temperature stays the
    same only the constants at that one are known. wanted: what either of the two is asked for.
    """
    steady = hidden_shifts(exams[1], wanted[1])
    reference = _reference_temperature(exams[0].bins, exams[1].bins, steady)
    asked = list(zip(exams, wanted, strict=True))
    about = exams[0].column_means
    slowest = max(sample_period(exam.accelerometer.t) for exam, _ in asked)
    sides = [_quantities(exam, own, reference, about, slowest) for exam, own in asked]
    for sensor, at in crossing_temperatures(sides, reference).items():
        crossed = [linear_quantities(exam, own, reference | {sensor: at}, about) for exam, own in asked]
        if all(agree(crossed, (effect.removesuffix("_temperature"), sensor)) for effect in SHIFTED):
            sides, reference = _with_those_of(sensor, sides, crossed), reference | {sensor: at}
    for sensor in sorted({w.hypothesis.effect.sensor for w in wanted[1] if SETTLED in w.grid}):
        later = [linear_quantities(exam, [*map(settled, own)], reference, about) for exam, own in asked]
        if apart(later, (f"{sensor}_bias", sensor)) < apart(sides, (f"{sensor}_bias", sensor)):
            sides = _with_those_of(sensor, sides, later)
    sides = not_logged.with_unknown_temperature(sides, unlogged)
    every = [side | more for side, more in zip(sides, noise.low_passes(exams), strict=True)]
    return noise.without_repeated(every)


def _with_those_of(
    sensor: str, sides: Sequence[Mapping[Key, Quantity]], others: Sequence[Mapping[Key, Quantity]]
) -> list[dict[Key, Quantity]]:
    """Return both sides with one sensor's quantities taken from others."""
    return [
        dict(side) | {key: q for key, q in other.items() if key[1] == sensor}
        for side, other in zip(sides, others, strict=True)
    ]


def apart(sides: Sequence[Mapping[Key, Quantity]], key: Key) -> float:
    """Return the log Bayes factor, nats, for a difference of a quantity; none where one does not show it."""
    one, other = (side.get(key) for side in sides)
    return -np.inf if one is None or other is None else subtract(one, other).log_bayes_factor


def agree(sides: Sequence[Mapping[Key, Quantity]], key: Key) -> bool:
    """Whether two recordings are not sure to differ in a quantity that both show."""
    one, other = (side.get(key) for side in sides)
    if one is None or other is None:
        return True
    return posterior(subtract(one, other).log_bayes_factor, len(sides[0])) < CERTAIN


@dataclass(frozen=True, slots=True)
class _LookedFor:
    """What one recording was asked for. reasons: by effect and sensor, None where it was looked for."""

    sought: Mapping[Key, tuple[Smallest, ...]]
    reasons: Reasons


def _looked_for(exam: Examination) -> _LookedFor:
    found = sought(exam)
    rows: dict[Key, tuple[Smallest, ...]] = {}
    for one in found:
        rows[one.effect, one.sensor] = each_once([*rows.get((one.effect, one.sensor), ()), *one.smallest])
    return _LookedFor(rows, {(c.effect, c.sensor): c.reason for c in checks_of(exam, found)})


def _of_both(looked: Sequence[_LookedFor], key: Key) -> list[Smallest]:
    """Return the smallest difference that shows: each recording hides as much as it alone would."""
    other = {row.parameter: row for row in looked[1].sought.get(key, ())}
    return [
        replace(row, value=float(np.hypot(row.value, other[row.parameter].value)))
        for row in looked[0].sought[key]
        if row.parameter in other
    ]


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
    """Return, by sensor, the degC at which the constants of both agree best, where their slopes differ.

    A slope that is missing has a temperature at which it adds nothing. At any other one the bias (or scale)
    would seem to differ too. It is the least squares crossing of the lines of both, with a prior about the
    mean. Lines that meet beyond `FARTHEST` standard deviations of it differ anyway, and the mean is kept.
    """
    out = {}
    for sensor, mean in reference.items():
        lines = [line for effect in SHIFTED if (line := _line(sides, effect, sensor)) is not None]
        pull = sum(float(slope @ weight @ away) for slope, weight, away in lines)
        steep = sum(float(slope @ weight @ slope) for slope, weight, _ in lines)
        warmer = -pull / (steep + CROSSING_SPREAD_K**-2.0)
        if lines and abs(warmer) <= FARTHEST * CROSSING_SPREAD_K:
            out[sensor] = mean + warmer
    return out


def _line(
    sides: Sequence[Mapping[Key, Quantity]], effect: str, sensor: str
) -> tuple[Array, Array, Array] | None:
    """Return how two recordings' constants differ by temperature: None where an effect's slopes do not.

    That is the change by axis (3,) for each K, and of the difference at the reference its inverse covariance
    (3, 3) and its size (3,).
    """
    keys = ((effect, sensor), (effect.removesuffix("_temperature"), sensor))
    if not all(key in side for key in keys for side in sides):
        return None
    slope, constant = (subtract(sides[0][key], sides[1][key]) for key in keys)
    if posterior(slope.log_bayes_factor, len(sides[0])) < CERTAIN:
        return None
    rows = moved_rows(effect)
    spread = constant.covariance[np.ix_(rows, rows)] + np.diag(constant.recorded.tolerance[rows] ** 2)
    # A scale is that of the correction: what the sensor gains it loses.
    change = -slope.value[:3] if "_scale_" in effect else slope.value[:3]
    return change, np.asarray(np.linalg.inv(spread)), constant.value[rows]


def _reference_temperature(recorded: Bins, simulated: Bins, steady: Collection[str]) -> dict[str, float]:
    """Return, by sensor, the degC at which constants are compared, if both have a thermometer.

    That is the recording's mean, or the simulation's for the sensors in `steady`.
    """
    if (
        recorded.temperature is None
        or simulated.temperature is None
        or not (len(recorded) and len(simulated))
    ):
        return {}
    means = float(recorded.temperature.mean()), float(simulated.temperature.mean())
    return {sensor: means[sensor in steady] for sensor in ("accel", "gyro")}


def _quantities(
    exam: Examination,
    wanted: Sequence[Wanted],
    reference_c: Mapping[str, float],
    about: Mapping[str, float],
    slowest: float,
) -> dict[Key, Quantity]:
    """Return all that one recording shows, by effect and sensor. slowest: s, the longer period of the two."""
    out = linear_quantities(exam, wanted, reference_c, about) | noise.densities(exam)
    for residuals in exam.sensors:
        if len(residuals.bins) < thresholds.LEAST_BINS:
            continue
        own = [w for w in wanted if w.kind == kind_of(residuals)]
        asked = [h for w in own if (h := proposed(residuals, w)) is not None]
        if (slow := noise.slow_noise(exam, residuals, asked)) is not None:
            out[slow.effect, slow.sensor] = slow
    out["sample_rate", "timing"] = noise.rate(exam.accelerometer)
    out |= stamp_quantities(exam, slowest) | delay_quantity(exam)
    return out


def _expected(recorded: Examination, simulated: Examination, wanted: Sequence[Wanted]) -> list[Key]:
    """Return what every comparison looks at, whether the two recordings can show it or not."""
    keys: list[Key] = [("accel_bias", "accel"), ("accel_scale", "accel"), ("noise_level", "accel")]
    keys.append(("accel_slow_noise", "accel"))
    if recorded.gyroscope is not None or simulated.gyroscope is not None:
        keys += [(effect, "gyro") for effect in (*GYROSCOPE_ONLY, "noise_level")]
    if not (recorded.is_table or simulated.is_table):
        keys.append((DELAY, "timing"))
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
    if effect in (noise.LEVEL, noise.LOW_PASS):
        streams = [s for s in exam.streams if s.sensor == sensor]
        return noise.why_not_measured(effect, streams[0]) if streams else "no such sensor"
    if sensor == "timing":
        unlooked = next((c.reason for c in direct_checks(exam) if (c.effect, c.sensor) == key), None)
        return unlooked or exam.why_no_delay or uninformed(effect)
    first = obstacle(exam, effect, sensor)
    if first is None and effect.endswith("slow_noise"):
        whys = (noise.why_no_slow_noise(exam, r) for r in exam.sensors if r.sensor == sensor)
        return next((why for why in whys if why), f"too few rests of {AVERAGED:.0f} s")
    return first or next((why for why in unlogged if why), None) or uninformed(effect)
