"""News of the calibration for those who asked to be told: bounded queues, nobody waits for a slow one."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Forget, Reject
from stillcal.calib_core.engine.actions import Store as Keep

BACKLOG = 64


@dataclass(frozen=True, slots=True)
class Item:
    """What happened. what: calibrated, zeroed, rejected, forgotten or rolled_back; t: s of engine time."""

    what: str
    t: float
    reason: str
    record: CalibrationRecord


@dataclass(slots=True, eq=False)
class Listener:
    """One who listens; `lost` where it was too slow and has been dropped."""

    queue: asyncio.Queue[Item | None] = field(default_factory=lambda: asyncio.Queue(BACKLOG + 1))
    lost: bool = False

    def close(self) -> None:
        """End the listening: what waits is forgotten."""
        while not self.queue.empty():
            self.queue.get_nowait()
        self.queue.put_nowait(None)


class News:
    """Everybody who listens."""

    def __init__(self) -> None:
        self._listeners: set[Listener] = set()

    def __len__(self) -> int:
        return len(self._listeners)

    def listen(self) -> tuple[Listener, Callable[[], None]]:
        """Begin to listen; the second value ends it."""
        listener = Listener()
        self._listeners.add(listener)
        return listener, lambda: self._listeners.discard(listener)

    def tell(self, action: Keep | Reject | Forget) -> None:
        """Tell of what the engine decided."""
        names = {Reject: "rejected", Forget: "forgotten"}
        what = names.get(type(action)) or _kind(action.record)
        self.spread(Item(what, action.t, action.reason, action.record))

    def spread(self, item: Item) -> None:
        """Tell everybody; who has too much unread is dropped."""
        for listener in list(self._listeners):
            if listener.queue.qsize() >= BACKLOG:
                listener.lost = True
                listener.close()
                self._listeners.discard(listener)
            else:
                listener.queue.put_nowait(item)


def _kind(record: CalibrationRecord) -> str:
    return "zeroed" if record.acceptance.how == "zeroing" else "calibrated"
