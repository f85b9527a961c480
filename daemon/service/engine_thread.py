"""The engine in a thread of its own, so that no fit delays samples or answers.

The thread does its jobs in order, and nothing else touches the engine. Other code sees frozen views of it.
The interpreter switches threads within SWITCH_S, and numpy releases it during long calls. A separate process
for the fit was tried: the event loop is no less late with it (docs/faults.md).
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.calibration.suspicion import Suspicion
from stillcal.calib_core.engine.actions import Action
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.laid_faces import LaidFaces
from stillcal.calib_core.engine.settings import EngineSettings, Watch
from stillcal.calib_core.engine.state import Counters, EngineState, Refusal, Trouble, without_streams
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.settings import Ledger, Sense, Sleep
from stillcal.calib_core.streams.events import End, Event
from stillcal.calib_core.streams.samples import SampleError, Samples, Sensor
from stillcal.calib_core.temperature.charger import Charger
from stillcal.calib_core.temperature.thermometer import Thermometer
from stillcal.daemon.service.saved_state import SavedState, encode
from stillcal.daemon.system.clock import Clock
from stillcal.daemon.system.worker import Worker

T = TypeVar("T")

SWITCH_S = 0.001
"""Longest time that a thread may keep the interpreter from another, s; it bounds the loop's lateness."""


@dataclass(frozen=True, slots=True)
class View:
    """The engine's state at one moment. decides: time of its next decision, s; inf where none is planned.

    rests_kept: for learning. learns_temperature: whether the settings have it learnt. on_trial: effects of
    which a term is tested, and since when (s). suspected: steps of a bias. faces: how far six known faces
    have come that were asked for. faults: what is wrong with a sensor, in words.
    """

    want: Sense | Sleep
    decides: float
    watch: Watch
    record: CalibrationRecord | None
    refusal: Refusal | None
    gravity: Gravity
    counters: Counters
    ledger: Ledger
    charging: bool | None
    degraded: bool
    check_due: bool
    checked: float | None
    trouble: Trouble | None
    diagnosis: str
    next_check: float | None
    rests_held: int
    pool: Pool
    thermometer: Thermometer = field(default_factory=Thermometer)
    charger: Charger = field(default_factory=Charger)
    rests_kept: int = 0
    learns_temperature: bool = True
    on_trial: Mapping[str, float] = field(default_factory=dict)
    suspected: Mapping[Sensor, Suspicion] = field(default_factory=dict)
    faces: LaidFaces | None = None
    faults: Mapping[Sensor, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class EngineReply:
    """The result of one job: actions to carry out, the view after it, and why samples were refused."""

    actions: list[Action]
    view: View
    refused: tuple[str, ...] = ()


class EngineThread:
    """The engine behind a thread. Every coroutine waits for the jobs before it. clock: for `busy_for`."""

    def __init__(
        self,
        settings: EngineSettings,
        state: EngineState | None,
        record: CalibrationRecord | None,
        clock: Clock = time.monotonic,
    ) -> None:
        self._engine = Engine(settings, state)
        if _identity(record) != _identity(self._engine.present.record):
            self._engine.use_calibration(record)
        self._thread = Worker("engine")
        self.view = _view(self._engine)
        self._clock, self._jobs, self._since = clock, 0, 0.0
        sys.setswitchinterval(SWITCH_S)

    async def feed(self, items: Sequence[Samples | Event]) -> EngineReply:
        """Feed items in order; samples that the engine refuses are skipped, and the reply says why."""
        return self._with_view(await self._run(self._feed, items))

    async def encoded(self, saved: SavedState) -> bytes:
        """Return the state file's contents: the engine's current state, the rest from `saved`."""
        return await self._run(lambda: encode(replace(saved, engine=self._engine.state)))

    async def change(self, settings: EngineSettings) -> None:
        """Continue with other settings."""
        await self._ask(lambda engine: engine.change_settings(settings))

    async def hold(self, record: CalibrationRecord | None) -> None:
        """Make `record` the current calibration, as after a rollback."""
        await self._ask(lambda engine: engine.use_calibration(record))

    async def calibrate(self) -> EngineReply:
        """Try a full calibration now."""
        return await self._ask(lambda engine: engine.calibrate())

    async def zero(self) -> EngineReply:
        """Measure the gyroscope's bias now."""
        return await self._ask(lambda engine: engine.update_bias())

    async def lay_faces(self) -> EngineReply:
        """Have the phone laid on its six faces, or go on with it."""
        return await self._ask(lambda engine: engine.lay_faces())

    async def stop_faces(self) -> EngineReply:
        """Stop having it laid on its faces."""
        return await self._ask(lambda engine: engine.stop_faces())

    async def consider(self, findings: Sequence[Mapping[str, Any]]) -> EngineReply:
        """Take the findings of a diagnosis of the rests kept."""
        return await self._ask(lambda engine: engine.consider(findings))

    async def forget(self, reason: str) -> EngineReply:
        """Start from scratch with another phone."""
        return await self._ask(lambda engine: engine.forget(reason))

    def busy_for(self) -> float:
        """Return how long the current job has been running, s; 0 where there is none."""
        return self._clock() - self._since if self._jobs else 0.0

    def close(self) -> None:
        """Stop the thread after its current job."""
        self._thread.close()

    def _feed(self, items: Sequence[Samples | Event]) -> EngineReply:
        actions: list[Action] = []
        refused: list[str] = []
        for item in items:
            try:
                actions += self._engine.feed(item)
                if isinstance(item, End):
                    self._engine.resume(item.t)
            except SampleError as error:
                refused.append(str(error))
            except Exception as error:  # whatever a phone sends must not end the daemon
                refused.append(f"the engine failed and goes on without its streams: {error!r}")
                self._engine = Engine(self._engine.settings, without_streams(self._engine.present))
        return EngineReply(actions, _view(self._engine), tuple(refused))

    def _call_engine(self, ask: Callable[[Engine], list[Action] | None]) -> EngineReply:
        return EngineReply(ask(self._engine) or [], _view(self._engine))

    async def _ask(self, ask: Callable[[Engine], list[Action] | None]) -> EngineReply:
        return self._with_view(await self._run(self._call_engine, ask))

    def _with_view(self, reply: EngineReply) -> EngineReply:
        self.view = reply.view
        return reply

    async def _run(self, job: Callable[..., T], *arguments: object) -> T:
        """Run a job in the thread, after those before it."""
        if not self._jobs:
            self._since = self._clock()
        self._jobs += 1
        try:
            return await self._thread.run(job, *arguments)
        finally:
            self._jobs -= 1
            self._since = self._clock()


def _identity(record: CalibrationRecord | None) -> str:
    return "" if record is None else record.id


def _view(engine: Engine) -> View:
    s = engine.present
    begun = s.began is not None
    times = [t for t in (s.next_review, s.next_check, *(e.t for e in s.events)) if t is not None]
    return View(
        want=engine.wants(),
        decides=min(times, default=math.inf),
        watch=s.watch if begun else Watch.CONTINUOUS,
        record=s.record,
        refusal=s.refusal,
        gravity=s.gravity,
        counters=replace(s.counters),
        ledger=engine.ledger,
        charging=s.charging,
        degraded=s.degraded,
        check_due=s.check_due,
        checked=s.checked,
        trouble=s.trouble,
        diagnosis=_diagnosis(s.trouble, engine.settings.schedule.diagnose_after_checks),
        next_check=s.next_check,
        rests_held=len(s.pool.held),
        pool=s.pool,
        thermometer=s.thermometer,
        charger=s.charger,
        rests_kept=len(s.memory),
        learns_temperature=engine.settings.schedule.learn_temperature,
        on_trial={trial.term.effect: trial.since for trial in s.trials},
        suspected=s.suspected,
        faces=s.faces,
        faults=s.faults,
    )


def _diagnosis(trouble: Trouble | None, after: int) -> str:
    """Return why a diagnosis is advised; empty where it is not."""
    return trouble.reason if trouble is not None and trouble.failed >= after else ""
