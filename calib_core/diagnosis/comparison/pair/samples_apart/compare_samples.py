"""Values, noise at rest, low-passes and vibrations of two recordings of one motion, at the same stamps."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import MOTION, direct_checks
from stillcal.calib_core.diagnosis.comparison.direct import stamp_quantities
from stillcal.calib_core.diagnosis.comparison.noise import white_noise
from stillcal.calib_core.diagnosis.comparison.of_samples import Reasons, differences_of_samples, in_neither
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.low_pass_in_motion import (
    with_low_passes_in_motion,
)
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.vibrations import (
    of_the_difference,
    shakes_both,
)
from stillcal.calib_core.diagnosis.comparison.quantity import Key, Quantity, subtract, weighed
from stillcal.calib_core.diagnosis.comparison.records import Comparison, NotCompared
from stillcal.calib_core.diagnosis.comparison.stated import Sole, concluded, key_of, told
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.noise.lines.line import TONE, is_line, middle_hz


@dataclass(frozen=True, slots=True)
class FoundAlready:
    """What was found of two recordings before their samples are compared again.

    lines: by sensor, Hz, vibrations that are taken off what one reads less the other; filtered: sensors whose
    low-passes are sought in motion.
    """

    lines: Mapping[str, Sequence[float]] = field(default_factory=dict)
    filtered: Collection[str] = ("accel", "gyro")


def compare_samples(
    exams: tuple[Examination, Examination],
    names: tuple[str, str],
    beside: int = 0,
    known: FoundAlready | None = None,
) -> Comparison:
    """Compare what samples show of a recording and a simulation of one motion, with the same stamps.

    beside: how many effects are compared besides, with which these share their prior odds. known: what was
    found of the two before, nothing by default.
    """
    known = known or FoundAlready()
    more = with_low_passes_in_motion(white_noise.of_both(exams), exams, known.filtered)
    every = [_shares(exam) | noise for exam, noise in zip(exams, more, strict=True)]
    sides = white_noise.without_repeated(every)
    levels = [(white_noise.LEVEL, stream.sensor) for stream in exams[0].streams]
    keys = list(dict.fromkeys([*levels, *sides[0], *sides[1]]))
    both = [key for key in keys if all(key in side for side in sides)]
    reasons = [_reasons(exam) for exam in exams]
    pairs = [subtract(sides[0][key], sides[1][key]) for key in both]
    shown, alone, missing = differences_of_samples(exams, reasons, names, ((), ()))
    pairs += [d for d in shown if _is_compared(key_of(d))]
    alone = [one for one in alone if _is_compared((one[0].effect, one[0].sensor))]
    alone = [one for one in alone if not (is_line(one[0]) and shakes_both(one[0], exams))]
    missing = [n for n in missing if _is_compared((n.effect, n.sensor))]
    missing += [_missing(key, sides, exams, names) for key in keys if key not in both]
    neither, not_both = in_neither(reasons, told(pairs, alone, missing), names)
    looked, found, unsure = _lines(not_both, exams, names, known.lines)
    alone += found
    neither += looked
    not_both = [n for n in not_both if (n.effect, n.sensor) not in looked] + unsure
    count = len(pairs) + len(alone) + len(neither)
    among = max(count + beside, 1)
    pairs = weighed(pairs, among)
    return concluded(pairs, alone, [*missing, *not_both], names, among=among, checks=count)


def _lines(
    untold: Sequence[NotCompared],
    exams: tuple[Examination, Examination],
    names: tuple[str, str],
    known: Mapping[str, Sequence[float]],
) -> tuple[list[Key], list[Sole], list[NotCompared]]:
    """Return where rests tell no vibrations and the readings apart do, those of one, and those of both."""
    looked, found, unsure = list[Key](), list[Sole](), list[NotCompared]()
    for one in untold:
        said = of_the_difference(exams, one.sensor, known.get(one.sensor, ())) if one.effect == TONE else None
        if said is None:
            continue
        alone, of_both = said
        looked.append((one.effect, one.sensor))
        found += alone
        for line in of_both:
            why = f"{' and '.join(names)} both read one of {middle_hz(line):.4g} Hz, of another size or phase"
            unsure.append(NotCompared(TONE, one.sensor, f"{why}: whether motion makes it is not known"))
    return looked, found, unsure


def _is_compared(key: Key) -> bool:
    """Whether an effect can differ where motion and stamps are the same and motion is judged by itself."""
    return key[1] != "timing" and key not in MOTION


def _reasons(exam: Examination) -> Reasons:
    checks = {(c.effect, c.sensor): c.reason for c in direct_checks(exam)}
    return {key: why for key, why in checks.items() if _is_compared(key)}


def _shares(exam: Examination) -> dict[Key, Quantity]:
    """Return what one recording's values show: the share of them that repeat the one before."""
    return {key: one for key, one in stamp_quantities(exam).items() if _is_compared(key)}


def _missing(
    key: Key, sides: Sequence[Mapping[Key, Quantity]], exams: Sequence[Examination], names: Sequence[str]
) -> NotCompared:
    """Say why a quantity is not compared that one of the two does not show."""
    whys = []
    for side, other, exam, name in zip(sides, reversed(sides), exams, names, strict=True):
        if key not in side:
            own = [s for s in exam.streams if s.sensor == key[1]]
            why = [white_noise.why_not_measured(key[0], s, other.get(key)) for s in own]
            whys.append(f"{name}: {why[0] if why else 'no such sensor'}")
    return NotCompared(*key, "; ".join(whys))
