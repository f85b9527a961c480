"""The daemon that `stillcal run` starts: its parts put together, from the start to the clean end.

One event loop serves the phone's line, the socket and the signals. The engine runs in one thread and
the disk is written in another (service/engine_thread.py, service/storage.py). Neither delays the loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import copy
import os
import signal
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Log, Publish, Reject
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.errors import TryAgainError
from stillcal.daemon.app_launch import LaunchOptions, needs_restart, serial_settings
from stillcal.daemon.publish.chip import keeping_chip, memory_path
from stillcal.daemon.publish.publishing import Publisher, publishing
from stillcal.daemon.publish.targets import publishers
from stillcal.daemon.service import saved_state
from stillcal.daemon.service.engine_actions import EngineActions
from stillcal.daemon.service.engine_thread import EngineReply, EngineThread, View
from stillcal.daemon.service.finding_outcomes import outcome
from stillcal.daemon.service.live_stream import Live
from stillcal.daemon.service.phone_session import PhoneSession
from stillcal.daemon.service.sample_readers import SampleReaders
from stillcal.daemon.service.saved_state import SavedState
from stillcal.daemon.service.saving import Saving
from stillcal.daemon.service.self_diagnosis import Night, diagnose
from stillcal.daemon.service.storage import Storage
from stillcal.daemon.service.subscribers import CalibrationSubscribers, Notification, Subscriber
from stillcal.daemon.settings import Settings, SettingsError, store_path
from stillcal.daemon.sources.base import Source
from stillcal.daemon.sources.open import source_of
from stillcal.daemon.store.document import StoreDocument
from stillcal.daemon.store.store import Store
from stillcal.daemon.system import log
from stillcal.daemon.system.clock import Clock, host_time
from stillcal.daemon.system.files import passing
from stillcal.daemon.system.log import say
from stillcal.daemon.system.systemd import Notifier
from stillcal.daemon.varlink.address import socket_path
from stillcal.daemon.varlink.server import Server, serving

END_S, LAST_SAMPLES_S = 1.2, 0.5
"""A clean stop waits at most so long for everything together, and of that for the phone's last samples, s.

With what the log may take (log.FLUSH_S) and the interpreter's own end, the daemon ends within 2 s of SIGTERM.
"""

HEARTBEAT_S = 10.0
"""Time between two status messages to systemd, s, unless its watchdog wants them more often."""

LOOK_FOR_NIGHT_S = 60.0
"""Time between two looks whether a self-diagnosis is due, s."""

STUCK_SHARE = 0.5
"""An engine job that takes longer than this share of the watchdog's time counts as stuck."""


def _drawn_seed() -> int:
    """Return a random seed above 0."""
    return 1 + int.from_bytes(os.urandom(4), "little")


def _open(publisher: Publisher) -> None:
    """Open a publisher; one that a passing fault keeps closed opens later. Raises SettingsError."""
    try:
        publisher.open()
    except OSError as error:
        if not passing(error):
            raise SettingsError(f"--publish {publisher.name}: {error.strerror}") from error
        say("warning", "publish", f"{publisher.name}: {error.strerror}: opened when samples come")


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
        self.subscribers = CalibrationSubscribers()
        self.readers = SampleReaders(self._send_commands)
        self._publishers = list(publishers(settings.publish))
        self._started_at = self._clock()
        self._stop = asyncio.Event()
        self.saving = Saving(self.storage, self._encoded, clock)
        self.actions = EngineActions(
            self.storage,
            self.saving,
            self.subscribers,
            lambda: (self.settings.source.port, self.saved.device),
        )
        self._server: Server | None = None

    def open(self) -> None:
        """Lock the store, continue from the saved state, open what is published to.

        Raises StoreError, SettingsError and TryAgainError.
        """
        self._refuse_shared_paths()
        loaded = self.storage.open()
        if loaded.note:
            say("warning", "state", loaded.note)
        if loaded.state is not None:
            self.saved = loaded.state
            self.saved.clock.host = None
            self.saved.energy.restarted()
        self.saved.seed = self.saved.seed or _drawn_seed()
        engine = loaded.state.engine if loaded.state else None
        settings = self._engine_settings(self.settings)
        self.engine_thread = EngineThread(settings, engine, self.storage.document.current)
        rests = self.engine_thread.view.rests_held
        for publisher in self._publishers:
            _open(publisher)
        say("info", "opened", store=self.storage.path, rests=rests, calibration=self.current_id)

    def _refuse_shared_paths(self) -> None:
        """Raise SettingsError where something else is to lie where the store's files do."""
        taken = self.storage.paths()
        named = [("[socket] path", socket_path(self.settings.socket.path))]
        if self._options.config is not None:
            named.append(("the settings file", self._options.config))
        named += [("[publish] to", Path(to)) for to in self.settings.publish.to if to.endswith(".mcap")]
        for name, path in named:
            if Path(os.path.realpath(path)) in taken:
                raise SettingsError(f"{name} and [store] path are the same: {path}: give another path")

    # What the socket answers from

    @property
    def view(self) -> View:
        """The engine's view after its last job."""
        return self.engine_thread.view

    @property
    def document(self) -> StoreDocument:
        """The contents of the store."""
        return self.storage.document

    @property
    def source(self) -> Source:
        """The source of samples: the phone's line or the machine's own sensors."""
        return self.session.source

    @property
    def trouble(self) -> str:
        """Why the last write to the disk failed; empty after a write that succeeded."""
        return self.storage.trouble

    @property
    def store_name(self) -> str:
        """The store's path."""
        return str(self.storage.path)

    @property
    def uptime_s(self) -> float:
        """Time since the daemon started, s."""
        return self._clock() - self._started_at

    @property
    def now(self) -> float | None:
        """The engine's time, s; None before the first sample since the start."""
        return self.session.now

    @property
    def seed(self) -> int:
        """The seed of the random pauses between probes."""
        return self.settings.engine.detector.seed or self.saved.seed

    @property
    def current_id(self) -> str | None:
        """Id of the current calibration; None where there is none."""
        current = self.storage.document.current
        return None if current is None else current.id

    # Running

    async def run(self) -> None:
        """Serve until a signal asks to stop. Raises what ended one of the tasks before that."""
        self._listen_to_signals()
        self.session = self._new_session()
        async with serving(self, self.settings.socket, self._options.passed) as self._server:
            jobs = [
                asyncio.create_task(job)
                for job in (
                    self._serving_phone(),
                    self.saving.run(),
                    self.saving.hold(),
                    self._sending_heartbeats(),
                    self._diagnosing_at_night(),
                    *(publishing(publisher, self._listening) for publisher in self._publishers),
                    *([self._keeping_chip()] if "iio" in self.settings.publish.to else []),
                )
            ]
            self._notifier.ready(self.describe())
            say("info", "ready", "waiting for the phone", port=self.settings.source.port)
            stop = asyncio.create_task(self._stop.wait())
            await asyncio.wait([stop, *jobs], return_when=asyncio.FIRST_COMPLETED)
            until = asyncio.get_running_loop().time() + END_S
            failed = [job.exception() for job in jobs if job.done()]
            self._notifier.stopping("saving")
        await self._end(until, *jobs)
        for error in failed:
            raise error or RuntimeError("a task of the service ended unexpectedly")

    def stop(self) -> None:
        """Stop cleanly: `run` then saves and returns."""
        self._stop.set()

    # Jobs

    async def _serving_phone(self) -> None:
        """Serve the source, and after a reload that changes [source], the new one."""
        served: PhoneSession | None = None
        while served is not self.session:
            served = self.session
            async with served.source:
                await served.run()
        await self._stop.wait()

    async def _keeping_chip(self) -> None:
        """Keep the calibration in the registers of the machine's own sensors."""
        memory = memory_path(self.storage.path)
        await keeping_chip(lambda: self.source, lambda: self.view.record, self.subscribers, memory)

    async def _sending_heartbeats(self) -> None:
        """Tell systemd that the service is alive, unless the engine's thread is stuck."""
        watchdog = self._notifier.watchdog_s
        while True:
            self._notifier.status(self.describe())
            if watchdog is None or self.engine_thread.busy_for() < STUCK_SHARE * watchdog:
                self._notifier.alive()
            await asyncio.sleep(HEARTBEAT_S if watchdog is None else min(watchdog / 4, HEARTBEAT_S))

    async def _diagnosing_at_night(self) -> None:
        """Diagnose the rests kept whenever that is due."""
        night = Night()
        while True:
            await asyncio.sleep(LOOK_FOR_NIGHT_S)
            view, now, last = self.view, self.now, self.saved.night
            if now is not None and night.is_due(
                now, view.charging, view.rests_kept, last, self.settings.diagnosis
            ):
                await self._diagnose_itself(now, view.rests_kept)

    async def _diagnose_itself(self, now: float, rests: int) -> None:
        """Diagnose the rests of the saved state, take up what can be, and keep the report. now: s."""
        last, state = self.saved.night, saved_state.state_path(self.storage.path)
        report = await diagnose(state, self.settings.diagnosis, now, rests)
        if self.saved.night is not last:
            return  # another phone came meanwhile: these were not its rests
        took = {"rests": rests, "processor_s": round(report.processor_s, 1)}
        took["memory_mib"] = round(report.memory_bytes / 2**20)
        if report.trouble:
            report = replace(report, verdict=last.verdict, findings=last.findings)
            say("warning", "self-diagnosis", report.trouble, t=now, **took)
        else:
            findings = report.read()
            self.actions.carry_out((await self.engine_thread.consider(findings)).actions)
            say("info", "self-diagnosis", report.headline, t=now, **took)
            for finding in findings:
                became = outcome(finding, self.view, self.document, now)
                say("info", "self-diagnosis", f"{finding['statement']} {became.sentence}")
        self.saved.night = report
        self.saving.changed()

    async def _encoded(self) -> bytes:
        """Return the state file's contents now."""
        saved = replace(self.saved, clock=copy.deepcopy(self.saved.clock), energy=self.saved.energy.copy())
        return await self.engine_thread.encoded(saved)

    async def _end(self, until: float, serving: asyncio.Task[None], *others: asyncio.Task[None]) -> None:
        """Feed what has arrived, save the state, and release the source, the thread and the store.

        until: by the loop's time, s. What hangs then, such as the engine, a disk or a publisher, is left.
        """
        self.session.source.close()
        await asyncio.wait([serving], timeout=LAST_SAMPLES_S)
        for job in (serving, *others):
            job.cancel()
        saving = asyncio.create_task(self.saving.save())
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(until):
                await asyncio.gather(saving, serving, *others, return_exceptions=True)
        saved = not saving.cancelled() and saving.result()
        if not saved:
            why = "the engine or the disk is busy" if saving.cancelled() else "see above"
            self.saving.say_what_is_lost(why)
        self.engine_thread.close()
        self.storage.close()
        say("info", "stopped", "state saved" if saved else "", calibration=self.current_id)

    # Requests

    async def calibrate(self) -> CalibrationRecord:
        """Try a full calibration now. Raises ValueError with the reason where there is no better one."""
        return self._outcome(await self.engine_thread.calibrate(), "no rests are held yet")

    async def zero(self) -> CalibrationRecord:
        """Measure the gyroscope's bias now. Raises ValueError where there is no recent rest."""
        return self._outcome(
            await self.engine_thread.zero(), "there is no calibration yet, or no recent rest"
        )

    async def lay_faces(self, stop: bool) -> None:
        """Have the phone laid on its six faces, with its sensors on meanwhile; or stop that."""
        thread = self.engine_thread
        self.actions.carry_out((await (thread.stop_faces() if stop else thread.lay_faces())).actions)
        self._send_commands()

    def _outcome(self, reply: EngineReply, otherwise: str) -> CalibrationRecord:
        """Carry out a reply and return its calibration. Raises ValueError where it has none."""
        self.actions.carry_out(reply.actions)
        for action in reply.actions:
            if isinstance(action, Publish):
                return action.record
            if isinstance(action, Reject):
                raise ValueError(action.reason)
        raise ValueError(next((a.why for a in reply.actions if isinstance(a, Log)), otherwise))

    async def rollback(self, target: int | str) -> CalibrationRecord | None:
        """Make an earlier calibration current. Raises ValueError where the history has none such."""
        document = await self.storage.rollback(target)
        await self.engine_thread.hold(document.current)
        self.saving.changed()
        if document.current is not None:
            say("info", "rollback", "an earlier calibration is current again", calibration=self.current_id)
            self.subscribers.notify(
                Notification("rolled_back", self.now or 0.0, "requested over the socket", document.current)
            )
        return document.current

    # Signals

    def _listen_to_signals(self) -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.stop)
        loop.add_signal_handler(signal.SIGHUP, lambda: loop.create_task(self.reload()))

    async def reload(self) -> str:
        """Read the settings again. Returns why they were refused (the old ones then stay), or nothing."""
        self._notifier.reloading()
        try:
            await self._apply(self._options.settings_again())
        except (SettingsError, TryAgainError) as error:
            say("error", "reload", f"refused, the old settings stay in force: {error}")
            return str(error)
        finally:
            self._notifier.ready(self.describe())
        say("info", "reload", "settings read again")
        return ""

    async def _apply(self, settings: Settings) -> None:
        old, self.settings = self.settings, settings
        for name in needs_restart(old, settings):
            say("warning", "reload", f"{name} has changed: restart the daemon to apply it")
        log.set_level(settings.log.level)
        self.storage.configure(settings.store)
        if self._server is not None:
            self._server.settings = settings.socket
        if settings.engine != old.engine:
            await self.engine_thread.change(self._engine_settings(settings))
        if settings.source != old.source:
            self.session, last = self._new_session(), self.session
            last.source.close()

    def _engine_settings(self, settings: Settings) -> EngineSettings:
        """Return the engine's settings, with this phone's own seed where they fix none."""
        detector = settings.engine.detector
        return replace(settings.engine, detector=replace(detector, seed=detector.seed or self.saved.seed))

    def _new_session(self) -> PhoneSession:
        source = source_of(self.settings.source.kind, serial_settings(self.settings))
        rate_hz = self.settings.source.rate_hz
        return PhoneSession(
            source,
            self.engine_thread,
            self.saved,
            rate_hz,
            self.actions.carry_out,
            readers=self.readers,
            clock=self._clock,
        )

    def _send_commands(self) -> None:
        """Tell the phone, whichever it is now, what is wanted of its sensors."""
        self.session.send_commands()

    def _listening(self, patience_s: float) -> AbstractContextManager[Subscriber[Live]]:
        """Subscribe to corrected samples for a publisher."""
        return self.readers.streaming(sparing=False, patience_s=patience_s)

    @property
    def claims(self) -> Mapping[str, Any]:
        """What the phone's maker claims of it, by the names of a recording's NAME.json."""
        return {} if self.session.hello is None else self.session.hello.claims

    def describe(self) -> str:
        """Return the daemon's state in one line, for systemctl status."""
        view, device = self.engine_thread.view, self.session.source.device
        phone = f"phone on {device}" if device else "no phone"
        held = f"calibration {self.current_id}" if self.current_id else "no calibration yet"
        state = " (no longer fits)" if view.degraded else ""
        return f"{phone}; {held}{state}; {view.watch} watch; {view.rests_held} rests held"
