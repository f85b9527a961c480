"""News of the calibration for those who asked to be told: bounded queues, nobody waits for a slow one."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Forget, Publish, Reject

BACKLOG = 64


@dataclass(frozen=True, slots=True)
class Notification:
    """What happened. what: calibrated, zeroed, rejected, forgotten or rolled_back; t: s of engine time."""

    what: str
    t: float
    reason: str
    record: CalibrationRecord


@dataclass(slots=True, eq=False)
class Subscriber:
    """One who listens; `overflowed` where it was too slow and has been dropped."""

    queue: asyncio.Queue[Notification | None] = field(default_factory=lambda: asyncio.Queue(BACKLOG + 1))
    overflowed: bool = False

    def close(self) -> None:
        """End the listening: what waits is forgotten."""
        while not self.queue.empty():
            self.queue.get_nowait()
        self.queue.put_nowait(None)


class Subscribers:
    """Everybody who listens."""

    def __init__(self) -> None:
        self._subscribers: set[Subscriber] = set()

    def __len__(self) -> int:
        return len(self._subscribers)

    def subscribe(self) -> tuple[Subscriber, Callable[[], None]]:
        """Begin to listen; the second value ends it."""
        subscriber = Subscriber()
        self._subscribers.add(subscriber)
        return subscriber, lambda: self._subscribers.discard(subscriber)

    def announce(self, action: Publish | Reject | Forget) -> None:
        """Tell of what the engine decided."""
        names = {Reject: "rejected", Forget: "forgotten"}
        what = names.get(type(action)) or _kind(action.record)
        self.notify(Notification(what, action.t, action.reason, action.record))

    def notify(self, notification: Notification) -> None:
        """Tell everybody; who has too much unread is dropped."""
        for subscriber in list(self._subscribers):
            if subscriber.queue.qsize() >= BACKLOG:
                subscriber.overflowed = True
                subscriber.close()
                self._subscribers.discard(subscriber)
            else:
                subscriber.queue.put_nowait(notification)


def _kind(record: CalibrationRecord) -> str:
    return "zeroed" if record.acceptance.how == "zeroing" else "calibrated"
