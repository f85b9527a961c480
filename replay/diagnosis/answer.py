"""The answer in plain values, JSON schema 2: one layout for every kind of simulation.

docs/comparison.md describes it. A field without a meaning for a finding is absent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.codec import jsonable
from stillcal.calib_core.diagnosis.comparison.coverage.sensitivity import Smallest
from stillcal.calib_core.diagnosis.comparison.direct import MEASURED_ELSEWHERE
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import UNEQUAL, shown_ratios
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Part, Quantity
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy, NotCompared, p_of
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95, vector
from stillcal.calib_core.diagnosis.model.records import Alternative, Finding, Parameter
from stillcal.calib_core.diagnosis.slow.estimate import GRID_PARAMETERS
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.diagnosis.words.correction_code import to_paste
from stillcal.replay.diagnosis.words.moments import with_moments
from stillcal.replay.diagnosis.words.names import BUILT_IN
from stillcal.replay.diagnosis.words.relation_text import statement

SCHEMA = 2

_OF_TIME = {"tau_s", "period_s", "frequency", "cutoff", "highest_rate", "lowest_rate"}
SCALE_BY_AXIS = Part("scale", "1", 3)
"""An accelerometer's scale by rests: its common factor looks like another gravity."""

_OF_FORM = {"exchange", "miss"}
WITHOUT_ZERO = frozenset({"limit", "ratio", "order", "longest", *_OF_TIME, *_OF_FORM})
"""Parameters of which an ideal sensor has no value that could be written as a number, or added to."""


@dataclass(frozen=True, slots=True)
class Fit:
    """How well the simulation fits before and after what was found was put into it.

    p_after: None where the corrected simulation could not be played. not_put_in: what could not be added;
    what has a name counts in neither, something unknown in both. still_different: effect and sensor of
    what differs in spite of the correction.
    """

    p_before: float
    p_after: float | None
    not_put_in: Sequence[str] = ()
    still_different: Sequence[tuple[str, str]] = ()

    @classmethod
    def of(cls, before: Comparison, after: Comparison | None, not_put_in: Sequence[str] = ()) -> Fit:
        """Return the fit of two comparisons, both without what has a name and could not be put in.

        What has no name was not put in either, and so differs afterwards as it did before, whether the
        second comparison sees it or not.
        """
        known = [effect for effect in not_put_in if effect != "unknown"]
        if after is None:
            return cls(before.p(known), None, not_put_in)
        nameless = {"unknown"} & set(not_put_in)
        left = [d for d in after.discrepancies if d.effect not in not_put_in]
        left += [d for d in before.discrepancies if d.effect in nameless]
        still = list(dict.fromkeys((d.effect, d.sensor) for d in left))
        if all(d.effect in not_put_in for d in before.discrepancies):
            return cls(before.p(known), before.p(known), not_put_in, still)
        nats = [n for effect, n in after.evidence if effect not in not_put_in]
        nats += [n for effect, n in before.evidence if effect in nameless]
        return cls(before.p(known), p_of(nats), not_put_in, still)

    def without_own_constants(self) -> Fit:
        """Return it for a simulation that has the recording's own constants, which cannot differ.

        Where something unknown is left, what of it looks like a constant went into them.
        """
        sensors = {sensor for effect, sensor in self.still_different if effect == "unknown"}
        own = {(f"{sensor}_{what}", sensor) for sensor in sensors for what in ("bias", "scale")}
        return replace(self, still_different=[one for one in self.still_different if one not in own])

    def plain(self) -> dict[str, Any]:
        """Return the fields that have a value."""
        after = {} if self.p_after is None else {"p_after": self.p_after}
        left = [{"effect": effect, "sensor": sensor} for effect, sensor in self.still_different]
        return {
            "p_before": self.p_before,
            **after,
            "not_put_in": list(dict.fromkeys(self.not_put_in)),
            "still_different": left,
        }


def answer_of(
    before: Comparison,
    names: tuple[str, str],
    fit: Fit,
    stated: Mapping[tuple[str, str, str], Finding],
    temperature: Array | None,
) -> dict[str, Any]:
    """Return a comparison as plain values.

    temperature: degC of the recording's static bins, from whose mean a slope counts where the comparison does
    not say otherwise; None without a thermometer. names: of the recording and the simulation. stated: the
    findings that the recording ("recorded") or the simulation ("simulated") makes by itself, by side, effect
    and sensor: they have what a difference lacks.
    """
    mean = None if temperature is None or not temperature.size else float(temperature.mean())
    answer: dict[str, Any] = {
        "schema": SCHEMA,
        "recording": names[0],
        "simulation": names[1],
        "verdict": before.verdict(fit.p_after),
        "findings": [
            _finding(d, names, stated, mean, not_told_apart(d, before.smallest)) for d in before.discrepancies
        ],
        "agreed": [
            *(_agreed(d.recorded) for d in before.agreed),
            *(_agreed(c.quantity) | {"note": c.note} for c in before.common),
        ],
        "not_compared": [
            _not_compared(n) for n in (*before.not_compared, *before.undecided, *before.on_some_axes())
        ],
        "checks": {"made": before.comparisons, "of": before.comparisons + len(before.not_compared)},
        "sensitivity": [_smallest(s) for s in before.smallest],
        "fit": fit.plain(),
    }
    return dict(jsonable(answer))


def findings_stated(findings: Sequence[Finding], side: str) -> dict[tuple[str, str, str], Finding]:
    """Return findings by side, effect and sensor; of several of one kind the first."""
    return {(side, f.effect, f.sensor): f for f in reversed(findings)}


def _agreed(quantity: Quantity) -> dict[str, Any]:
    return {"effect": quantity.effect, "sensor": quantity.sensor, "parameters": _values(quantity)}


def _not_compared(one: NotCompared) -> dict[str, Any]:
    out = {"effect": one.effect, "sensor": one.sensor, "reason": one.reason}
    return out if one.probability is None else out | {"probability": one.probability}


def _smallest(one: Smallest) -> dict[str, Any]:
    out: dict[str, Any] = {
        "effect": one.effect,
        "sensor": one.sensor,
        "parameter": one.parameter,
        "smallest_seen_90": one.value,
        "unit": one.unit,
    }
    out |= {"reference": one.reference} if one.reference else {}
    out |= {"not_on": list(one.hidden)} if one.hidden else {}
    return out | ({"reason": one.reason} if one.reason else {})


def _finding(
    one: Discrepancy,
    names: tuple[str, str],
    stated: Mapping[tuple[str, str, str], Finding],
    mean_temperature: float | None,
    alike: str = "",
) -> dict[str, Any]:
    side = "simulated" if one.relation == "superfluous" else "recorded"
    own = one.recorded or one.simulated or stated.get((side, one.effect, one.sensor))
    # What is measured in both needs no rival that one recording by itself could not tell.
    in_both = one.difference is not None and one.effect.endswith(MEASURED_ELSEWHERE)
    alternatives = [*([] if own is None or in_both else own.alternatives), *one.alternatives]
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
        "alternatives": [_alternative(a) for a in alternatives],
        "relation": one.relation,
        "probability": one.true,
        "difference": {},
        "simulated": {},
        "evidence": {"log_bayes_factor": one.log_bayes_factor},
    }
    out |= _of_both(one.difference) if one.difference is not None else _of_one(one, names)
    if one.of_either:
        out |= {"of_either": True}
        if one.difference is None or not one.difference.simulated.sigma.any():  # neither can show it
            out["simulated"] = {}
    if one.effect == UNEQUAL and one.difference is not None:
        out |= _with_imbalance(out, one.difference, one.axes[0])
    if one.effect.endswith("_temperature") and mean_temperature is not None:
        at = {"temperature_c": mean_temperature, "mean_temperature_c": mean_temperature}
        out["reference"] = at | out.get("reference", {})
    if own is not None and one.relation in ("lacking", "superfluous"):
        out["evidence"] |= _held_out(own)
        told = {k: _parameter(p) for k, p in own.parameters.items() if k in GRID_PARAMETERS}
        out["simulated" if one.relation == "superfluous" else "parameters"] |= told
    if one.departure is not None:
        out["departure"] = asdict(one.departure) | {"probability": one.departure.probability}
    out |= {"put_right": one.put_right} if one.put_right else {}
    found = one.recorded or one.simulated
    observed, remark = ("", "") if found is None else (found.observed, found.remark)
    said = " ".join(filter(None, (statement(out, names, observed), remark, alike, one.note)))
    out["statement"] = with_moments(said)
    out |= {"assumption": one.note} if one.note else {}
    return out | to_paste(out)


def not_told_apart(one: Discrepancy, smallest: Sequence[Smallest]) -> str:
    """Say which nonlinearity would look like a difference of the accelerometer's bias; "" where none would.

    Where the phone lies on its faces, a quadratic term moves gravity's length there as a bias does.
    """
    if one.effect != "accel_bias" or one.difference is None:
        return ""
    like = float(np.abs(one.difference.value).max()) / STANDARD**2
    seen = [s.value for s in smallest if (s.effect, s.parameter) == ("accel_nonlinearity", "quadratic")]
    if any(value < like for value in seen):
        return ""
    what = f"a nonlinearity of {like:.2g} 1/(m/s^2), of the square of the force"
    return f"The attitudes in which the phone lay do not tell it from {what}."


def _of_both(difference: Difference) -> dict[str, Any]:
    """Return what two recordings' quantities are, and how they differ."""
    out = {
        "parameters": _values(difference.recorded),
        "simulated": _values(difference.simulated),
        "difference": _difference(difference),
    }
    reference = dict(difference.recorded.reference)
    return out | ({"reference": reference} if reference else {})


def _with_imbalance(sides: Mapping[str, Any], difference: Difference, axis: str) -> dict[str, Any]:
    """Return both sides, and how they differ, with the ratios of densities to that of the two even axes."""
    one, other = (shown_ratios(q, axis) for q in (difference.recorded, difference.simulated))
    apart = one[0] - other[0], np.hypot(one[1], other[1])
    by_side = {"parameters": one, "simulated": other, "difference": apart}
    return {
        side: {**sides[side], "ratio": asdict(vector(value, error, "1"))}
        for side, (value, error) in by_side.items()
    }


def _of_one(one: Discrepancy, names: tuple[str, str]) -> dict[str, Any]:
    """Return what one of the two has and the other has nothing of."""
    own = one.recorded or one.simulated
    assert own is not None, "what has no difference was found in one of the two"
    values = {name: _parameter(p) for name, p in own.parameters.items()}
    if one.recorded is None:
        return {"simulated": values, "difference": {k: _negated(v) for k, v in _zeroed(values).items()}}
    out = {"parameters": values, "difference": _zeroed(values)}
    out["simulated"] = {k: _nothing_of(v) for k, v in _zeroed(values).items()}
    if one.effect == "noise_level" and names[1] == BUILT_IN:
        out["simulated"] = {"ratio": {"value": 1.0, "ci95": [1.0, 1.0], "unit": "1"}}
    return out


def _zeroed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of which nothing is a value too."""
    return {k: v for k, v in values.items() if k not in WITHOUT_ZERO}


def _nothing_of(parameter: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameter of a simulation that lacks the effect: nothing, exactly."""
    value = np.zeros(np.shape(parameter["value"]))
    return {
        "value": value.tolist(),
        "ci95": np.stack([value, value], axis=-1).tolist(),
        "unit": parameter["unit"],
    }


def _negated(parameter: Mapping[str, Any]) -> dict[str, Any]:
    out = {"value": (-np.asarray(parameter["value"])).tolist(), "unit": parameter["unit"]}
    if "ci95" in parameter:
        out["ci95"] = (-np.asarray(parameter["ci95"])[..., ::-1]).tolist()
    return out


def _held_out(finding: Finding) -> dict[str, Any]:
    evidence = finding.evidence
    out = {
        "heldout_log_score_gain": evidence.heldout_log_score_gain,
        "heldout_gain_in_one_noise": evidence.heldout_gain_in_one_noise,
        "heldout_rmse_before": evidence.heldout_rmse_before,
        "heldout_rmse_after": evidence.heldout_rmse_after,
        "folds": evidence.folds or None,
    }
    return {name: value for name, value in out.items() if value is not None}


def _alternative(one: Alternative) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "heldout_log_score_gain": one.heldout_log_score_gain,
        "indistinguishable": one.indistinguishable,
    }


def _parameter(parameter: Parameter) -> dict[str, Any]:
    """Return one recording's parameter; without an interval where that is only the value twice."""
    out = {"value": parameter.value, "unit": parameter.unit}
    return out if _flat(parameter.ci95) else out | {"ci95": parameter.ci95}


def _flat(ci95: Any) -> bool:
    if ci95 is None:
        return True
    ends = np.asarray(ci95, dtype=np.float64).reshape(-1, 2)
    return bool((ends[:, 0] == ends[:, 1]).all())


def _values(quantity: Quantity) -> dict[str, Any]:
    """Return values with 95 % intervals, part by part; of logarithms, the numbers themselves."""
    low, high = quantity.value - NORMAL_95 * quantity.sigma, quantity.value + NORMAL_95 * quantity.sigma
    value = quantity.value
    if quantity.logarithmic:
        value, low, high = _number(quantity), np.exp(low), np.exp(high)
    if _may_be_none(quantity):
        half = NORMAL_95 * quantity.error
        low, high = np.maximum(value - half, 0.0), value + half
    if quantity.none:
        low = np.zeros_like(low)
    return _by_part(quantity, value, low, high)


def _difference(difference: Difference) -> dict[str, Any]:
    """Return what to add to the simulation, with 95 % intervals; of positive numbers the ratio too.

    There is no ratio to nothing, and none beside a part that is called so itself (of heavy tails). Of scales
    that share gravity's uncertainty it is also given how they differ from their mean.
    """
    recorded, simulated = difference.recorded, difference.simulated
    if not recorded.logarithmic:
        half = NORMAL_95 * difference.sigma
        out = _by_part(recorded, difference.value, difference.value - half, difference.value + half)
        return out | (_against_mean(difference) if recorded.parts[0] == SCALE_BY_AXIS else {})
    one, other = _number(recorded), _number(simulated)
    half = NORMAL_95 * np.hypot(_error(recorded), _error(simulated))
    out = _by_part(recorded, one - other, one - other - half, one - other + half)
    if recorded.none or simulated.none or "ratio" in out:
        return out
    spread = np.exp(NORMAL_95 * difference.sigma)
    ratio = np.exp(difference.value)
    ci = np.stack([ratio / spread, ratio * spread], axis=-1)
    return out | {"ratio": {"value": ratio.tolist(), "ci95": ci.tolist(), "unit": "1"}}


def _against_mean(difference: Difference) -> dict[str, Any]:
    """Return the three scales less their mean, which is as unsure as gravity is, with 95 % intervals."""
    apart = np.eye(3) - 1.0 / 3.0
    value = apart @ difference.value[:3]
    half = NORMAL_95 * np.sqrt(np.diag(apart @ difference.covariance[:3, :3] @ apart))
    ci = np.stack([value - half, value + half], axis=-1)
    return {"scale_against_mean": {"value": value.tolist(), "ci95": ci.tolist(), "unit": "1"}}


def _number(quantity: Quantity) -> Array:
    """Return the numbers whose logarithms were compared; what is as good as nothing is 0."""
    return np.asarray(np.zeros_like(quantity.value) if quantity.none else np.exp(quantity.value))


def _may_be_none(quantity: Quantity) -> bool:
    """Whether a number above 0 may be nothing, whose logarithm is unsure down to that, and not as far up."""
    return quantity.error > 0.0 and not quantity.none


def _error(quantity: Quantity) -> Array:
    """Return standard errors of the numbers whose logarithms were compared."""
    return np.asarray(quantity.error if _may_be_none(quantity) else _number(quantity) * quantity.sigma)


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
