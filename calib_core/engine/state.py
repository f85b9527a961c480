"""What the engine is told once, and what it remembers: plain records, no behaviour.

`EngineState` is all there is to save; it packs and unpacks (codec) without loss.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from stillcal.calib_core import gravity as local_gravity
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.engine.duty_cycle import DutyBudget
from stillcal.calib_core.engine.settings import EngineSettings, Watch
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.detector import DetectorState
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Event
from stillcal.calib_core.streams.samples import Samples, Sensor


@dataclass(slots=True)
class Counters:
    """What the engine did since it first began."""

    rests: int = 0
    turns: int = 0
    calibrations: int = 0
    rejected: int = 0
    refused: int = 0
    checks: int = 0
    zeroings: int = 0
    degradations: int = 0


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a fit was refused, and what to gather; see NotSupported."""

    reason: str
    missing: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Move:
    """The phone was told at t (s) of another place; left: gravity of where it was before."""

    t: float
    left: Gravity


@dataclass(frozen=True, slots=True)
class Trouble:
    """Checks have failed and none has passed since. since: s, the first that did.

    tried: whether a calibration was tried since; failed: how many checks in a row failed after that.
    """

    since: float
    tried: bool = False
    failed: int = 0

    @property
    def reason(self) -> str:
        """Say what is the matter, once calibrating anew has not helped."""
        return f"{self.failed} checks in a row have failed although it was calibrated anew"

    def after_failed_check(self) -> Trouble:
        """Return how things stand after one more."""
        return replace(self, failed=self.failed + 1) if self.tried else self


@dataclass(slots=True)
class EngineState:
    """All that changes. Times in s; None where something has not happened yet.

    waiting: samples not yet looked at; latest: each stream's newest stamp; heard: the clock's last tick.
    check_due: a check waits for a rest; checked, tried: when the last check and the last try to fit were.
    attitudes: distinct ones in the pool. fresh: rests gathered since the last try. gyro_tail: what the
    next turn may be cut from. sound_until: when a calibration that now fails last passed a check. moves:
    when the place was told anew, of late. refusal: why the last try to fit came to nothing. trouble: None
    where the last check passed.
    """

    detector: DetectorState | None = None
    waiting: dict[Sensor, Samples] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    latest: dict[Sensor, float] = field(default_factory=dict)
    began: float | None = None
    heard: float | None = None
    next_check: float | None = None
    next_review: float | None = None
    check_due: bool = False
    checked: float | None = None
    tried: float | None = None
    watch: Watch = Watch.IDLE
    allowance: DutyBudget | None = None
    charging: bool | None = None
    degraded: bool = False
    gravity: Gravity = field(default_factory=Gravity)
    moves: list[Move] = field(default_factory=list)
    pool: Pool = field(default_factory=Pool)
    attitudes: int = 0
    fresh: int = 0
    last_rest: RestState | None = None
    gyro_tail: Samples | None = None
    record: CalibrationRecord | None = None
    sound_until: float | None = None
    refusal: Refusal | None = None
    trouble: Trouble | None = None
    counters: Counters = field(default_factory=Counters)


def first_state(settings: EngineSettings) -> EngineState:
    """Return what there is before the first sample."""
    known = settings.schedule.gravity
    return EngineState(gravity=Gravity() if known is None else local_gravity.given(known))


def without_phone(state: EngineState) -> EngineState:
    """Return what still holds when another phone takes the place of this one: time, place, charger."""
    return EngineState(
        latest=state.latest,
        heard=state.heard,
        charging=state.charging,
        gravity=state.gravity,
        counters=state.counters,
    )


def without_streams(state: EngineState) -> EngineState:
    """Return what still holds where what is left unread of the streams cannot be used."""
    return replace(
        state, detector=None, waiting={}, events=[], last_rest=None, gyro_tail=None, watch=Watch.IDLE
    )
