"""What a calibration keeps of an effect beyond its affine model."""

from __future__ import annotations

from dataclasses import dataclass, field

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TermParameter:
    """One parameter of a term. value: any shape, in `unit`. ci95: value's shape + (2,), None if unknown."""

    value: Array
    unit: str
    ci95: Array | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Term:
    """An effect beyond the affine model, such as a bias that follows temperature.

    effect: its name in the diagnosis. reference: the values that the parameters count from, such as
    {"temperature": 25.0} in degC.
    """

    effect: str
    sensor: Sensor
    parameters: dict[str, TermParameter]
    reference: dict[str, float] = field(default_factory=dict)


def lag_of(term: Term) -> float:
    """Return with what lag (s) a term follows the thermometer or the charger; 0 for none."""
    return term.reference.get("lag_s", 0.0)
