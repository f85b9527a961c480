"""One phone's session: takes its records, maps their time, feeds the engine, sends commands back.

One coroutine that never waits for a disk or a client. The engine's actions are passed on to the service.
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
from stillcal.calib_core.engine.settings import Watch
from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams.events import Charging, End, Event, Location, Temperature, Tick
from stillcal.calib_core.streams.samples import Samples
from stillcal.calib_core.temperature.thermometer import FRESH_S
from stillcal.daemon.service.batching import join_blocks
from stillcal.daemon.service.duty_commands import DutyCommands, credit
from stillcal.daemon.service.engine_thread import EngineThread
from stillcal.daemon.service.sample_readers import SampleReaders
from stillcal.daemon.service.saved_state import SavedState
from stillcal.daemon.service.self_diagnosis import NightReport
from stillcal.daemon.sources.base import LinkDown, LinkUp, Record, Source
from stillcal.daemon.system.clock import Clock, host_time
from stillcal.daemon.system.log import say
from stillcal.daemon.system.printable import printable
from stillcal.daemon.wire.messages import Hello, Identify, Rate, Status

BATCH_S = 0.2
"""How long records of a real-time phone gather before they are read, s: fewer wake-ups cost less power."""

GATHER_S = 1.0
"""How long samples wait for the engine under continuous watch while no decision is due, s."""

LATE_S = 0.3
"""How much later than planned a sleeping phone's decision is taken, s: records may still be on the wire."""

DEVICE_CHARACTERS = 200
"""Of a phone's name that are looked at."""

IMPOSSIBLE_S = 10.0
"""Sensor time beyond what has passed that is told in the log, s: two clocks may differ a little."""

CONTINUES_S = 60.0
"""Host's time without a jump of the phone's stamps, after which the next one is told."""

SILENCE_S = 10.0
"""A phone that should be sensing is asked to identify itself after this much silence, s."""


class PhoneSession:
    """The session on one source.

    saved: what outlives the daemon. act: takes the engine's actions. readers: are given all samples, raw with
    the events or corrected; the sensors stay on where they want it.
    """

    def __init__(
        self,
        source: Source,
        engine_thread: EngineThread,
        saved: SavedState,
        rate_hz: float,
        act: Callable[[list[Action]], None],
        *,
        readers: SampleReaders | None = None,
        clock: Clock = host_time,
        cpu_time: Clock = time.process_time,
    ) -> None:
        self.source = source
        self._readers = SampleReaders() if readers is None else readers
        self._fresh: list[Samples] = []
        self.rate_hz = rate_hz
        self._engine_thread, self._saved, self._act = engine_thread, saved, act
        self._clock, self._cpu_time = clock, cpu_time
        self._commands = DutyCommands()
        self._items: list[Samples | Event] = []
        self._told: Temperature | None = None
        self._in_step = False
        self._heard_at = self._fed_at = self._clock()
        self._silent = False
        self._jumped_at = -math.inf
        self.hello: Hello | None = None
        self.refused = 0

    async def run(self) -> None:
        """Serve the source until it is closed."""
        while (records := await self._receive()) is not None:
            for record in join_blocks(records):
                await self._on_record(record)
            self._send_live()
            if not self._may_gather(records):
                await self._feed_engine()
            if records and not self._in_step:
                await self.source.let_gather(min(BATCH_S, self._readers.live.patience_s))

    def _may_gather(self, records: list[Record]) -> bool:
        """Return whether these records may wait for the engine: samples, while no decision is due."""
        view = self._engine_thread.view
        return (
            bool(records)
            and all(isinstance(record, Samples | Temperature) for record in records)
            and not self._in_step
            and view.watch is Watch.CONTINUOUS
            and self._saved.clock.newest < view.decides
            and self._clock() - self._fed_at < GATHER_S
        )

    async def _receive(self) -> list[Record] | None:
        """Return the records that arrived, [] after a timeout, None once the source is closed."""
        try:
            async with asyncio.timeout(None if self.source.pending else self._timeout()):
                records = await self.source.take()
        except TimeoutError:
            self._on_timeout()
            return []
        self._heard_at, self._silent = self._clock(), False
        return records or None

    @property
    def now(self) -> float | None:
        """The engine's time, s: the newest stamp's, or later where the phone sleeps in real time."""
        clock = self._saved.clock
        if self._in_step or not self.source.connected:
            return clock.newest if math.isfinite(clock.newest) else None
        return clock.now(self._clock())

    # Time without samples

    def _timeout(self) -> float | None:
        """Return how long to wait for records, s; None for as long as it takes."""
        if self._items:
            return GATHER_S
        if not self.source.connected or self._in_step:
            return None
        clock = self._saved.clock
        if not self._commands.asleep(clock.newest):
            return SILENCE_S
        if clock.host is None or math.isinf(self._engine_thread.view.decides):
            return None
        due = clock.host + self._engine_thread.view.decides - clock.newest + LATE_S
        return max(due - self._clock(), 0.0)

    def _on_timeout(self) -> None:
        """Tell the engine the time while the phone sleeps; ask a silent phone to identify itself."""
        clock, host = self._saved.clock, self._clock()
        now = clock.now(host)
        if self._commands.asleep(clock.newest) and now is not None:
            self._items.append(Tick(min(now, max(self._engine_thread.view.decides, clock.newest))))
        elif host - self._heard_at >= SILENCE_S:
            self._say_silent()
            self._heard_at = host
            self._commands.forget()
            self.source.send(Identify())

    def _say_silent(self) -> None:
        """Log a silence once: a board that never speaks must not fill the log."""
        if not self._silent:
            say(
                "warning",
                "silent",
                f"no data for {SILENCE_S:.0f} s: asking the phone to identify itself until it does; "
                "check its program and the baud rate",
                device=self.source.device,
            )
        self._silent = True

    # Records

    async def _on_record(self, record: Record) -> None:
        if isinstance(record, Samples | Charging | Location | Temperature | Tick | End):
            self._queue(record)
            if isinstance(record, End) or (isinstance(record, Tick) and self._in_step):
                await self._feed_engine()
                self._answer_stop(record)
        elif isinstance(record, Status):
            self._on_status(record)
        elif isinstance(record, Hello):
            await self._on_hello(record)
        elif isinstance(record, LinkUp | LinkDown):
            self._on_link(record)

    def _queue(self, record: Samples | Event) -> None:
        clock = self._saved.clock
        restarts, leaps = clock.restarts, clock.leaps
        item = clock.mapped(record, self._clock())
        if clock.restarts > restarts:
            self._clock_jumped("restarted", "the phone restarted")
        elif clock.leaps > leaps:
            self._clock_jumped("leap", "the phone's time stamps leapt ahead")
        if isinstance(item, Samples):
            self._saved.energy.samples(float(item.t[-1]), len(item))
            item = self._with_temperature(item)
            self._fresh.append(item)
        elif isinstance(item, Temperature):
            self._told = item
        if item is not None:
            self._items.append(item)
            self._readers.record(item)

    def _clock_jumped(self, what: str, reason: str) -> None:
        """Tell log and listeners that the phone's time stamps do not continue.

        It is told once, until they have continued for a while: where two sensors have clocks of their own,
        every block is a jump.
        """
        now, before = self._clock(), self._jumped_at
        self._jumped_at = now
        if now - before < CONTINUES_S:
            return
        self._interrupt_live(reason)
        session = None if self.hello is None else self.hello.session
        say("warning", what, f"{reason}; its new time stamps continue from the old ones", session=session)

    def _send_live(self) -> None:
        fresh, self._fresh = self._fresh, []
        view = self._engine_thread.view
        self._readers.live.take(fresh, view.record, self._clock(), view.thermometer, view.charger)

    def _interrupt_live(self, reason: str) -> None:
        self._send_live()
        self._readers.live.interrupt(reason)

    def _with_temperature(self, samples: Samples) -> Samples:
        """Add the thermometer's last reading to samples without a temperature, as long as it is fresh."""
        if samples.temperature is not None or self._told is None:
            return samples
        fresh = samples.t - self._told.t <= FRESH_S
        if not fresh.any():
            return samples
        return replace(samples, temperature=frozen(np.where(fresh, self._told.celsius, np.nan)))

    def _on_status(self, status: Status) -> None:
        t = self._saved.clock.looked_at(status.t, self._clock())
        if (impossible := self._saved.energy.status(t, status)) > IMPOSSIBLE_S:
            say(
                "warning",
                "impossible",
                f"the phone says that its sensors were on for {impossible:.3g} s more than have passed: "
                "this is not counted",
            )
        if status.sensing and self._commands.asleep(t):
            self._commands.forget()

    async def _on_hello(self, hello: Hello) -> None:
        await self._check_identity(device_name(hello))
        self.hello, self._in_step = hello, hello.flow == "credit"
        self._readers.record(hello)
        self._commands.forget()
        if self._saved.clock.meet(hello.session):
            self._saved.energy.told = None
        say(
            "info",
            "phone",
            "the phone identified itself",
            device=self._saved.device,
            flow=hello.flow,
            session=hello.session,
        )
        if self.rate_hz > 0:
            self.source.send(Rate(self.rate_hz))

    async def _check_identity(self, device: str) -> None:
        """Start from scratch where the phone gives another name than before."""
        before = self._saved.device
        if before and device and device != before:
            await self._feed_engine()
            reply = await self._engine_thread.forget(f"the phone changed from {before} to {device}")
            say(
                "warning",
                "another phone",
                "all rests are dropped; `stillcal store rollback` restores an earlier calibration",
                device=device,
                before=before,
            )
            self._act(reply.actions)
            self._told, self._saved.night = None, NightReport()
            self._readers.forget()
        self._saved.device = device or before

    def _on_link(self, record: LinkUp | LinkDown) -> None:
        self._commands.forget()
        self._in_step = False
        if isinstance(record, LinkUp):
            say(
                "info",
                "connected",
                "line opened",
                device=record.device,
                attempts=record.attempts,
            )
        elif record.device:
            self._interrupt_live(f"the phone was lost: {record.reason}")
            say("warning", "disconnected", record.reason, device=record.device)
        else:
            say("info", "waiting", f"no phone: {record.reason}")

    # The engine and its commands

    async def _feed_engine(self) -> None:
        """Feed the engine, pass on its actions, and send the phone the commands that follow."""
        items, self._items = list(join_blocks(self._items)), []
        self._fed_at = self._clock()
        if items:
            reply = await self._engine_thread.feed(items)
            self._saved.clock.caught_up()
            self._account_for_engine()
            for reason in reply.refused:
                self.refused += 1
                say("warning", "refused", reason)
            if reply.actions:
                self._act(reply.actions)
        self.send_commands()

    def _account_for_engine(self) -> None:
        clock, energy = self._saved.clock, self._saved.energy
        energy.totals(clock.newest, self._engine_thread.view.ledger.asked_s, self._cpu_time())

    def send_commands(self) -> None:
        """Send the phone the commands that bring its sensors into the wanted state."""
        if not self.source.connected or self.hello is None:
            return
        clock, view = self._saved.clock, self._engine_thread.view
        for command in self._commands.due(self._wanted(), view.decides, clock.newest):
            self.source.send(type(command)(clock.phone(command.until)))

    def _wanted(self) -> Sense | Sleep:
        return Sense(math.inf) if self._readers.keep_on else self._engine_thread.view.want

    def _answer_stop(self, record: Tick | End) -> None:
        """Answer a stop: credit for a phone that waits for it, sleep at the end of a stream."""
        clock, view = self._saved.clock, self._engine_thread.view
        if isinstance(record, End):
            self._commands.forget()
            self.source.send(Sleep(math.inf))
            return
        go = credit(self._wanted(), view.decides, record.t + clock.offset)
        self.source.send(replace(go, until=clock.phone(go.until)))


def device_name(hello: Hello) -> str:
    """Return what a phone says it is: printable, of bounded length, "" where it does not say."""
    claimed = hello.claims.get("device")
    return printable(claimed)[:DEVICE_CHARACTERS] if isinstance(claimed, str) else ""
