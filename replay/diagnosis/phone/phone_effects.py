"""From findings to the effects of a phone file, by name, with the reason for a finding that has none."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.diagnosis.comparison.noise.white_noise import LOW_PASS, OF_DENSITY, of_some_axes
from stillcal.calib_core.diagnosis.effects.catalogue import foreign_effects
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.replay.diagnosis.phone.twin import Conditions
from stillcal.replay.phone.effects.base import Effect
from stillcal.replay.phone.effects.on_settings import FILTERS_ALL
from stillcal.replay.phone.effects.other_physics import OtherPhysics
from stillcal.replay.phone.effects.registry import EFFECTS
from stillcal.replay.phone.settings import ClockSettings

WHOLE_RECORDING = 0.9
"""A vibration that is there for this part of the recording is there always."""


@dataclass(frozen=True, slots=True)
class MappedFinding:
    """A finding with its effect in a phone file; where effect is None, why gives the reason."""

    finding: Finding
    effect: Effect | None
    why: str = ""


def map_findings(findings: Sequence[Finding], bins: Bins, conditions: Conditions) -> list[MappedFinding]:
    """Return every finding with the effect that a phone file switches on for it."""
    return [_map_finding(f, bins, conditions) for f in findings]


def _map_finding(finding: Finding, bins: Bins, conditions: Conditions) -> MappedFinding:
    if finding.effect in OF_DENSITY:
        return MappedFinding(finding, None, "included in the white noise of its sensor")
    if finding.effect == LOW_PASS and of_some_axes(finding.axes):
        return MappedFinding(finding, None, FILTERS_ALL)
    kind = EFFECTS.get(finding.effect)
    if kind is None:
        return _of_another_package(finding)
    values: dict[str, Any] = {name: p.value for name, p in finding.parameters.items()}
    known = {k: v for k, v in values.items() if k in kind.__struct_fields__}
    known |= {"sensor": finding.sensor} if "sensor" in kind.__struct_fields__ else {}
    if finding.effect in _CONVERSIONS:
        known |= _CONVERSIONS[finding.effect](finding, values, bins, conditions)
    try:
        effect = msgspec.convert({"name": finding.effect, **known}, type=kind)
        # What acts on the clock has the clock's own limits.
        effect.on_clock(ClockSettings())
        return MappedFinding(finding, effect)
    except (msgspec.ValidationError, ValueError) as error:
        return MappedFinding(finding, None, f"the simulation cannot represent it: {error}")


def _of_another_package(finding: Finding) -> MappedFinding:
    """Return an effect that another package brought; one without a name has no term."""
    for effect in foreign_effects():
        if effect.name == finding.effect:
            own = [finding.parameters[p.name].value for p in effect.parameters]
            values = tuple(float(x) for x in np.concatenate([np.ravel(v) for v in own]))
            grid = {name: float(np.ravel(finding.parameters[name].value)[0]) for name in effect.grid_units}
            return MappedFinding(finding, OtherPhysics(effect=effect.name, values=values, grid=grid))
    if finding.effect == "unknown":
        return MappedFinding(finding, None, "the cause is unknown, so the simulation has no term for it")
    return MappedFinding(finding, None, "a simulated phone has no term for it")


def _step_time(
    finding: Finding, values: dict[str, Any], bins: Bins, conditions: Conditions
) -> dict[str, Any]:
    return {"at_s": finding.where.t_start - conditions.t_start}


def _latent_amplitudes(
    finding: Finding, values: dict[str, Any], bins: Bins, conditions: Conditions
) -> dict[str, Any]:
    """Amplitudes are over the curve's range in the recording; the phone's are per unit of hidden warmth."""
    warmth = conditions.surroundings.heating().lagged(float(values["tau_s"])).at(bins.t - conditions.t_start)
    span = max(float(np.ptp(warmth)), 1e-9)
    return {"amplitude": [a / span for a in values["amplitude"]]}


def _tone_interval(
    finding: Finding, values: dict[str, Any], bins: Bins, conditions: Conditions
) -> dict[str, Any]:
    start, end = finding.where.t_start, finding.where.t_end
    if end - start > WHOLE_RECORDING * (bins.span[1] - bins.span[0]):
        return {"start_s": 0.0, "duration_s": math.inf}
    return {"start_s": start - conditions.t_start, "duration_s": end - start}


_CONVERSIONS: dict[str, Callable[[Finding, dict[str, Any], Bins, Conditions], dict[str, Any]]] = {
    "accel_bias_step": _step_time,
    "gyro_bias_step": _step_time,
    "thermal_latent": _latent_amplitudes,
    "vibration_tone": _tone_interval,
}
