"""Scores of all answers: every figure with its 95 % bounds, and the scores required beforehand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from stillcal.replay.blind_test.cases import DECOYS
from stillcal.replay.blind_test.confidence_bounds import Mean, Power, Rate, mean, power, rate
from stillcal.replay.blind_test.marking import EffectMark, Mark
from stillcal.replay.blind_test.world.noise import FAMILIES

FALSE_ALARMS, DETECTION_D, NAMING_D = 0.02, 6.0, 8.0
NAMED, UNKNOWN, MISNAMED, GAIN, PAIRS = 0.90, 0.80, 0.05, 0.80, 0.70
COVERAGE = (0.90, 0.98)
"""The required scores, fixed before any trial."""


@dataclass(frozen=True, slots=True)
class Line:
    """One score.

    low, high: 95 % bounds. n: cases. bar: the required value, '' for none. holds: whether it is reached, None
    without a bar, False where nothing was tested.
    """

    what: str
    value: float | None
    low: float | None
    high: float | None
    n: int
    bar: str = ""
    holds: bool | None = None


@dataclass(frozen=True, slots=True)
class Score:
    """All scores of one solver. confusion: by true effect, how often each name was given, at d' >= 8."""

    solver: str
    lines: list[Line]
    curve: Power | None
    confusion: dict[str, dict[str, int]] = field(default_factory=dict)
    right: Rate | None = None


def scored(solver: str, marks: Sequence[Mark], left_out: Sequence[Mark] | None = None) -> Score:
    """Return a solver's scores. left_out: marks of clear effects with their catalogue entry removed."""
    singles = [(m, e) for m in marks if m.kind == "single" for e in m.effects]
    clear = [(m, e) for m, e in singles if e.d_prime is None or e.d_prime >= NAMING_D]
    nulls = [m for m in marks if m.kind == "null"]
    alarms = rate(sum(m.alarmed for m in nulls), len(nulls))
    scaled = [(e.d_prime, m.alarmed) for m, e in singles if e.d_prime is not None]
    curve = power([d for d, _ in scaled], [detected for _, detected in scaled], alarms.value or 0.0)
    lines = [
        *_false_alarms(marks),
        *_detection(scaled, curve),
        *_naming(clear),
        *_off_catalogue(marks),
        *_models(marks, clear),
        *_places(marks, clear),
        _pairs(marks),
        *_left_out(left_out),
        _failures(marks),
    ]
    confusion: dict[str, Counter[str]] = {}
    for _, e in clear:
        confusion.setdefault(e.effect, Counter())[e.given] += 1
    table = {effect: dict(names) for effect, names in sorted(confusion.items())}
    return Score(
        solver,
        lines,
        curve,
        table,
        rate(sum(m.right for m in _judged_marks(marks)), len(_judged_marks(marks))),
    )


def _judged_marks(marks: Sequence[Mark]) -> list[Mark]:
    """Return the marks that can be right or wrong: all but those of effects too small to see."""
    return [m for m in marks if m.kind != "single" or (m.effects[0].d_prime or NAMING_D) >= NAMING_D]


def _at_most(what: str, share: Rate, bar: float) -> Line:
    holds = share.value is not None and share.value <= bar
    return Line(what, share.value, share.low, share.high, share.n, f"<= {bar:.0%}", holds)


def _at_least(what: str, share: Rate | Mean, bar: float) -> Line:
    holds = share.value is not None and share.value >= bar
    return Line(what, share.value, share.low, share.high, share.n, f">= {bar:.0%}", holds)


def _without_bar(what: str, share: Rate | Mean) -> Line:
    return Line(what, share.value, share.low, share.high, share.n)


def _share(marks: Sequence[Mark], true: Callable[[Mark], bool]) -> Rate:
    return rate(sum(true(m) for m in marks), len(marks))


def _false_alarms(marks: Sequence[Mark]) -> list[Line]:
    nulls = [m for m in marks if m.kind == "null"]
    lines = [
        _at_most(
            f"false alarms, {f} noise",
            _share([m for m in nulls if m.family == f], lambda m: m.alarmed),
            FALSE_ALARMS,
        )
        for f in FAMILIES
    ]
    decoys = [m for m in marks if m.kind == "decoy"]
    lines += [
        _at_most(
            f"false alarms, decoy: {d}",
            _share([m for m in decoys if m.variant == d], lambda m: m.alarmed),
            FALSE_ALARMS,
        )
        for d in DECOYS
    ]
    makers = sorted({m.maker for m in nulls})
    return lines + [
        _without_bar(
            f"false alarms, made by the {k}", _share([m for m in nulls if m.maker == k], lambda m: m.alarmed)
        )
        for k in makers
    ]


def _detection(scaled: list[tuple[float, bool]], curve: Power | None) -> list[Line]:
    value = None if curve is None else curve.d90
    low, high = (None, None) if curve is None else (curve.low, curve.high)
    holds = value is not None and value <= DETECTION_D
    lines = [Line("d' of 90 % detection", value, low, high, len(scaled), f"<= {DETECTION_D:g}", holds)]
    edges = (0.0, 3.0, 5.0, 7.0, 10.0, 15.0, np.inf)
    for low_edge, high_edge in pairwise(edges):
        inside = [detected for d, detected in scaled if low_edge <= d < high_edge]
        span = f"{low_edge:g} to {high_edge:g}" if np.isfinite(high_edge) else f"over {low_edge:g}"
        lines.append(_without_bar(f"detected, d' {span}", rate(sum(inside), len(inside))))
    return lines


def _naming(clear: list[tuple[Mark, EffectMark]]) -> list[Line]:
    right = [m.right for m, _ in clear]
    lines = [
        _at_least(
            f"named right and nothing false beside, d' >= {NAMING_D:g}", rate(sum(right), len(right)), NAMED
        )
    ]
    for named, text in (
        ("alone", "named alone"),
        ("set", "named as a member of a set"),
        ("unknown", "called unknown"),
        ("other", "given another name"),
        ("missed", "missed"),
    ):
        lines.append(_without_bar(f"  {text}", rate(sum(e.named == named for _, e in clear), len(clear))))
    lines.append(
        _without_bar(
            "  with a false name beside", rate(sum(bool(m.false_names) for m, _ in clear), len(clear))
        )
    )
    return lines


def _off_catalogue(marks: Sequence[Mark]) -> list[Line]:
    off_catalogue = [m for m in marks if m.kind == "off_catalogue"]
    return [
        _at_least("off-catalogue called unknown", _share(off_catalogue, lambda m: m.unknown), UNKNOWN),
        _at_most("off-catalogue misnamed", _share(off_catalogue, lambda m: bool(m.false_names)), MISNAMED),
    ]


def _models(marks: Sequence[Mark], clear: list[tuple[Mark, EffectMark]]) -> list[Line]:
    """Score the coverage of intervals and the gains; bounds count each effect once, not each component."""
    judged = [e.covered for m in marks for e in m.effects if e.covered]
    inside = float(np.mean(np.concatenate(judged))) if judged else None
    bounds = rate(round((inside or 0.0) * len(judged)), len(judged))
    holds = inside is not None and COVERAGE[0] <= inside <= COVERAGE[1]
    ratios = [max(e.gain / e.oracle, -1.0) for _, e in clear if e.gain is not None and e.oracle]
    return [
        Line("95 % intervals that hold the truth", inside, bounds.low, bounds.high, len(judged),
             f"{COVERAGE[0]:.0%} to {COVERAGE[1]:.0%}", holds),
        _at_least("held-out gain, of the oracle's", mean(ratios), GAIN),
    ]  # fmt: skip


def _places(marks: Sequence[Mark], clear: list[tuple[Mark, EffectMark]]) -> list[Line]:
    off_catalogue = [e for m in marks if m.kind == "off_catalogue" for e in m.effects]
    lines = [
        _without_bar("overlap of time spans", mean([e.overlap for _, e in clear if e.overlap is not None])),
        _without_bar(
            "overlap of time spans, off-catalogue",
            mean([e.overlap for e in off_catalogue if e.overlap is not None]),
        ),
        _without_bar("overlap of axes", mean([e.axes for _, e in clear if e.axes is not None])),
    ]
    time_errors = [e.apart_s for _, e in clear if e.apart_s is not None]
    return [*lines, _without_bar("steps' time off by, s", mean(time_errors))]


def _pairs(marks: Sequence[Mark]) -> Line:
    pairs = [m for m in marks if m.kind == "pair"]
    both = _share(pairs, lambda m: all(e.named in ("alone", "set") for e in m.effects))
    return _at_least("both effects of a pair found", both, PAIRS)


def _left_out(marks: Sequence[Mark] | None) -> list[Line]:
    if marks is None:
        return []
    true = {m.name: {e.effect for e in m.effects} for m in marks}
    misnamed = [m for m in marks if set(m.false_names) - true[m.name]]
    return [
        _at_least("entry removed: called unknown", _share(marks, lambda m: m.unknown), UNKNOWN),
        _at_most("entry removed: given a neighbour's name", rate(len(misnamed), len(marks)), MISNAMED),
    ]


def _failures(marks: Sequence[Mark]) -> Line:
    failed = _share(marks, lambda m: m.verdict == "failed")
    return Line(
        "answers that broke", failed.value, failed.low, failed.high, failed.n, "none", failed.hits == 0
    )


def compared(scores: Sequence[Score]) -> list[Line]:
    """Return how often each solver was right all in all, and whether the first beats each other."""
    first, lines = scores[0].right, []
    assert first is not None, "scored() always tells how often the solver was right"
    for index, score in enumerate(scores):
        share = score.right
        assert share is not None, "scored() always tells how often the solver was right"
        beaten = None if index == 0 else (first.value or 0.0) > (share.value or 0.0)
        bar = "" if beaten is None else f"below {scores[0].solver}"
        lines.append(
            Line(
                f"whole answer right: {score.solver}",
                share.value,
                share.low,
                share.high,
                share.n,
                bar,
                beaten,
            )
        )
    return lines
