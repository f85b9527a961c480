"""What a fuzz target is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Target:
    """A parser. seeds: inputs that it takes. feed: gives it bytes; raises where it does what it must not."""

    seeds: Callable[[], list[bytes]]
    feed: Callable[[bytes], None]


def any_of(targets: Sequence[Target]) -> Target:
    """Return parsers that share their reader as one target: the first byte of an input chooses among them."""

    def seeds() -> list[bytes]:
        return [bytes([i]) + data for i, target in enumerate(targets) for data in target.seeds()]

    def feed(data: bytes) -> None:
        if data:
            targets[data[0] % len(targets)].feed(data[1:])

    return Target(seeds, feed)
