"""From the wire to the engine and back: records in, time mapped, the engine fed, the phone told.

One coroutine; it never waits for a disk or a client. What the engine wants done is handed on.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.engine.actions import Action
from stillcal.calib_core.engine.schedule import Watch
from stillcal.calib_core.static.settings import Sleep
from stillcal.calib_core.streams.events import Charging, End, Event, Location, Tick
from stillcal.calib_core.streams.samples import Samples
from stillcal.daemon.service.batching import together
from stillcal.daemon.service.duty_commands import Orders, grant
from stillcal.daemon.service.engine_thread import Mind
from stillcal.daemon.service.saved_state import SavedState
from stillcal.daemon.sources.base import LinkDown, LinkUp, Record, Source
from stillcal.daemon.system.log import say
from stillcal.daemon.wire.messages import Hello, Identify, Rate, Status, Temperature

BATCH_S = 0.2
"""How long what a phone in real time sends gathers before it is read, s."""

GATHER_S = 1.0
"""How long its samples wait for the engine while that watches without a break, s: they decide nothing yet."""

LATE_S = 0.3
"""How much later than its time a sleeping phone's decision is taken, for what is still on the wire, s."""

SILENCE_S = 10.0
"""A phone that should be sensing and says nothing for so long is asked again, s."""


class Pump:
    """One phone's line and what is known of the phone. `saved` holds what is kept over a restart."""

    def __init__(
        self,
        source: Source,
        mind: Mind,
        saved: SavedState,
        rate_hz: float,
        act: Callable[[list[Action]], None],
    ) -> None:
        self.source = source
        self.rate_hz = rate_hz
        self._mind, self._saved, self._act = mind, saved, act
        self._orders = Orders()
        self._items: list[Samples | Event] = []
        self._celsius: float | None = None
        self._in_step = False
        self._heard = self._thought = host_time()
        self.hello: Hello | None = None
        self.refused = 0

    async def run(self) -> None:
        """Serve the line until its source is closed."""
        while (records := await self._take()) is not None:
            for record in together(records):
                await self._handle(record)
            if self._urgent(records):
                await self._think()
            if records and not self._in_step:
                await self.source.rest(BATCH_S)

    def _urgent(self, records: list[Record]) -> bool:
        """Say whether the engine is to be woken for these records now."""
        calm = records and not self._in_step and all(isinstance(record, Samples) for record in records)
        view = self._mind.view
        unhurried = view.watch is Watch.CONTINUOUS and self._saved.clock.newest < view.decides
        return not (calm and unhurried and host_time() - self._thought < GATHER_S)

    async def _take(self) -> list[Record] | None:
        """Return what came; nothing where it is time to look up without, None once the source is closed."""
        try:
            async with asyncio.timeout(None if self.source.pending else self._patience()):
                records = await self.source.take()
        except TimeoutError:
            self._look_up()
            return []
        self._heard = host_time()
        return records or None

    @property
    def now(self) -> float | None:
        """The engine's time, s: the newest stamp's, or later where the phone sleeps in real time."""
        clock = self._saved.clock
        if self._in_step or not self.source.connected:
            return clock.newest if math.isfinite(clock.newest) else None
        return clock.now(host_time())

    # Time without samples

    def _patience(self) -> float | None:
        """Return for how long (s) there is nothing to do unless something comes."""
        if self._items:
            return GATHER_S
        if not self.source.connected or self._in_step:
            return None
        clock = self._saved.clock
        if not self._orders.asleep(clock.newest):
            return SILENCE_S
        if clock.host is None or math.isinf(self._mind.view.decides):
            return None
        due = clock.host + self._mind.view.decides - clock.newest + LATE_S
        return max(due - host_time(), 0.0)

    def _look_up(self) -> None:
        """Tell the engine the time while the phone sleeps; ask a phone that should not be silent."""
        clock, host = self._saved.clock, host_time()
        now = clock.now(host)
        if self._orders.asleep(clock.newest) and now is not None:
            self._items.append(Tick(min(now, max(self._mind.view.decides, clock.newest))))
        elif host - self._heard >= SILENCE_S:
            say("warning", "silent", "the phone says nothing: asking it", device=self.source.device)
            self._heard = host
            self._orders.forget()
            self.source.send(Identify())

    # Records

    async def _handle(self, record: Record) -> None:
        if isinstance(record, Samples | Charging | Location | Tick | End):
            self._queue(record)
            if isinstance(record, End) or (isinstance(record, Tick) and self._in_step):
                await self._think()
                self._answer(record)
        elif isinstance(record, Status):
            self._account(record)
        elif isinstance(record, Temperature):
            self._celsius = record.celsius
        elif isinstance(record, Hello):
            await self._meet(record)
        elif isinstance(record, LinkUp | LinkDown):
            self._link(record)

    def _queue(self, record: Samples | Event) -> None:
        item = self._saved.clock.mapped(record, host_time())
        if isinstance(item, Samples):
            self._saved.energy.samples(float(item.t[-1]), len(item))
            item = self._warm(item)
        if item is not None:
            self._items.append(item)

    def _warm(self, samples: Samples) -> Samples:
        """Give samples the thermometer's last reading where they bring none."""
        if samples.temperature is not None or self._celsius is None:
            return samples
        return replace(samples, temperature=frozen(np.full(len(samples), self._celsius)))

    def _account(self, status: Status) -> None:
        t = status.t + self._saved.clock.offset
        self._saved.energy.status(t, status)
        if status.sensing and self._orders.asleep(t):
            self._orders.forget()

    async def _meet(self, hello: Hello) -> None:
        await self._identify(str(hello.claims.get("device") or ""))
        self.hello, self._in_step = hello, hello.flow == "credit"
        self._orders.forget()
        if self._saved.clock.meet(hello.session):
            self._saved.energy.told = None
            say(
                "warning",
                "restarted",
                "the phone has restarted: its time is carried on",
                session=hello.session,
            )
        say(
            "info",
            "phone",
            "the phone said hello",
            device=self._saved.device,
            flow=hello.flow,
            session=hello.session,
        )
        if self.rate_hz > 0:
            self.source.send(Rate(self.rate_hz))

    async def _identify(self, device: str) -> None:
        """Begin anew where the phone says it is another one than before; one that says nothing is not."""
        before = self._saved.device
        if before and device and device != before:
            await self._think()
            thought = await self._mind.forget(f"another phone, {device}, has taken the place of {before}")
            say(
                "warning",
                "another phone",
                "what was gathered is dropped; stillcal store rollback brings a calibration back",
                device=device,
                before=before,
            )
            self._act(thought.actions)
        self._saved.device = device or before

    def _link(self, record: LinkUp | LinkDown) -> None:
        self._orders.forget()
        self._in_step = False
        if isinstance(record, LinkUp):
            say(
                "info",
                "connected",
                "the phone's line is open",
                device=record.device,
                attempts=record.attempts,
            )
        elif record.device:
            say("warning", "disconnected", record.reason, device=record.device)
        else:
            say("info", "waiting", f"no phone: {record.reason}")

    # The engine and its orders

    async def _think(self) -> None:
        """Feed what has gathered, hand on what is to be done, and tell the phone what is wanted now."""
        items, self._items = list(together(self._items)), []
        self._thought = host_time()
        if items:
            thought = await self._mind.feed(items)
            self._account_for_thinking()
            for reason in thought.refused:
                self.refused += 1
                say("warning", "refused", reason)
            if thought.actions:
                self._act(thought.actions)
        self._order()

    def _account_for_thinking(self) -> None:
        clock, energy = self._saved.clock, self._saved.energy
        energy.totals(clock.newest, self._mind.view.ledger.asked_s, time.process_time())

    def _order(self) -> None:
        if not self.source.connected or self.hello is None:
            return
        clock, view = self._saved.clock, self._mind.view
        for command in self._orders.due(view.want, view.decides, clock.newest):
            self.source.send(type(command)(clock.phone(command.until)))

    def _answer(self, record: Tick | End) -> None:
        """Let a phone in step go on, and any phone go whose stream has come to its end."""
        clock, view = self._saved.clock, self._mind.view
        if isinstance(record, End):
            self._orders.forget()
            self.source.send(Sleep(math.inf))
            return
        go = grant(view.want, view.decides, record.t + clock.offset)
        self.source.send(replace(go, until=clock.phone(go.until)))


def host_time() -> float:
    """Return the host's steady clock, s; it goes on while the host is suspended."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
