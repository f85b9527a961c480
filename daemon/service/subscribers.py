"""Publish changes of the calibration, or samples, to subscribers, each with a bounded queue."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Forget, Publish, Reject

T = TypeVar("T")

BACKLOG = 64
"""Unread notifications of one subscriber; a client that does not read would otherwise fill the memory."""


@dataclass(frozen=True, slots=True)
class Notification:
    """One change. what: calibrated, zeroed, rejected, forgotten or rolled_back; t: s of engine time."""

    what: str
    t: float
    reason: str
    record: CalibrationRecord


@dataclass(slots=True, eq=False)
class Subscriber(Generic[T]):
    """One subscriber's queue; `overflowed` once it was too slow and was dropped."""

    queue: asyncio.Queue[T | None] = field(default_factory=lambda: asyncio.Queue(BACKLOG + 1))
    overflowed: bool = False

    def close(self) -> None:
        """End the subscription; what is unread is dropped."""
        while not self.queue.empty():
            self.queue.get_nowait()
        self.queue.put_nowait(None)


class Subscribers(Generic[T]):
    """All subscribers to one kind of news."""

    def __init__(self) -> None:
        self._subscribers: set[Subscriber[T]] = set()

    def __len__(self) -> int:
        return len(self._subscribers)

    def subscribe(self) -> tuple[Subscriber[T], Callable[[], None]]:
        """Subscribe; the second value is a function that unsubscribes."""
        subscriber = Subscriber[T]()
        self._subscribers.add(subscriber)
        return subscriber, lambda: self._subscribers.discard(subscriber)

    def notify(self, notification: T) -> None:
        """Notify all subscribers; one with a full queue is dropped."""
        for subscriber in list(self._subscribers):
            if subscriber.queue.qsize() >= BACKLOG:
                subscriber.overflowed = True
                subscriber.close()
                self._subscribers.discard(subscriber)
            else:
                subscriber.queue.put_nowait(notification)


class CalibrationSubscribers(Subscribers[Notification]):
    """All subscribers to changes of the calibration."""

    def announce(self, action: Publish | Reject | Forget) -> None:
        """Notify all subscribers of an action of the engine."""
        names = {Reject: "rejected", Forget: "forgotten"}
        what = names.get(type(action)) or _kind(action.record)
        self.notify(Notification(what, action.t, action.reason, action.record))


def _kind(record: CalibrationRecord) -> str:
    names = {"zeroing": "zeroed", "following": "followed"}
    return names.get(record.acceptance.how, "calibrated")
