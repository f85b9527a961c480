"""`stillcal diagnose REC --simulated SIM`: where SIM differs from REC, by what physics, by how much.

The answer is JSON schema 2 (docs/diagnosis.md): the parameters of both, their difference with its interval,
what agrees, what could not be compared and why, and how small a difference would have been seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.compare import Comparison, Discrepancy, compare, p_of
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Quantity
from stillcal.calib_core.diagnosis.diagnose import Examination, examine
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.errors import NotSupported
from stillcal.replay.diagnosis.corrected import Corrected, correct
from stillcal.replay.diagnosis.diagnose import charging_events, claims_of
from stillcal.replay.diagnosis.relation_text import statement
from stillcal.replay.formats.trace import Recording

SCHEMA = 2
NORMAL_95 = 1.96
"""Half the width of a 95 % interval of a normal distribution, in standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A recording against a simulation, before and after the simulation was corrected."""

    recorded: Examination
    simulated: Examination
    before: Comparison
    after: Comparison | None
    corrected: Corrected | None
    answer: dict[str, Any]


def judge_simulation(
    recording: Recording, simulation: Recording, show_stage: Callable[[str], None] = lambda stage: None
) -> Judged:
    """Compare a recording with a simulation's. Raises NotSupported where either has too little data."""
    names = (recording.name, simulation.name)
    exams = [_examined(r, show_stage) for r in (recording, simulation)]
    show_stage("comparing")
    before = compare(exams[0], exams[1], names)
    after, corrected = None, None
    if before.discrepancies:
        biases = {
            d.simulated.sensor: d.simulated.value
            for d in before.compared
            if d.simulated.effect in ("accel_bias", "gyro_bias")
        }
        corrected = correct(simulation, before.discrepancies, biases)
        again = _examined(corrected.recording, show_stage, f"{simulation.name} with the differences put in")
        after = compare(exams[0], again, names)
    p_after = before.p if after is None or corrected is None else _without(after, corrected.left_out)
    answer = {
        "schema": SCHEMA,
        "recording": names[0],
        "simulation": names[1],
        "verdict": before.verdict(p_after),
        "findings": [_finding(d, exams, names) for d in before.discrepancies],
        "agreed": [
            {"effect": d.recorded.effect, "sensor": d.recorded.sensor, "parameters": _parameters(d.recorded)}
            for d in before.agreed
        ],
        "not_compared": [
            {"effect": n.effect, "sensor": n.sensor, "reason": n.reason}
            for n in (*before.not_compared, *before.undecided)
        ],
        "sensitivity": [row for d in before.compared for row in _sensitivity(d, before.comparisons)],
        "fit": {
            "p_before": before.p,
            "p_after": p_after,
            "not_put_in": [] if corrected is None else corrected.left_out,
        },
    }
    return Judged(exams[0], exams[1], before, after, corrected, answer)


def _examined(recording: Recording, show_stage: Callable[[str], None], name: str = "") -> Examination:
    show_stage(f"examining {name or recording.name}")
    try:
        return examine(
            recording.accelerometer, recording.gyroscope, charging_events(recording), claims_of(recording)
        )
    except NotSupported as refusal:
        raise NotSupported(f"{recording.name}: {refusal.reason}", refusal.missing) from refusal


def _without(comparison: Comparison, left_out: Sequence[str]) -> float:
    """Return p of no difference but those that could not be put into samples."""
    factors = [d.log_bayes_factor for d in comparison.compared if d.recorded.effect not in left_out]
    factors += [
        d.log_bayes_factor
        for d in comparison.discrepancies
        if d.difference is None and d.effect not in left_out
    ]
    return p_of(factors)


def _finding(one: Discrepancy, exams: Sequence[Examination], names: tuple[str, str]) -> dict[str, Any]:
    stated = one.recorded or one.simulated or _stated(one, exams)
    out: dict[str, Any] = {
        "effect": one.effect,
        "sensor": one.sensor,
        "axes": one.axes,
        "where": {
            "t_start": one.where.t_start,
            "t_end": one.where.t_end,
            "band_hz": list(one.where.band_hz),
            "driver": one.where.driver,
        },
        "parameters": {},
        "alternatives": [] if stated is None else [_alternative(a) for a in stated.alternatives],
        "relation": one.relation,
        "probability": one.probability,
        "difference": {},
        "simulated": {},
        "evidence": {"log_bayes_factor": one.log_bayes_factor},
    }
    if one.difference is not None:
        out["parameters"] = _parameters(one.difference.recorded)
        out["simulated"] = _parameters(one.difference.simulated)
        out["difference"] = _difference(one.difference)
        if one.difference.recorded.reference:
            out["reference"] = dict(one.difference.recorded.reference)
    else:
        own = one.recorded or one.simulated
        assert own is not None, "what has no difference was found in one of the two"
        out["parameters" if one.recorded else "simulated"] = _plain_parameters(own)
    if stated is not None and one.relation in ("lacking", "superfluous") and stated.evidence.folds:
        out["evidence"] |= {
            "heldout_log_score_gain": stated.evidence.heldout_log_score_gain,
            "heldout_rmse_before": stated.evidence.heldout_rmse_before,
            "heldout_rmse_after": stated.evidence.heldout_rmse_after,
            "folds": stated.evidence.folds,
        }
    out["statement"] = statement(out, names)
    return out


def _stated(one: Discrepancy, exams: Sequence[Examination]) -> Finding | None:
    """Return the finding by which one of the two recordings stated the effect; None where neither did."""
    of = exams[1] if one.relation == "superfluous" else exams[0]
    found = [
        s.finding for s in of.statements if (s.finding.effect, s.finding.sensor) == (one.effect, one.sensor)
    ]
    return found[0] if found else None


def _alternative(one: Any) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "heldout_log_score_gain": one.heldout_log_score_gain,
        "indistinguishable": one.indistinguishable,
    }


def _plain_parameters(finding: Finding) -> dict[str, Any]:
    """Return a single recording's parameters; no interval where it has none."""
    out: dict[str, Any] = {}
    for name, p in finding.parameters.items():
        out[name] = {"value": p.value, "unit": p.unit}
        if not _flat(p.value, p.ci95):
            out[name]["ci95"] = p.ci95
    return out


def _flat(value: Any, ci95: Any) -> bool:
    """Whether an interval is only the value twice, which is none."""
    if ci95 is None:
        return True
    ends = np.asarray(ci95, dtype=np.float64).reshape(-1, 2)
    return bool((ends[:, 0] == ends[:, 1]).all())


def _parameters(quantity: Quantity) -> dict[str, Any]:
    """Return values with 95 % intervals, part by part; of logarithms, the numbers themselves."""
    low, high = quantity.value - NORMAL_95 * quantity.sigma, quantity.value + NORMAL_95 * quantity.sigma
    value = quantity.value
    if quantity.logarithmic:
        value, low, high = np.exp(value), np.exp(low), np.exp(high)
    return _by_part(quantity, value, low, high)


def _difference(difference: Difference) -> dict[str, Any]:
    """Return what to add to the simulation, with 95 % intervals; of positive numbers the ratio too."""
    recorded, simulated = difference.recorded, difference.simulated
    if not recorded.logarithmic:
        half = NORMAL_95 * difference.sigma
        return _by_part(recorded, difference.value, difference.value - half, difference.value + half)
    one, other = np.exp(recorded.value), np.exp(simulated.value)
    half = NORMAL_95 * np.hypot(one * recorded.sigma, other * simulated.sigma)
    out = _by_part(recorded, one - other, one - other - half, one - other + half)
    spread = np.exp(NORMAL_95 * difference.sigma)
    ratio = np.exp(difference.value)
    ci = np.stack([ratio / spread, ratio * spread], axis=-1)
    return out | {"ratio": {"value": ratio.tolist(), "ci95": ci.tolist(), "unit": "1"}}


def _by_part(quantity: Quantity, value: Array, low: Array, high: Array) -> dict[str, Any]:
    out, first = {}, 0
    for part in quantity.parts:
        rows = slice(first, first + part.count)
        first += part.count
        shape: tuple[int, ...] = (3, 3) if part.count == 9 else (part.count,)
        ci = np.stack([low[rows], high[rows]], axis=-1).reshape(*shape, 2)
        values = value[rows].reshape(shape)
        out[part.name] = {
            "value": values.tolist() if part.count > 1 else float(values[0]),
            "ci95": ci.tolist() if part.count > 1 else ci[0].tolist(),
            "unit": part.unit,
        }
    return out


def _sensitivity(difference: Difference, comparisons: int) -> list[dict[str, Any]]:
    """Return, part by part, the smallest difference on one axis that would be stated nine times in ten."""
    recorded = difference.recorded
    shown = recorded.informed & difference.simulated.informed
    least = difference.visible_from(max(comparisons, 1))
    if recorded.logarithmic:
        least = np.exp(np.minimum(recorded.value, difference.simulated.value)) * np.expm1(least)
        shown = np.ones(least.size, dtype=np.bool_)
    out, first = [], 0
    for part in recorded.parts:
        rows = np.arange(first, first + part.count)
        first += part.count
        if shown[rows].any():
            out.append(
                {
                    "effect": recorded.effect,
                    "sensor": recorded.sensor,
                    "parameter": part.name,
                    "smallest_seen_90": float(least[rows][shown[rows]].max()),
                    "unit": part.unit,
                }
            )
    return out
