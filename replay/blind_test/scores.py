"""Scores of all answers: every figure with its 95 % bounds, and the scores required beforehand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from stillcal.replay.blind_test.confidence_bounds import Power, Rate, mean, power, rate
from stillcal.replay.blind_test.designs import DECOYS
from stillcal.replay.blind_test.marking import GIVEN_A_SIMULATION, NAMELESS, EffectMark, Mark
from stillcal.replay.blind_test.score_lines import Line, at_least, at_most, without_bar
from stillcal.replay.blind_test.simulations.scores import simulation_lines
from stillcal.replay.blind_test.world.grounds import GROUNDS
from stillcal.replay.blind_test.world.noise import FAMILIES

FALSE_ALARMS, FAMILY_ALARMS, DETECTION_D, NAMING_D = 0.01, 0.03, 7.0, 8.0
NAMED, UNKNOWN, MISNAMED, PAIRS = 0.93, 0.80, 0.04, 0.90
COVERAGE_95, COVERAGE_90 = (0.93, 0.97), (0.87, 0.93)
"""The required scores, fixed before any trial."""

RELIABILITY = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 0.999, np.inf)
"""Bounds of the classes of stated probability."""


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
    alone = [m for m in marks if m.kind not in GIVEN_A_SIMULATION]
    clear = _clear(alone)
    curve = _power(alone)
    lines = [
        *(_of_recordings(alone, clear, curve, left_out) if alone else []),
        *simulation_lines(marks),
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


def _clear(marks: Sequence[Mark]) -> list[tuple[Mark, EffectMark]]:
    """Return the single effects that are large enough to be named."""
    singles = [(m, e) for m in marks if m.kind == "single" for e in m.effects]
    return [(m, e) for m, e in singles if e.d_prime is None or e.d_prime >= NAMING_D]


def _scaled(marks: Sequence[Mark]) -> list[tuple[float, bool]]:
    """Return d' of single effects, and whether anything was found."""
    singles = [(e.d_prime, m.alarmed) for m in marks if m.kind == "single" for e in m.effects]
    return [(d, alarmed) for d, alarmed in singles if d is not None]


def _power(marks: Sequence[Mark]) -> Power | None:
    nulls, scaled = [m for m in marks if m.kind == "null"], _scaled(marks)
    alarms = rate(sum(m.alarmed for m in nulls), len(nulls))
    return power([d for d, _ in scaled], [detected for _, detected in scaled], alarms.value or 0.0)


def _of_recordings(
    marks: Sequence[Mark],
    clear: list[tuple[Mark, EffectMark]],
    curve: Power | None,
    left_out: Sequence[Mark] | None,
) -> list[Line]:
    """Return the scores of recordings that are diagnosed alone."""
    return [
        *_false_alarms(marks),
        *_detection(_scaled(marks), curve),
        *_naming(clear),
        *_near_shapes(marks),
        *_off_catalogue(marks, "off_catalogue", "off-catalogue"),
        *_off_catalogue(marks, "reserve", "off-catalogue in reserve"),
        *_models(marks, clear),
        *_reliability(marks),
        *_places(marks, clear),
        _pairs(marks),
        *_left_out(left_out),
    ]


def _judged_marks(marks: Sequence[Mark]) -> list[Mark]:
    """Return the marks that can be right or wrong: all but those of effects too small to see."""
    alone = [m for m in marks if m.kind not in GIVEN_A_SIMULATION]
    return [m for m in alone if m.kind != "single" or (m.effects[0].d_prime or NAMING_D) >= NAMING_D]


def _share(marks: Sequence[Mark], true: Callable[[Mark], bool]) -> Rate:
    return rate(sum(true(m) for m in marks), len(marks))


def _false_alarms(marks: Sequence[Mark]) -> list[Line]:
    quiet = [m for m in marks if m.kind in ("null", "decoy")]
    nulls = [m for m in quiet if m.kind == "null"]

    def family(text: str, members: list[Mark]) -> Line:
        return at_most(f"false alarms, {text}", _share(members, lambda m: m.alarmed), FAMILY_ALARMS)

    lines = [at_most("false alarms, nulls and decoys", _share(quiet, lambda m: m.alarmed), FALSE_ALARMS)]
    lines += [family(f"{f} noise", [m for m in nulls if m.family == f]) for f in FAMILIES]
    lines += [family(f"on {g}", [m for m in nulls if m.ground == g]) for g in GROUNDS]
    lines += [family(f"decoy: {d}", [m for m in quiet if m.variant == d]) for d in DECOYS]
    return lines + [
        without_bar(
            f"false alarms, made by the {k}", _share([m for m in quiet if m.maker == k], lambda m: m.alarmed)
        )
        for k in sorted({m.maker for m in quiet})
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
        lines.append(without_bar(f"detected, d' {span}", rate(sum(inside), len(inside))))
    return lines


def _naming(clear: list[tuple[Mark, EffectMark]]) -> list[Line]:
    right = [m.right for m, _ in clear]
    lines = [
        at_least(
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
        lines.append(without_bar(f"  {text}", rate(sum(e.named == named for _, e in clear), len(clear))))
    lines.append(
        without_bar(
            "  with a false name beside", rate(sum(bool(m.false_names) for m, _ in clear), len(clear))
        )
    )
    return lines


def _off_catalogue(marks: Sequence[Mark], kind: str, text: str) -> list[Line]:
    chosen = [m for m in marks if m.kind == kind and _far_from_names(m)]
    if kind == "reserve" and not chosen:
        return []
    lines = [
        at_least(f"{text} called unknown", _share(chosen, lambda m: m.unknown), UNKNOWN),
        at_most(f"{text} misnamed", _share(chosen, lambda m: bool(m.false_names)), MISNAMED),
    ]
    for variant in sorted({m.variant or "" for m in chosen}):
        of_it = [m for m in chosen if m.variant == variant]
        lines.append(without_bar(f"  {variant}: unknown", _share(of_it, lambda m: m.unknown)))
    return lines


def _far_from_names(mark: Mark) -> bool:
    """Return whether names leave enough of a hidden kind to be seen; not where a phone had no room for it."""
    return mark.misfit is None or mark.misfit >= NAMING_D


def _near_shapes(marks: Sequence[Mark]) -> list[Line]:
    """Score near-shapes; of those sized by it, only such as the pure form leaves enough of."""
    near = [m for m in marks if m.kind == "near_shape" and _far_from_names(m)]
    outcomes = {
        "stated": "named, the misfit stated",
        "fitted": "named, and wholly fitted",
        "unknown": "called unknown",
        "plain": "the pure form stated as the whole",
        "other": "a false name",
        "missed": "missed",
    }
    return [
        at_most("near-shapes plainly identified", _share(near, lambda m: m.near == "plain"), MISNAMED),
        at_most("near-shapes misnamed", _share(near, lambda m: m.near == "other"), MISNAMED),
        *(
            without_bar(f"  {text}", _share(near, lambda m, o=outcome: m.near == o))  # type: ignore[misc]
            for outcome, text in outcomes.items()
        ),
    ]


def _models(marks: Sequence[Mark], clear: list[tuple[Mark, EffectMark]]) -> list[Line]:
    """Score the coverage of intervals and the gains."""
    judged = [e for m in marks for e in m.effects if e.covered]
    ratios = [max(e.gain / e.oracle, -1.0) for _, e in clear if e.gain is not None and e.oracle]
    return [
        _coverage("95 % intervals that hold the truth", [e.covered for e in judged], COVERAGE_95),
        _coverage("90 % intervals that hold the truth", [e.covered_90 for e in judged], COVERAGE_90),
        without_bar("held-out gain, of the oracle's", mean(ratios)),
    ]


def _coverage(what: str, covered: list[list[bool]], bar: tuple[float, float]) -> Line:
    """Return the share of components that are covered; its bounds count each effect once."""
    inside = float(np.mean(np.concatenate(covered))) if covered else None
    bounds = rate(round((inside or 0.0) * len(covered)), len(covered))
    holds = inside is not None and bar[0] <= inside <= bar[1]
    return Line(what, inside, bounds.low, bounds.high, len(covered), f"{bar[0]:.0%} to {bar[1]:.0%}", holds)


def _reliability(marks: Sequence[Mark]) -> list[Line]:
    """Return by classes of stated probability how many are true, which must be as many as stated."""
    claims = [c for m in marks for c in m.claims]
    lines = []
    for low, high in pairwise(RELIABILITY):
        chosen = [c for c in claims if low <= c.probability < high]
        share = rate(sum(c.true for c in chosen), len(chosen))
        stated = float(np.mean([c.probability for c in chosen])) if chosen else None
        what = f"findings of probability {low:g} to {min(high, 1.0):g} that are true"
        if stated is None:
            lines.append(without_bar(what, share))
        else:
            holds = share.low <= stated <= share.high
            lines.append(
                Line(what, share.value, share.low, share.high, share.n, f"{stated:.2%} stated", holds)
            )
    tried = any(c.probability is not None for c in claims)
    return lines if tried else [Line("findings with a probability", None, None, None, 0, "stated", False)]


def _places(marks: Sequence[Mark], clear: list[tuple[Mark, EffectMark]]) -> list[Line]:
    off_catalogue = [e for m in marks if m.kind in NAMELESS for e in m.effects]
    lines = [
        without_bar("overlap of time spans", mean([e.overlap for _, e in clear if e.overlap is not None])),
        without_bar(
            "overlap of time spans, without a name",
            mean([e.overlap for e in off_catalogue if e.overlap is not None]),
        ),
        without_bar("overlap of axes", mean([e.axes for _, e in clear if e.axes is not None])),
    ]
    time_errors = [e.apart_s for _, e in clear if e.apart_s is not None]
    return [*lines, without_bar("steps' time off by, s", mean(time_errors))]


def _pairs(marks: Sequence[Mark]) -> Line:
    pairs = [m for m in marks if m.kind == "pair"]
    both = _share(pairs, lambda m: all(e.named in ("alone", "set") for e in m.effects))
    return at_least("both effects of a pair found", both, PAIRS)


def _left_out(marks: Sequence[Mark] | None) -> list[Line]:
    if marks is None:
        return []
    true = {m.name: {e.effect for e in m.effects} for m in marks}
    misnamed = [m for m in marks if set(m.false_names) - true[m.name]]
    return [
        at_least("entry removed: called unknown", _share(marks, lambda m: m.unknown), UNKNOWN),
        at_most("entry removed: given a neighbour's name", rate(len(misnamed), len(marks)), MISNAMED),
    ]


def _failures(marks: Sequence[Mark]) -> Line:
    failed = _share(marks, lambda m: m.verdict == "failed")
    return Line(
        "answers that broke",
        failed.value,
        failed.low,
        failed.high,
        failed.n,
        "none",
        failed.n > 0 and failed.hits == 0,
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
