"""A recording against a simulation of other motion: constants, slow effects, noise, samples and stamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.diagnosis.comparison import sample_rate
from stillcal.calib_core.diagnosis.comparison.clock_or_scale import with_clock
from stillcal.calib_core.diagnosis.comparison.coverage import not_logged
from stillcal.calib_core.diagnosis.comparison.coverage.assumed_drivers import driven, excluded, of_any_course
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import (
    checks_of,
)
from stillcal.calib_core.diagnosis.comparison.coverage.not_logged import NotLogged
from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import (
    Smallest,
    each_once,
    of_difference,
    sought,
)
from stillcal.calib_core.diagnosis.comparison.coverage.why_not_compared import why_not_compared
from stillcal.calib_core.diagnosis.comparison.direct import (
    delay_quantity,
    stamp_quantities,
    stamped_in_bursts,
)
from stillcal.calib_core.diagnosis.comparison.linear.quantities import linear_quantities
from stillcal.calib_core.diagnosis.comparison.linear.reference_point import (
    mean_temperatures,
    where_both_agree,
)
from stillcal.calib_core.diagnosis.comparison.linear.shifts import hidden_shifts
from stillcal.calib_core.diagnosis.comparison.linear.wanted import (
    Wanted,
    kind_of,
    proposed,
    settled,
    wanted_of,
)
from stillcal.calib_core.diagnosis.comparison.noise import slow_noise, white_noise
from stillcal.calib_core.diagnosis.comparison.of_samples import Reasons, differences_of_samples, in_neither
from stillcal.calib_core.diagnosis.comparison.quantity import (
    Difference,
    Key,
    Quantity,
    weighed,
)
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy, NotCompared
from stillcal.calib_core.diagnosis.comparison.stated import Sole, concluded, key_of, told
from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.records import Alternative, Finding
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.slow.wander import NO_DRIVER

GYROSCOPE_ONLY = ("gyro_bias", "gyro_scale", "gyro_slow_noise")


@dataclass(frozen=True, slots=True)
class _Asked:
    """The effects that a recording and a simulation are asked for.

    wanted: those that either was found to have; unlogged: of each, those whose driver it did not log; steady:
    those that the simulation cannot have, though it did not log their driver.
    """

    wanted: list[Wanted]
    unlogged: tuple[list[NotLogged], list[NotLogged]]
    steady: list[NotLogged]

    @property
    def of_simulation(self) -> list[Wanted]:
        """What the simulation can show: all but what it did not log the driver of."""
        keys = {m.effect.key for m in self.unlogged[1]}
        return [w for w in self.wanted if w.hypothesis.effect.key not in keys]


def compare(
    recorded: Examination, simulated: Examination, names: tuple[str, str], *, played: bool = False
) -> Comparison:
    """Compare a recording with a simulation.

    names: of both, for the reasons given. played: whether the simulation is a phone that was played, which is
    stamped when it samples; stamps that are times of delivery are not held against its own.
    """
    exams = _named_by(simulated, recorded), _named_by(recorded, simulated)
    asked = _asked_of(exams, names)
    bursts = [{}, {}] if played else stamped_in_bursts(exams)
    sides = [burst | side for burst, side in zip(bursts, _sides(exams, asked), strict=True)]
    pairs, missing = _paired(exams, sides, asked.wanted, names)
    looked = [_looked_for(exam) for exam in exams]
    reasons = [one.reasons for one in looked]
    direct, alone, unseen = differences_of_samples(exams, reasons, names, asked.unlogged)
    compared = weighed([*pairs, *direct], max(len(pairs) + len(direct) + len(alone), 1))
    compared, hidden = not_logged.without_hidden(compared, asked.unlogged)
    alone = [one for one in alone if not (_is_slow_noise(one[0], compared) or _is_motion(one, exams))]
    missing += [*hidden, *unseen]
    neither, not_both = in_neither(reasons, told(compared, alone, missing), names)
    among = len(compared) + len(alone)
    smallest = [row for d in compared for row in of_difference(d, max(among, 1))]
    smallest += [row for key in neither if key in looked[0].sought for row in _of_both(looked, key)]
    whole = concluded(
        [slow_noise.by_name(d, exams) for d in compared],
        alone,
        [*missing, *not_both],
        names,
        among=among,
        checks=among + len(neither),
        had={w.hypothesis.effect.key for w in asked.wanted},
    )
    found = [
        replace(d, note=_assumed(d, asked.steady, names) or _noise_put_in(d, exams, names))
        for d in whole.discrepancies
    ]
    found = with_clock(found, compared, exams[0], names[0])
    return replace(whole, discrepancies=found, smallest=smallest)


def _asked_of(exams: tuple[Examination, Examination], names: tuple[str, str]) -> _Asked:
    """Return what a recording and a simulation are asked for."""
    had = wanted_of(exams[0]), wanted_of(exams[1])
    wanted, unlogged = _union(*had), not_logged.not_logged(exams, had, names)
    steady = excluded(exams, wanted, unlogged[1])
    return _Asked(wanted, (unlogged[0], [m for m in unlogged[1] if m not in steady]), steady)


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


def _assumed(found: Discrepancy, steady: Sequence[NotLogged], names: tuple[str, str]) -> str:
    """Say of an effect that the simulation did not log what drives it; "" of any other difference."""
    own = [m for m in steady if m.effect.key == (found.effect, found.sensor)]
    if not own:
        return ""
    driver = own[0].effect.column if isinstance(own[0].effect, CovariateBias) else "temperature"
    return (
        f"The {driver} of {names[1]} is not known: it was judged as if it had changed as that of"
        f" {names[0]} did, and shows no such change. Simulated at one {driver}, it may have this all the"
        " same."
    )


def _noise_put_in(found: Discrepancy, exams: tuple[Examination, Examination], names: tuple[str, str]) -> str:
    """Say what stood in for white noise that one recording lacks; "" of any other difference."""
    if found.effect != white_noise.LEVEL:
        return ""
    put_in = (
        name
        for name, exam in zip(names, exams, strict=True)
        if any(s.sensor == found.sensor and s.silent and s.steps.sd.any() for s in exam.streams)
    )
    return next((f"All else was judged with the noise of a quiet phone put into {n}." for n in put_in), "")


def _is_slow_noise(finding: Finding, pairs: Sequence[Difference]) -> bool:
    """Whether wander that one recording has is the slow noise that is measured in both."""
    compared = {key_of(d) for d in pairs}
    return finding.where.driver == NO_DRIVER and (f"{finding.sensor}_slow_noise", finding.sensor) in compared


def _is_motion(one: Sole, exams: tuple[Examination, Examination]) -> bool:
    """Whether wander that one recording has may be motion of what the phone lay on."""
    finding, of_recording = one
    return finding.where.driver == NO_DRIVER and slow_noise.moves(exams[not of_recording], finding.sensor)


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
        reason = why_not_compared(key, (one, other), exams, names, wanted)
        if reason is None and one is not None and other is not None:
            pairs.append(slow_noise.difference_of(one, other))
        else:
            missing.append(NotCompared(*key, reason or "neither of the two shows it"))
    return pairs, missing


def _sides(exams: tuple[Examination, Examination], asked: _Asked) -> list[dict[Key, Quantity]]:
    """Return what either recording shows, the constants at its mean temperature or where both agree.

    Of a simulation whose temperature stays the same only the constants at that one are known.
    """
    recorded, simulated = exams[0], driven(exams[1], exams[0], asked.steady)
    both = ((recorded, asked.wanted), (simulated, asked.of_simulation))
    steady = hidden_shifts(simulated, asked.of_simulation)
    means = mean_temperatures(recorded.bins, simulated.bins, steady)
    about = recorded.column_means
    slowest = max(sample_period(exam.accelerometer.t) for exam in exams)
    settling = sorted({w.hypothesis.effect.sensor for w in asked.of_simulation if SETTLED in w.grid})

    def anew(temperatures: Mapping[str, float], later: bool) -> list[dict[Key, Quantity]]:
        return [
            linear_quantities(exam, [*map(settled, own)] if later else own, temperatures, about)
            for exam, own in both
        ]

    rates = sample_rate.of_both([exam.accelerometer for exam, _ in both])
    shown = [
        linear | _wander_and_stamps(exam, own, slowest) | {(rate.effect, rate.sensor): rate}
        for linear, (exam, own), rate in zip(anew(means, False), both, rates, strict=True)
    ]
    shown = where_both_agree(shown, means, settling, anew)
    shown = not_logged.with_unknown_temperature(shown, asked.unlogged)
    more = white_noise.of_both((recorded, simulated))
    shown = [side | noise for side, noise in zip(shown, more, strict=True)]
    sides = white_noise.without_repeated(shown)
    if asked.steady:
        sides[1] = of_any_course(simulated, asked.of_simulation, asked.steady, sides[1])
    return sides


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
        replace(
            row,
            value=float(np.hypot(row.value, other[row.parameter].value)),
            hidden=tuple(sorted({*row.hidden, *other[row.parameter].hidden})),
        )
        for row in looked[0].sought[key]
        if row.parameter in other
    ]


def _union(one: Sequence[Wanted], other: Sequence[Wanted]) -> list[Wanted]:
    """Return the effects of both, each once, with the most parameters; the recording's grid goes first."""
    out: dict[tuple[str, str, str], Wanted] = {}
    for wanted in (*one, *other):
        known = out.setdefault(wanted.identity, wanted)
        if len(wanted.hypothesis.effect.parameters) > len(known.hypothesis.effect.parameters):
            out[wanted.identity] = wanted
    return list(out.values())


def _wander_and_stamps(exam: Examination, wanted: Sequence[Wanted], slowest: float) -> dict[Key, Quantity]:
    """Return what one recording shows of slow noise, stamps and delay.

    slowest: s, the longer period of both.
    """
    out: dict[Key, Quantity] = {}
    for residuals in exam.sensors:
        if len(residuals.bins) < thresholds.LEAST_BINS:
            continue
        own = [w for w in wanted if w.kind == kind_of(residuals)]
        found = [h for w in own if (h := proposed(residuals, w)) is not None]
        if (slow := slow_noise.slow_noise(exam, residuals, found)) is not None:
            out[slow.effect, slow.sensor] = slow
    return out | stamp_quantities(exam, slowest) | delay_quantity(exam)


def _expected(recorded: Examination, simulated: Examination, wanted: Sequence[Wanted]) -> list[Key]:
    """Return what every comparison looks at, whether the two recordings can show it or not."""
    keys: list[Key] = [("accel_bias", "accel"), ("accel_scale", "accel"), ("noise_level", "accel")]
    keys.append(("accel_slow_noise", "accel"))
    if recorded.gyroscope is not None or simulated.gyroscope is not None:
        keys += [(effect, "gyro") for effect in (*GYROSCOPE_ONLY, "noise_level")]
    if not (recorded.is_table or simulated.is_table):
        keys.append((DELAY, "timing"))
    return [*keys, *(w.hypothesis.effect.key for w in wanted)]
