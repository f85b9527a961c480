"""`stillcal run`: the daemon put together, from its start to its clean end.

One event loop holds the phone's line, the socket and the signals. The engine runs in one thread and
the disk is written in another (service/engine_thread.py, service/storage.py). Neither delays the loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import copy
import os
import signal
from dataclasses import replace
from pathlib import Path

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Action, Diagnose, Forget, Log, Publish, Reject
from stillcal.calib_core.engine.state import EngineState
from stillcal.daemon.app_launch import LaunchOptions, needs_restart, serial_settings
from stillcal.daemon.service.engine_thread import EngineReply, EngineThread, View
from stillcal.daemon.service.phone_session import PhoneSession
from stillcal.daemon.service.saved_state import SavedState
from stillcal.daemon.service.storage import Storage, with_provenance
from stillcal.daemon.service.subscribers import Notification, Subscribers
from stillcal.daemon.settings import Settings, SettingsError, store_path
from stillcal.daemon.sources.base import Source
from stillcal.daemon.sources.open import source_of
from stillcal.daemon.store.document import StoreDocument
from stillcal.daemon.store.store import Store
from stillcal.daemon.system import log
from stillcal.daemon.system.clock import Clock, host_time
from stillcal.daemon.system.log import say
from stillcal.daemon.system.systemd import Notifier
from stillcal.daemon.varlink.address import socket_path
from stillcal.daemon.varlink.server import serving

SAVE_EVERY_S = 10.0
"""At most so often is the state written for new rests, s; after a full calibration it is at once."""

SAVE_AT_LEAST_S = 600.0
"""So often it is written anyway, s."""

RETRY_EVERY_S = 2.0
"""So often it is tried again where the disk refused, s."""

STOP_TIMEOUT_S = 0.5
"""A clean stop waits at most this long for the phone session, and again for the engine, s."""

HEARTBEAT_S = 10.0
"""How often the manager hears of the service where its watchdog does not ask for more, s."""

REMEDY = "record a day of it, temperature included, and see what is left out: stillcal diagnose RECORDING"
"""What a person can do where calibrating does not help."""

STUCK_SHARE = 0.5
"""An engine job that takes longer than this share of the watchdog's time counts as stuck."""


class Service:
    """The daemon. `open` first, then `run`."""

    engine_thread: EngineThread
    session: PhoneSession

    def __init__(
        self, settings: Settings, options: LaunchOptions, notifier: Notifier, clock: Clock = host_time
    ) -> None:
        self.settings, self._options, self._notifier, self._clock = settings, options, notifier, clock
        store = Store(store_path(settings.store, os.environ), settings.store)
        self.storage = Storage(store, lambda note: say("warning", "store", note))
        self.saved = SavedState(EngineState())
        self.subscribers = Subscribers()
        self._started_at = self._clock()
        self._stop = asyncio.Event()
        self._unsaved = asyncio.Event()
        self._save_now = False

    def open(self) -> None:
        """Lock the store and take up the state where it was left. Raises StoreError and SettingsError."""
        self._refuse_shared_paths()
        loaded = self.storage.open()
        if loaded.note:
            say("warning", "state", loaded.note)
        if loaded.state is not None:
            self.saved = loaded.state
            self.saved.clock.host = None
            self.saved.energy.restarted()
        engine = loaded.state.engine if loaded.state else None
        self.engine_thread = EngineThread(self.settings.engine, engine, self.storage.document.current)
        rests = self.engine_thread.view.rests_held
        say("info", "opened", store=self.storage.path, rests=rests, calibration=self.current_id)

    def _refuse_shared_paths(self) -> None:
        """Raise SettingsError where the socket or the settings lie where the store's files do."""
        taken = self.storage.paths()
        named = {"[socket] path": socket_path(self.settings.socket.path)}
        if self._options.config is not None:
            named["the settings file"] = self._options.config
        for name, path in named.items():
            if Path(os.path.realpath(path)) in taken:
                raise SettingsError(f"{name} and [store] path are the same: {path}: give another path")

    # What is known, for those who ask

    @property
    def view(self) -> View:
        """What the engine thinks."""
        return self.engine_thread.view

    @property
    def document(self) -> StoreDocument:
        """What the store holds."""
        return self.storage.document

    @property
    def source(self) -> Source:
        """The phone's line."""
        return self.session.source

    @property
    def trouble(self) -> str:
        """Why the last write to the disk failed, empty where it did not."""
        return self.storage.trouble

    @property
    def store_name(self) -> str:
        """The store's path."""
        return str(self.storage.path)

    @property
    def uptime_s(self) -> float:
        """For how long the daemon has been running, s."""
        return self._clock() - self._started_at

    @property
    def now(self) -> float | None:
        """The engine's time, s; None before the first sample since the start."""
        return self.session.now

    @property
    def current_id(self) -> str | None:
        """Id of the calibration in the store."""
        current = self.storage.document.current
        return None if current is None else current.id

    # Running

    async def run(self) -> None:
        """Serve until a signal says to stop, or something fails that must not; then it is raised."""
        self._listen_to_signals()
        self.session = self._new_session()
        async with serving(self, self.settings.socket, self._options.passed):
            jobs = [
                asyncio.create_task(job)
                for job in (
                    self._serving_phone(),
                    self._saving(),
                    self._holding_the_store(),
                    self._sending_heartbeats(),
                )
            ]
            self._notifier.ready(self.describe())
            say("info", "ready", "waiting for the phone", port=self.settings.source.port)
            stop = asyncio.create_task(self._stop.wait())
            await asyncio.wait([stop, *jobs], return_when=asyncio.FIRST_COMPLETED)
            failed = [job.exception() for job in jobs if job.done()]
            self._notifier.stopping("saving")
        await self._end(*jobs)
        for error in failed:
            raise error or RuntimeError("a part of the service has ended by itself")

    def stop(self) -> None:
        """Begin a clean end."""
        self._stop.set()

    # Jobs

    async def _serving_phone(self) -> None:
        """Serve the phone's line, and the next one where the settings come to name another."""
        served: PhoneSession | None = None
        while served is not self.session:
            served = self.session
            async with served.source:
                await served.run()
        await self._stop.wait()

    async def _saving(self) -> None:
        """Write what changes: calibrations at once, the state now and then."""
        saved_at, changed = self._clock() - SAVE_EVERY_S, False
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(saved_at + self._pause(changed) - self._clock(), 0.0)):
                    await self._unsaved.wait()
            changed = changed or self._unsaved.is_set()
            self._unsaved.clear()
            await self.storage.flush()
            if self._save_now or self._clock() - saved_at >= self._pause(changed):
                self._save_now = False
                saved_at, changed = self._clock(), not await self.save()

    def _pause(self, changed: bool) -> float:
        """Return how long (s) after one try to save the next one is due."""
        if self.storage.trouble:
            return RETRY_EVERY_S
        return SAVE_EVERY_S if changed else SAVE_AT_LEAST_S

    async def _holding_the_store(self) -> None:
        """See every now and then that the store is still ours alone."""
        while True:
            await self.storage.check_lock()
            await asyncio.sleep(HEARTBEAT_S)

    async def _sending_heartbeats(self) -> None:
        """Tell the manager that the loop lives, as long as the engine's thread does too."""
        watchdog = self._notifier.watchdog_s
        while True:
            self._notifier.status(self.describe())
            if watchdog is None or self.engine_thread.busy_for() < STUCK_SHARE * watchdog:
                self._notifier.alive()
            await asyncio.sleep(HEARTBEAT_S if watchdog is None else min(watchdog / 4, HEARTBEAT_S))

    async def save(self) -> bool:
        """Write the state; say whether it is on the disk."""
        saved = replace(self.saved, clock=copy.deepcopy(self.saved.clock), energy=self.saved.energy.copy())
        try:
            data = await self.engine_thread.encoded(saved)
        except (ValueError, TypeError, OverflowError, MemoryError) as error:
            say("error", "state", f"it cannot be written: {error!r}")
            return False
        return await self.storage.save(data)

    async def _end(self, serving: asyncio.Task[None], *others: asyncio.Task[None]) -> None:
        """Take what has arrived, save, and let go of everything."""
        self.session.source.close()
        await asyncio.wait([serving], timeout=STOP_TIMEOUT_S)
        for job in (serving, *others):
            job.cancel()
        await asyncio.gather(serving, *others, return_exceptions=True)
        saved = False
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(2 * STOP_TIMEOUT_S):
                saved = await self.engine_thread.idle(STOP_TIMEOUT_S) and await self.save()
        if not saved:
            say("warning", "stopping", "the engine or the disk is busy: the state is as it was last saved")
        self.engine_thread.close()
        self.storage.close()
        say("info", "stopped", "state saved" if saved else "", calibration=self.current_id)

    # What the engine wants done

    def act(self, actions: list[Action]) -> None:
        """Do what the engine wants done; nothing here waits."""
        for action in actions:
            if isinstance(action, Log):
                say(str(action.level), action.what, action.why, t=action.t, **action.fields)
                self._unsaved.set()
            elif isinstance(action, Diagnose):
                say("warning", "diagnose", f"{action.reason}: {REMEDY}", t=action.t)
            elif isinstance(action, Publish | Reject | Forget):
                self._enqueue(action)

    def _enqueue(self, action: Publish | Reject | Forget) -> None:
        self.storage.enqueue(with_provenance(action, self.settings.source.port, self.saved.device))
        self._save_now = self._save_now or action.record.acceptance.how != "zeroing"
        self._unsaved.set()
        self.subscribers.announce(action)

    async def calibrate(self) -> CalibrationRecord:
        """Try a full calibration now. Raises ValueError where nothing comes of it."""
        return self._outcome(await self.engine_thread.calibrate(), "there is nothing to calibrate from")

    async def zero(self) -> CalibrationRecord:
        """Measure the gyroscope's bias now. Raises ValueError where no rest shows it."""
        return self._outcome(
            await self.engine_thread.zero(), "no rest of late shows it, or nothing is calibrated yet"
        )

    def _outcome(self, reply: EngineReply, otherwise: str) -> CalibrationRecord:
        """Do what follows and return the calibration that came of it. Raises ValueError with why none did."""
        self.act(reply.actions)
        for action in reply.actions:
            if isinstance(action, Publish):
                return action.record
            if isinstance(action, Reject):
                raise ValueError(action.reason)
        raise ValueError(next((a.why for a in reply.actions if isinstance(a, Log)), otherwise))

    async def rollback(self, target: int | str) -> CalibrationRecord | None:
        """Make an earlier calibration current. Raises ValueError where there is none such."""
        document = await self.storage.rollback(target)
        await self.engine_thread.hold(document.current)
        self._unsaved.set()
        if document.current is not None:
            say("info", "rollback", "an earlier calibration is current again", calibration=self.current_id)
            self.subscribers.notify(
                Notification("rolled_back", self.now or 0.0, "as asked over the socket", document.current)
            )
        return document.current

    # Signals

    def _listen_to_signals(self) -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.stop)
        loop.add_signal_handler(signal.SIGHUP, lambda: loop.create_task(self.reload()))

    async def reload(self) -> str:
        """Read the settings again. Bad ones are refused, the reason logged and returned, the old kept."""
        self._notifier.reloading()
        try:
            await self._apply(self._options.settings())
        except SettingsError as error:
            say("error", "reload", f"refused, the old settings stay: {error}")
            return str(error)
        finally:
            self._notifier.ready(self.describe())
        say("info", "reload", "settings read again")
        return ""

    async def _apply(self, settings: Settings) -> None:
        old, self.settings = self.settings, settings
        for name in needs_restart(old, settings):
            say("warning", "reload", f"{name} has changed: that takes a restart")
        log.set_level(settings.log.level)
        self.storage.configure(settings.store)
        if settings.engine != old.engine:
            await self.engine_thread.change(settings.engine)
        if settings.source != old.source:
            self.session, last = self._new_session(), self.session
            last.source.close()

    def _new_session(self) -> PhoneSession:
        source = source_of(self.settings.source.kind, serial_settings(self.settings))
        rate_hz = self.settings.source.rate_hz
        return PhoneSession(source, self.engine_thread, self.saved, rate_hz, self.act, clock=self._clock)

    def describe(self) -> str:
        """Say in a sentence how things are."""
        view, device = self.engine_thread.view, self.session.source.device
        phone = f"phone on {device}" if device else "no phone"
        held = f"calibration {self.current_id}" if self.current_id else "no calibration yet"
        state = " that no longer fits" if view.degraded else ""
        return f"{phone}; {held}{state}; {view.watch} watch; {view.rests_held} rests held"
