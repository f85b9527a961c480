"""The check that settings lie within their ranges."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def check_ranges(settings: Any, allowed: Mapping[str, tuple[float, float]]) -> None:
    """Raise ValueError naming the first field of `settings` that is outside its closed range (low, high)."""
    for name, (low, high) in allowed.items():
        value = getattr(settings, name)
        if not low <= value <= high:
            raise ValueError(f"{name} = {value}: must lie between {low:g} and {high:g}")
