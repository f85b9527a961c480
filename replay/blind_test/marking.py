"""Marking one answer against its key: names, intervals, places in time, and the gain of its model."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stillcal.replay.blind_test.keys import Exam, Key, TrueEffect
from stillcal.replay.blind_test.power import detectability as power
from stillcal.replay.blind_test.world.day import Bins
from stillcal.replay.blind_test.world.forward_model import FORWARD, played
from stillcal.replay.blind_test.world.noise import Colour

ENTAILED = {
    "noise_unequal_axes": {"noise_level"},
    "noise_heavy_tailed": {"noise_level"},
    "accel_quantisation": {"noise_level"},
    "gyro_quantisation": {"noise_level"},
    "bandwidth": {"noise_level", "accel_gyro_time_offset"},
    "lever_arm": {"accel_gyro_time_offset"},
}
"""Names that are true beside another: an axis' noise is part of the level, a coarse step adds noise of
step^2 / 12, a low-pass takes noise off and delays one sensor. They are no misnaming, nor a right name."""

SENSOR_IS_PART = ("noise_level", "noise_unequal_axes", "noise_heavy_tailed", "bandwidth", "thermal_latent")
"""Names that are right only together with the right sensor."""

NOT_COMPARED = {"noise_heavy_tailed", "noise_unequal_axes"}
"""Effects whose `ratio` the documented layout leaves open (of what to what): intervals are not judged."""


@dataclass(frozen=True, slots=True)
class EffectMark:
    """The result for one true effect.

    named: alone, set, unknown, other or missed. given: the first name given. covered: whether each judged
    component lay in its 95 % interval. gain, oracle: nats, None: not judged. overlap: of time spans,
    intersection over union. apart_s: of a step's time. axes: Jaccard index.
    """

    effect: str
    d_prime: float | None
    named: str
    given: str
    covered: list[bool]
    gain: float | None
    oracle: float | None
    overlap: float | None
    apart_s: float | None
    axes: float | None


@dataclass(frozen=True, slots=True)
class Mark:
    """The result of one answer.

    alarmed: whether anything was found. unknown: whether an unknown effect was. false_names: names given that
    are not true.
    """

    name: str
    kind: str
    family: str
    maker: str
    variant: str | None
    full_length: bool
    verdict: str
    alarmed: bool
    unknown: bool
    false_names: list[str]
    effects: list[EffectMark] = field(default_factory=list)

    @property
    def right(self) -> bool:
        """Whether the whole answer is right."""
        if self.kind in ("null", "decoy"):
            return not self.alarmed and self.verdict != "failed"
        if self.kind == "off_catalogue":
            return self.unknown and not self.false_names
        return not self.false_names and all(e.named in ("alone", "set") for e in self.effects)


Finding = dict[str, Any]


def marked(name: str, key: Key, answer: dict[str, Any]) -> Mark:
    """Return the mark of an answer. Findings without the documented layout are ignored."""
    findings = [f for f in answer.get("findings", []) if isinstance(f, dict) and "effect" in f]
    named = [f for f in findings if f["effect"] != "unknown"]
    true = _true_names(key)
    return Mark(
        name,
        key.kind,
        key.family,
        key.maker,
        key.variant,
        key.full_length,
        str(answer.get("verdict", "failed")),
        bool(findings),
        len(named) < len(findings),
        [
            f["effect"]
            for f in named
            if f["effect"] not in true and not _members(f) & {e.effect for e in key.effects}
        ],
        [_effect_marked(effect, key, findings) for effect in key.effects],
    )


def _true_names(key: Key) -> set[str]:
    names = {e.effect for e in key.effects} | set(key.entailed)
    return names.union(*(ENTAILED.get(e.effect, set()) for e in key.effects))


def _members(finding: Finding) -> set[str]:
    """Return the names of the set that a finding stands for."""
    indistinguishable = [a for a in finding.get("alternatives") or [] if a.get("indistinguishable")]
    return {finding["effect"], *(a["effect"] for a in indistinguishable)}


def _effect_marked(truth: TrueEffect, key: Key, findings: list[Finding]) -> EffectMark:
    match = _matching_finding(truth, findings)
    named_alone = match is not None and match["effect"] == truth.effect
    gain, oracle = _score_gain(truth, key, findings)
    place = match or next(
        (f for f in findings if key.kind == "off_catalogue" and f["effect"] == "unknown"), None
    )
    overlap, time_error, axes = (None, None, None) if place is None else _where_scores(truth, place)
    return EffectMark(
        truth.effect,
        truth.d_prime,
        ("alone" if named_alone else "set") if match is not None else _outcome_of_unnamed(findings),
        _first_name(truth, match, findings),
        _covered(truth, match) if match is not None and named_alone else [],
        gain,
        oracle,
        overlap,
        time_error,
        axes,
    )


def _matching_finding(truth: TrueEffect, findings: list[Finding]) -> Finding | None:
    """Return the finding that names an effect, or else one whose set has it."""
    fitting = [f for f in findings if truth.effect not in SENSOR_IS_PART or f.get("sensor") == truth.sensor]
    by_name = [f for f in fitting if f["effect"] == truth.effect]
    return next(iter([*by_name, *(f for f in fitting if truth.effect in _members(f))]), None)


def _outcome_of_unnamed(findings: list[Finding]) -> str:
    if not findings:
        return "missed"
    return "unknown" if all(f["effect"] == "unknown" for f in findings) else "other"


def _first_name(truth: TrueEffect, match: Finding | None, findings: list[Finding]) -> str:
    if match is not None:
        return truth.effect
    return str(findings[0]["effect"]) if findings else "nothing"


def _covered(truth: TrueEffect, finding: Finding) -> list[bool]:
    """Return for each component of each parameter whether its 95 % interval holds the truth."""
    if truth.effect in NOT_COMPARED:
        return []
    covered: list[bool] = []
    for name, parameter in (finding.get("parameters") or {}).items():
        true, interval = (
            truth.parameters.get(name),
            parameter.get("ci95") if isinstance(parameter, dict) else None,
        )
        if true is None or interval is None:
            continue
        bounds = np.asarray(interval, dtype=np.float64)
        if bounds.shape == (*np.shape(true), 2):
            inside = (bounds[..., 0] <= np.asarray(true)) & (np.asarray(true) <= bounds[..., 1])
            covered += [bool(v) for v in np.atleast_1d(inside).ravel()]
    return covered


def _where_scores(truth: TrueEffect, finding: Finding) -> tuple[float | None, float | None, float | None]:
    where, axes = finding.get("where") or {}, set(finding.get("axes") or [])
    begin, end = where.get("t_start"), where.get("t_end")
    overlap = time_error = None
    if begin is not None and end is not None:
        common = min(end, truth.t_end) - max(begin, truth.t_start)
        overlap = max(common, 0.0) / max(max(end, truth.t_end) - min(begin, truth.t_start), 1e-9)
        time_error = abs(begin - truth.t_start) if truth.effect.endswith("_bias_step") else None
    true = set(truth.axes)
    return overlap, time_error, len(true & axes) / len(true | axes) if axes else None


def bins_of(exam: Exam) -> Bins:
    """Return the bins that a key stores."""
    table = {
        k: np.asarray(getattr(exam, k)) for k in ("t", "rest", "force", "temperature", "charging", "drive")
    }
    return Bins(exam.width, **table, since=np.asarray(exam.since))


def _score_gain(truth: TrueEffect, key: Key, findings: list[Finding]) -> tuple[float | None, float | None]:
    """Return the score gain of the answer's model on new noise, and that of the oracle, nats."""
    if key.exam is None or key.kind != "single" or truth.effect not in FORWARD or truth.d_prime is None:
        return None, None
    sensor = "gyro" if truth.sensor == "gyro" else "accel"
    bins = bins_of(key.exam)
    true = np.asarray(getattr(key.exam, sensor))
    colour = Colour(**getattr(key.exam, f"{sensor}_noise"))
    predicted = np.sum([_predicted(bins, f, sensor) for f in findings] + [np.zeros_like(true)], axis=0)
    weight = power.precision(bins, sensor, colour)
    oracle = 0.5 * power.form(weight, true)
    # Effects that only motion shows have no gain at rest.
    return (power.gain(weight, true, predicted), oracle) if oracle > 0.5 else (None, None)


def _predicted(bins: Bins, finding: Finding, sensor: str) -> Any:
    """Return what a finding's model adds to a sensor's bins (m, 3); zeros where it cannot be computed."""
    nothing = np.zeros((bins.t.size, 3))
    if finding.get("sensor") != sensor or finding["effect"] not in FORWARD:
        return nothing
    parameters = {
        k: v.get("value") for k, v in (finding.get("parameters") or {}).items() if isinstance(v, dict)
    }
    parameters.setdefault("at_s", (finding.get("where") or {}).get("t_start"))
    try:
        added = played(bins, finding["effect"], parameters)
    except (KeyError, TypeError, ValueError):
        return nothing
    return added if np.isfinite(added).all() else nothing
