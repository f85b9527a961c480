"""What befalls a week's clocks: suspended phones, stamps that leap and fall back, and the host beside them.

The simulated phone's own stamps are disturbed; the daemon's PhoneClock carries them on, as it does live, by
the host's steady clock, which is the true time here. A wall clock that is set has no part in this.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import msgspec

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.events import Event
from stillcal.calib_core.streams.samples import Samples
from stillcal.daemon.service.phone_clock import PhoneClock
from stillcal.replay.phone.simulation import Chunk

HOUR_S, DAY_S = 3600.0, 86400.0


@dataclass(frozen=True, slots=True)
class Mishap:
    """From true time t (s) on the phone is silent for `silent` s, and its stamps are `shift` s off."""

    t: float
    silent: float = 0.0
    shift: float = 0.0


MISHAPS = (
    Mishap(1.4 * DAY_S, silent=6 * HOUR_S),
    Mishap(2.4 * DAY_S, shift=5 * HOUR_S),
    Mishap(3.3 * DAY_S, shift=40 * DAY_S),
    Mishap(4.2 * DAY_S, shift=-4 * DAY_S),
    Mishap(5.6 * DAY_S, silent=11 * HOUR_S, shift=-4 * DAY_S),
)
"""Suspended for six hours; set forward by five hours, then by 40 days; restarted; suspended overnight."""


def through_clock(
    chunks: Iterable[Chunk], clock: PhoneClock, mishaps: Iterable[Mishap]
) -> Iterator[tuple[Chunk, list[Samples | Event]]]:
    """Yield each chunk and what of it reaches the engine, on the engine's time."""
    for chunk in chunks:
        now = next((m for m in reversed(list(mishaps)) if m.t <= chunk.t_end), Mishap(0.0))
        if chunk.t_end < now.t + now.silent:
            yield chunk, []
            continue
        items = [i for i in (chunk.gyroscope, chunk.accelerometer, *chunk.events) if i is not None]
        mapped = (clock.mapped(_shifted(item, now.shift), chunk.t_end) for item in items)
        yield chunk, [item for item in mapped if item is not None]
        clock.caught_up()


def _shifted(item: Samples | Event, by: float) -> Samples | Event:
    if isinstance(item, Samples):
        return replace(item, t=frozen(item.t + by))
    return msgspec.structs.replace(item, t=item.t + by)
