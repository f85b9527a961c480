"""When store and state are written: a calibration at once, the state after new rests and now and then."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

from stillcal.daemon.service.storage import Storage
from stillcal.daemon.system.clock import Clock
from stillcal.daemon.system.log import say

SAVE_EVERY_S = 10.0
"""Least time between two writes of the state for new rests, s: so much a crash can lose."""

SAVE_AT_LEAST_S = 600.0
"""Longest time between two writes of the state, s: clock and energy ledger change without rests."""

RETRY_EVERY_S = 2.0
"""So often it is tried again where the disk refused, s."""

LOOK_EVERY_S = 10.0
"""Time between two looks whether the store is still there, s."""


class Saving:
    """Writes to `storage` when it is time. encoded: returns the state file's contents now."""

    def __init__(self, storage: Storage, encoded: Callable[[], Awaitable[bytes]], clock: Clock) -> None:
        self._storage, self._encoded, self._clock = storage, encoded, clock
        self._changed = asyncio.Event()
        self._at_once = False

    def changed(self, at_once: bool = False) -> None:
        """Note that something is not on the disk yet. at_once: the state is written without delay as well."""
        self._at_once = self._at_once or at_once
        self._changed.set()

    async def run(self) -> None:
        """Write calibrations at once, and the state at most every SAVE_EVERY_S, until cancelled."""
        saved_at, changed = self._clock() - SAVE_EVERY_S, False
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(saved_at + self._pause(changed) - self._clock(), 0.0)):
                    await self._changed.wait()
            changed = changed or self._changed.is_set()
            self._changed.clear()
            await self._storage.flush()
            if self._at_once or self._clock() - saved_at >= self._pause(changed):
                self._at_once = False
                saved_at, changed = self._clock(), not await self.save()

    async def hold(self) -> None:
        """See every now and then that the store is still there, and ours alone, until cancelled."""
        while True:
            if not await self._storage.check():
                self.changed()  # saving is tried again until it can be
            await asyncio.sleep(LOOK_EVERY_S)

    async def save(self) -> bool:
        """Write the state; return whether it is on the disk."""
        try:
            data = await self._encoded()
        except (ValueError, TypeError, OverflowError, MemoryError) as error:
            say("error", "state", f"it cannot be written: {error!r}")
            return False
        return await self._storage.save(data)

    def say_what_is_lost(self, otherwise: str) -> None:
        """Log what the end of the daemon loses. otherwise: why, where no write has failed."""
        why = self._storage.trouble or otherwise
        say("warning", "stopping", f"{why}: the state is as it was last saved")
        if (lost := self._storage.unsaved) is not None:
            what = "the newest change of the calibration is not in the store"
            say("error", "lost", f"{why}: {what}", calibration=lost.record.id, reason=lost.reason)

    def _pause(self, changed: bool) -> float:
        """Return how long (s) after one try to save the next one is due."""
        if self._storage.trouble:
            return RETRY_EVERY_S
        return SAVE_EVERY_S if changed else SAVE_AT_LEAST_S
