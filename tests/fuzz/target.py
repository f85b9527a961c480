"""What a fuzz target is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Target:
    """A parser. seeds: inputs that it takes. feed: gives it bytes; raises where it does what it must not."""

    seeds: Callable[[], list[bytes]]
    feed: Callable[[bytes], None]
