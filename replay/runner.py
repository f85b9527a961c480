"""A recording through the daemon's own engine, on its own time, as fast as it goes.

The runner does what the daemon does: it hands over what the engine's actions ask for and keeps the
calibrations it accepts; it differs only in that time is the recording's and nobody waits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from stillcal.calib_core.calibration.known_faces import calibrate_faces
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Action, Level, Log, Publish, Reject
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.engine.state import EngineState, Refusal
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import given
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import Ledger
from stillcal.calib_core.streams.events import End, Event
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.formats.trace import Chunk


@dataclass(slots=True)
class Outcome:
    """What a replay left behind. samples: of both sensors. warned: the first of each kind of warning."""

    record: CalibrationRecord | None = None
    refusal: Refusal | None = None
    rejected: int = 0
    samples: int = 0
    t_start: float | None = None
    t_end: float | None = None
    warned: dict[str, Log] = field(default_factory=dict)
    state: EngineState | None = None
    ledger: Ledger = field(default_factory=Ledger)

    @property
    def duration(self) -> float:
        """Span of the samples' stamps, s; 0 where there were none."""
        return 0.0 if self.t_start is None or self.t_end is None else self.t_end - self.t_start

    @property
    def warnings(self) -> list[str]:
        """The first warning of each kind, a line each, with when it was given."""
        start = self.t_start or 0.0
        return [f"{line.t - start:.1f} s after the first sample: {line.why}" for line in self.warned.values()]


def with_choices(
    settings: EngineSettings,
    gravity: float | None = None,
    watch: str | None = None,
    claimed: Callable[[], float | None] = lambda: None,
) -> EngineSettings:
    """Return settings with what the caller chose: local gravity (m/s^2) and how the engine watches.

    Gravity is the caller's, else the settings', else what `claimed` returns, which is called last. Raises
    ValueError where gravity is none of the Earth's, or `watch` is not auto, continuous or probing.
    """
    schedule = settings.schedule
    if gravity is not None:
        schedule = replace(schedule, gravity=given(gravity).value)
    elif schedule.gravity is None:
        schedule = replace(schedule, gravity=claimed())
    if watch is not None:
        chosen: Any = watch
        schedule = replace(schedule, watch=chosen)
    return replace(settings, schedule=schedule)


Keep = Callable[[Publish | Reject], None]


def replay(
    chunks: Iterable[Chunk], engine: Engine, keep: Keep, progress: Callable[[], None] | None = None
) -> Outcome:
    """Feed a recording to `engine` chunk by chunk and return what came of it.

    keep: is handed every calibration that was accepted or rejected, in order. progress: called after
    each chunk. Errors of the recording pass through; what `keep` was given before them stays given.
    """
    outcome = Outcome()
    for chunk in chunks:
        items = _items(chunk)
        _note(outcome, items)
        _act(outcome, engine.feed(*items), keep)
        if progress is not None:
            progress()
    return _closed(outcome, engine, keep)


def replay_rests(rests: Iterable[RestState], engine: Engine, keep: Keep) -> Outcome:
    """Hand a rest table's rows to `engine` as gathered rests, and let it calibrate."""
    outcome = Outcome()
    table = list(rests)
    engine.add_rests(table)
    outcome.samples = sum(r.n for r in table)
    outcome.t_start, outcome.t_end = (table[0].t_start, table[-1].t_end) if table else (None, None)
    return _closed(outcome, engine, keep)


def calibrated_by_faces(outcome: Outcome, settings: EngineSettings) -> list[Publish]:
    """Calibrate from the six faces among a replay's rests, in place of what the engine made of them.

    Returns the calibration as an action, or nothing where a face is missing; the outcome then says which.
    """
    assert outcome.state is not None
    pool, gravity, t = outcome.state.pool, outcome.state.gravity, outcome.t_end or 0.0
    try:
        outcome.record = calibrate_faces(pool, gravity, t, settings.calibrate)
    except NotSupported as refusal:
        outcome.record, outcome.refusal = None, Refusal(refusal.reason, refusal.missing)
        return []
    outcome.refusal = None
    return [Publish(t, outcome.record, outcome.record.acceptance.reason)]


def _items(chunk: Chunk) -> list[Samples | Event]:
    return [chunk.gyroscope, chunk.accelerometer, *chunk.events]


def _note(outcome: Outcome, items: Iterable[Samples | Event]) -> None:
    for item in items:
        if isinstance(item, Samples) and len(item):
            first, last = float(item.t[0]), float(item.t[-1])
            outcome.t_start = first if outcome.t_start is None else min(first, outcome.t_start)
            outcome.t_end = last if outcome.t_end is None else max(last, outcome.t_end)
            outcome.samples += len(item)


def _closed(outcome: Outcome, engine: Engine, keep: Keep) -> Outcome:
    _act(outcome, engine.feed(End(outcome.t_end or 0.0)), keep)
    outcome.state, outcome.ledger = engine.state, engine.ledger
    outcome.record, outcome.refusal = outcome.state.record, outcome.state.refusal
    return outcome


def _act(outcome: Outcome, actions: Iterable[Action], keep: Keep) -> None:
    for action in actions:
        if isinstance(action, Log):
            if action.level is Level.WARNING:
                outcome.warned.setdefault(action.what, action)
        elif isinstance(action, Publish | Reject):
            outcome.rejected += isinstance(action, Reject)
            keep(action)
