"""The three tables: what is found, what withheld temperature shows, what becomes of injected effects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from stillcal.calib_core.errors import NotSupported
from stillcal.replay.diagnosis.diagnose import diagnose_recording
from stillcal.replay.formats.trace import Recording
from stillcal.replay.real_data import injection
from stillcal.replay.real_data.injection import Injection
from stillcal.replay.real_data.sources import Source, part

Finding = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Row:
    """What is found in one recording. halves, sisters: names found there again, by (effect, sensor)."""

    name: str
    seconds: float
    verdict: str
    findings: list[Finding]
    limits: list[str]
    halves: list[set[tuple[str, str]] | None]


def diagnose(recording: Recording, name: str) -> tuple[str, list[Finding], list[str]]:
    """Return verdict, findings and limits; a refusal is a verdict too."""
    try:
        answer = diagnose_recording(recording, name)
    except NotSupported as refusal:
        return "too little data", [], [str(refusal)]
    limits = list(dict.fromkeys(one["reason"] for one in answer["not_compared"]))
    return answer["verdict"], answer["findings"], limits


def names(findings: Sequence[Finding]) -> set[tuple[str, str]]:
    """Return what findings say, the members of a set that cannot be told apart included."""
    findings_named = {(f["effect"], f["sensor"]) for f in findings}
    return findings_named | {
        (a["effect"], f["sensor"]) for f in findings for a in f["alternatives"] if a["indistinguishable"]
    }


def row(source: Source) -> Row:
    """Diagnose one recording, and either half of it alone where anything is found."""
    t = source.recording.accelerometer.t
    verdict, findings, limits = diagnose(source.recording, source.name)
    halves: list[set[tuple[str, str]] | None] = []
    if findings:
        for first in (0.0, 0.5):
            half = diagnose(part(source.recording, first, first + 0.5), source.name)
            halves.append(None if half[0] == "too little data" else names(half[1]))
    return Row(source.name, float(t[-1] - t[0]), verdict, findings, limits, halves)


def agreement(row: Row, finding: Finding, sisters: Sequence[Row]) -> str:
    """Say where else a finding stands: in the halves of its recording, in the same device's others."""
    key = (finding["effect"], finding["sensor"])
    statements = [
        f"{which} half: {'too short' if half is None else 'yes' if key in half else 'no'}"
        for which, half in zip(("first", "second"), row.halves, strict=True)
    ]
    if sisters:
        again = sum(key in names(s.findings) for s in sisters)
        statements.append(f"same device's other recordings: {again} of {len(sisters)}")
    return "; ".join(statements)


@dataclass(frozen=True, slots=True)
class Injected:
    """What became of an injected effect. said: right, set, unknown, other, nothing; extra: names beside."""

    effect: str
    strength: float
    recording: str
    outcome: str
    extra: tuple[str, ...]


def inject_all(
    sources: Sequence[Source], effects: Sequence[Injection], tick: Callable[[], None]
) -> list[Injected]:
    """Inject every effect at every strength into every recording that has what it needs."""
    results = []
    for source in sources:
        for what in effects:
            if not injection.supports(source.recording, what):
                continue
            before = names(diagnose(injection.control(source.recording, what), source.name)[1])
            for strength in injection.STRENGTHS:
                changed, _ = injection.injected(source.recording, what, strength, seed=1)
                results.append(_outcome_of(source, what, strength, before, diagnose(changed, source.name)[1]))
                tick()
    return results


def _outcome_of(
    source: Source, what: Injection, strength: float, before: set[tuple[str, str]], findings: list[Finding]
) -> Injected:
    """Compare what is found with what the untouched twin has."""
    new = [f for f in findings if (f["effect"], f["sensor"]) not in before]
    named_alone = any(f["effect"] == what.effect for f in new)
    member = any(what.effect in {n for n, _ in names([f])} for f in new)
    extra = [f["effect"] for f in new if what.effect not in {n for n, _ in names([f])}]
    outcome = (
        "right"
        if named_alone
        else "set"
        if member
        else "unknown"
        if "unknown" in extra
        else "other"
        if extra
        else "nothing"
    )
    return Injected(what.effect, strength, source.name, outcome, tuple(sorted(set(extra) - {"unknown"})))


def tally(results: Sequence[Injected]) -> dict[tuple[str, float], Counter[str]]:
    """Count by effect and strength."""
    counted: dict[tuple[str, float], Counter[str]] = {}
    for r in results:
        counted.setdefault((r.effect, r.strength), Counter())[r.outcome] += 1
    return counted
