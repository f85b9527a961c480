"""Which recording would tell more about an effect."""

from __future__ import annotations

from stillcal.calib_core.diagnosis.effects.catalogue import named_effects
from stillcal.calib_core.diagnosis.effects.described import DESCRIBED


def to_record(effect: str, sensor: str) -> str:
    """Return which recording would tell more about an effect; "" where nothing is known."""
    for known in named_effects():
        if (known.name, known.sensor) == (effect, sensor) and known.decides:
            return known.decides
    return DESCRIBED[effect].decides if effect in DESCRIBED else ""
