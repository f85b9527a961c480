"""Scores of the answers about given simulations."""

from __future__ import annotations

from collections.abc import Sequence

from stillcal.replay.blind_test.confidence_bounds import Rate, rate
from stillcal.replay.blind_test.marking import Mark, RelationMark
from stillcal.replay.blind_test.score_lines import Line, at_least, at_most, without_bar

RELATIONS, WRONG_SIGN, WRITTEN_BACK = 0.90, 0.0, 0.90
"""The required scores, fixed before any trial."""


def simulation_lines(marks: Sequence[Mark]) -> list[Line]:
    """Return the scores of given simulations and of phone files written back; none where none was given."""
    return [*_relations(marks), *_written_back(marks)]


def _relations(marks: Sequence[Mark]) -> list[Line]:
    judged = [(m.variant or "", m.relation) for m in marks if m.relation is not None]
    if not judged:
        return []
    told = [(name, r) for name, r in judged if r.can_tell]
    every = [r for _, r in judged]
    lines = [
        at_least("relation right, where it can be told", _share([r for _, r in told], "right"), RELATIONS),
        at_most("relation of the wrong sign", _share(every, "wrong_sign"), WRONG_SIGN),
        without_bar("  undecided, where it can be told", _share([r for _, r in told], "undecided")),
        without_bar("  relation right, of all", _share(every, "right")),
        without_bar("  a false name beside", rate(sum(bool(r.others) for r in every), len(every))),
    ]
    for relation in ("lacking", "too_small", "agreed", "too_large", "superfluous"):
        of_it = [r for _, r in told if r.true == relation]
        lines.append(without_bar(f"  {relation}: right", _share(of_it, "right")))
    for name in sorted({name for name, _ in told}):
        lines.append(without_bar(f"  {name}: right", _share([r for n, r in told if n == name], "right")))
    return lines


def _share(relations: Sequence[RelationMark], outcome: str) -> Rate:
    return rate(sum(r.outcome == outcome for r in relations), len(relations))


def _written_back(marks: Sequence[Mark]) -> list[Line]:
    given = [m for m in marks if m.kind == "phone_file"]
    if not given:
        return []
    matching = rate(sum(m.verdict == "match" for m in given), len(given))
    return [at_least("phone file written back: a fresh day matches", matching, WRITTEN_BACK)]
