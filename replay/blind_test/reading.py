"""Reading an answer: the JSON of `stillcal diagnose`, schema 2, as plain records for the marking."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A parameter's value, of any shape, and its 95 % interval, of that shape and two; None for none."""

    value: Array
    ci95: Array | None

    def covers(self, truth: Any, level: float) -> list[bool]:
        """Return for each component whether its interval of a level, 0.95 or 0.9, contains the truth.

        The 90 % interval is the part of the 95 % interval that it would be with normal errors.
        """
        true = np.asarray(truth, dtype=np.float64)
        if self.ci95 is None or self.ci95.shape != (*true.shape, 2) or self.value.shape != true.shape:
            return []
        share = {0.95: 1.0, 0.9: 1.6449 / 1.9600}[level]
        low, high = (self.value + share * (self.ci95[..., i] - self.value) for i in (0, 1))
        return [bool(v) for v in np.atleast_1d((low <= true) & (true <= high)).ravel()]


@dataclass(frozen=True, slots=True, eq=False)
class Statement:
    """One finding. members: names that the recording cannot tell from it, its own included."""

    effect: str
    sensor: str
    members: frozenset[str]
    axes: frozenset[str] = frozenset()
    t_start: float | None = None
    t_end: float | None = None
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    probability: float | None = None
    relation: str | None = None
    reference_c: float = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """A whole answer. verdict: as in schema 2, or `failed`, or `too_little_data`."""

    verdict: str
    statements: tuple[Statement, ...] = ()
    agreed: tuple[tuple[str, str], ...] = ()

    @property
    def unknown(self) -> bool:
        """Whether something is said to have no name."""
        return any(s.effect == "unknown" for s in self.statements)

    @property
    def named(self) -> list[Statement]:
        """The findings that have a name."""
        return [s for s in self.statements if s.effect != "unknown"]


def read(answer: Mapping[str, Any]) -> Reading:
    """Read an answer; findings without the documented layout are left out."""
    findings = [f for f in answer.get("findings") or [] if isinstance(f, dict) and "effect" in f]
    agreed = [a for a in answer.get("agreed") or [] if isinstance(a, dict)]
    return Reading(
        str(answer.get("verdict", "failed")),
        tuple(_statement(f) for f in findings),
        tuple((str(a.get("effect")), str(a.get("sensor"))) for a in agreed),
    )


def _statement(finding: Mapping[str, Any]) -> Statement:
    where, effect = finding.get("where") or {}, str(finding["effect"])
    alternatives = finding.get("alternatives") or []
    alike = [str(a["effect"]) for a in alternatives if isinstance(a, dict) and a.get("indistinguishable")]
    parameters = {
        k: _estimate(v) for k, v in (finding.get("parameters") or {}).items() if isinstance(v, dict)
    }
    return Statement(
        effect,
        str(finding.get("sensor", "")),
        frozenset([effect, *alike]),
        frozenset(finding.get("axes") or []),
        where.get("t_start"),
        where.get("t_end"),
        {k: v for k, v in parameters.items() if v is not None},
        finding.get("probability"),
        finding.get("relation"),
        float((finding.get("reference") or {}).get("temperature_c", 25.0)),
    )


def _estimate(parameter: Mapping[str, Any]) -> Estimate | None:
    try:
        value = np.asarray(parameter["value"], dtype=np.float64)
        interval = parameter.get("ci95")
        return Estimate(value, None if interval is None else np.asarray(interval, dtype=np.float64))
    except (KeyError, TypeError, ValueError):
        return None
