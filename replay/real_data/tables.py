"""The three tables: what is found, what withheld temperature shows, what becomes of injected effects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.errors import NotSupported
from stillcal.replay.diagnosis.diagnose import diagnose_recording
from stillcal.replay.formats.trace import Recording
from stillcal.replay.real_data import injection
from stillcal.replay.real_data.injection import Injection
from stillcal.replay.real_data.sources import Source, part

Finding = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Row:
    """What is found in one recording. halves: names found in either half, by (effect, sensor).

    compared, not_compared: how many effects could be looked for, and how many not.
    """

    name: str
    seconds: float
    rate_hz: float
    verdict: str
    findings: list[Finding]
    compared: int
    not_compared: int
    halves: list[set[tuple[str, str]] | None]


def diagnose(recording: Recording, name: str) -> dict[str, Any] | None:
    """Return the answer; None where there is too little data."""
    try:
        return diagnose_recording(recording, name)
    except NotSupported:
        return None


def found(recording: Recording, name: str) -> list[Finding]:
    """Return the findings, none with too little data."""
    answer = diagnose(recording, name)
    return [] if answer is None else answer["findings"]


def names(findings: Sequence[Finding]) -> set[tuple[str, str]]:
    """Return what findings say, the members of a set that cannot be told apart included."""
    findings_named = {(f["effect"], f["sensor"]) for f in findings}
    return findings_named | {
        (a["effect"], f["sensor"]) for f in findings for a in f["alternatives"] if a["indistinguishable"]
    }


def row(source: Source) -> Row:
    """Diagnose one recording, and either half of it alone where anything is found."""
    t = source.recording.accelerometer.t
    answer = diagnose(source.recording, source.name)
    told = answer or {"verdict": "too little data", "findings": [], "sensitivity": [], "not_compared": []}
    halves: list[set[tuple[str, str]] | None] = []
    for first in (0.0, 0.5) if told["findings"] else ():
        half = diagnose(part(source.recording, first, first + 0.5), source.name)
        halves.append(None if half is None else names(half["findings"]))
    return Row(
        source.name,
        float(t[-1] - t[0]),
        1.0 / sample_period(t),
        told["verdict"],
        told["findings"],
        len({(s["effect"], s["sensor"]) for s in told["sensitivity"]}),
        len({(n["effect"], n["sensor"]) for n in told["not_compared"]}),
        halves,
    )


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
            before = names(found(injection.control(source.recording, what), source.name))
            for strength in injection.STRENGTHS:
                changed, _ = injection.injected(source.recording, what, strength, seed=1)
                results.append(_outcome_of(source, what, strength, before, found(changed, source.name)))
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
