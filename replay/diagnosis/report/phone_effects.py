"""From findings to the effects of a phone file, by name; what has no place there is said."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.replay.diagnosis.twin import Lived
from stillcal.replay.phone.effect_base import Effect
from stillcal.replay.phone.effect_registry import EFFECTS

IN_WHITE = ("noise_level", "noise_unequal_axes")
"""Findings that a phone's own white noise takes up: its density is measured on the recording."""

WHOLE = 0.9
"""A vibration that is there for this part of the recording is there always."""


@dataclass(frozen=True, slots=True)
class Mapped:
    """A finding and its effect in a phone file; effect None: why says where it went."""

    finding: Finding
    effect: Effect | None
    why: str = ""


def mapped(findings: Sequence[Finding], bins: Bins, about: Lived) -> list[Mapped]:
    """Return every finding with the effect that a phone file switches on for it."""
    return [_mapped(f, bins, about) for f in findings]


def _mapped(finding: Finding, bins: Bins, about: Lived) -> Mapped:
    if finding.effect in IN_WHITE:
        return Mapped(finding, None, "in the white noise of its sensor")
    kind = EFFECTS.get(finding.effect)
    if kind is None:
        return Mapped(finding, None, "no physics named: the simulation has no term for it")
    values: dict[str, Any] = {name: p.value for name, p in finding.parameters.items()}
    known = {k: v for k, v in values.items() if k in kind.__struct_fields__}
    known |= {"sensor": finding.sensor} if "sensor" in kind.__struct_fields__ else {}
    if finding.effect in _OWN:
        known |= _OWN[finding.effect](finding, values, bins, about)
    try:
        return Mapped(finding, msgspec.convert({"name": finding.effect, **known}, type=kind))
    except (msgspec.ValidationError, ValueError) as error:
        return Mapped(finding, None, f"the simulation does not take it: {error}")


def _since_start(finding: Finding, values: dict[str, Any], bins: Bins, about: Lived) -> dict[str, Any]:
    return {"at_s": finding.where.t_start - about.t_start}


def _hidden_warmth(finding: Finding, values: dict[str, Any], bins: Bins, about: Lived) -> dict[str, Any]:
    """Amplitudes are over the curve's range in the recording; the phone's are per unit of hidden warmth."""
    warmth = about.surroundings.heating().lagged(float(values["tau_s"])).at(bins.t - about.t_start)
    span = max(float(np.ptp(warmth)), 1e-9)
    return {"amplitude": [a / span for a in values["amplitude"]]}


def _while_it_lasts(finding: Finding, values: dict[str, Any], bins: Bins, about: Lived) -> dict[str, Any]:
    start, end = finding.where.t_start, finding.where.t_end
    if end - start > WHOLE * (bins.span[1] - bins.span[0]):
        return {"start_s": 0.0, "duration_s": math.inf}
    return {"start_s": start - about.t_start, "duration_s": end - start}


_OWN: dict[str, Callable[[Finding, dict[str, Any], Bins, Lived], dict[str, Any]]] = {
    "accel_bias_step": _since_start,
    "gyro_bias_step": _since_start,
    "thermal_latent": _hidden_warmth,
    "vibration_tone": _while_it_lasts,
}
