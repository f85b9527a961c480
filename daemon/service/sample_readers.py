"""Who reads the phone's samples besides the engine, and whether the sensors stay on for them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import TypeVar

from stillcal.calib_core.streams.events import Charging, Location
from stillcal.daemon.service.live_stream import Live, LiveStream
from stillcal.daemon.service.phone_clock import Timed
from stillcal.daemon.service.subscribers import Subscriber, Subscribers
from stillcal.daemon.wire.messages import Hello

T = TypeVar("T")

Recorded = Timed | Hello
"""What a recording of the phone is made of."""


class SampleReaders:
    """Recorders of raw samples, and listeners to corrected ones.

    changed: is called when somebody wants the sensors on, or wants that no longer.
    """

    def __init__(self, changed: Callable[[], None] = lambda: None) -> None:
        self.recorders = Subscribers[Recorded]()
        self._told: dict[type, Charging | Location] = {}
        self.live = LiveStream()
        self._changed = changed
        self._keeping_on = 0

    @property
    def keep_on(self) -> bool:
        """Whether somebody wants the sensors on."""
        return self._keeping_on > 0

    def record(self, item: Recorded) -> None:
        """Pass an item on to the recorders. What an event says holds until the next of its kind."""
        if isinstance(item, Charging | Location):
            self._told[type(item)] = item
        self.recorders.notify(item)

    def forget(self) -> None:
        """Forget what events said: another phone said it."""
        self._told.clear()

    def recording(self, sparing: bool) -> AbstractContextManager[Subscriber[Recorded]]:
        """Subscribe to raw samples and events while the block lasts; events that still hold come first.

        sparing: leave the sensors to the engine; otherwise they stay on meanwhile.
        """
        subscriber, unsubscribe = self.recorders.subscribe()
        for event in self._told.values():
            subscriber.queue.put_nowait(event)
        return self._subscribed((subscriber, unsubscribe), sparing)

    def streaming(self, sparing: bool, patience_s: float) -> AbstractContextManager[Subscriber[Live]]:
        """Subscribe to corrected samples, which may gather for `patience_s`; sparing: as in `recording`."""
        return self._subscribed(self.live.subscribe(patience_s), sparing)

    @contextlib.contextmanager
    def _subscribed(
        self, subscription: tuple[Subscriber[T], Callable[[], None]], sparing: bool
    ) -> Iterator[Subscriber[T]]:
        subscriber, unsubscribe = subscription
        self._keeping_on += not sparing
        self._changed()
        try:
            yield subscriber
        finally:
            unsubscribe()
            self._keeping_on -= not sparing
            self._changed()
