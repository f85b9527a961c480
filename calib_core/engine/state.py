"""The engine's state, as plain records.

`EngineState` is all that has to be saved for the engine to go on; codec.py packs and unpacks it without loss.
Its field names are the keys of saved states.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from stillcal.calib_core import gravity as local_gravity
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.calibration.suspicion import Suspicion
from stillcal.calib_core.calibration.trial import Trial
from stillcal.calib_core.engine.duty_cycle import DutyBudget
from stillcal.calib_core.engine.laid_faces import LaidFaces
from stillcal.calib_core.engine.settings import EngineSettings, Watch
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.detector import DetectorState
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import Ledger
from stillcal.calib_core.streams.events import Event
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.temperature.charger import Charger
from stillcal.calib_core.temperature.memory import Memory
from stillcal.calib_core.temperature.thermometer import Thermometer


@dataclass(slots=True)
class Counters:
    """How often the engine did what since it first began.

    turns: rotation segments. undersampled: turns too fast for the gyroscope's sampling rate.
    """

    rests: int = 0
    turns: int = 0
    calibrations: int = 0
    rejected: int = 0
    refused: int = 0
    checks: int = 0
    zeroings: int = 0
    degradations: int = 0
    undersampled: int = 0


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why the rests did not support a fit, and what to gather; see NotSupported."""

    reason: str
    missing: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Move:
    """A change of place that was reported at t (s). left: gravity at the place before."""

    t: float
    left: Gravity


@dataclass(frozen=True, slots=True)
class Trouble:
    """A row of failed checks, none of which has passed.

    since: s, time of the first failed check. tried: whether a calibration was tried since. failed: how many
    checks in a row have failed after that calibration. size: m/s^2, the largest residual of a rest in them.
    """

    since: float
    tried: bool = False
    failed: int = 0
    size: float = 0.0

    @property
    def reason(self) -> str:
        """The trouble in a sentence, for when a new calibration has not helped."""
        return f"{self.failed} checks in a row have failed although the phone was calibrated anew"

    def after_failed_check(self, size: float) -> Trouble:
        """Return the trouble after one more failed check. size: m/s^2, its largest residual."""
        return replace(self, failed=self.failed + self.tried, size=max(self.size, size))


@dataclass(slots=True)
class EngineState:
    """All that changes while the engine runs. Times in s; None where something has not happened yet.

    waiting: samples that the detector has not seen yet. events: events whose time has not come. latest:
    the newest stamp of each stream. began: stamp of the first sample. heard: the clock's last tick.
    next_check, next_review: the coming deadlines. early_check: when a bias is expected to have wandered
    too far. check_due: a check waits for a rest. checked, tried: times of the last check and of the last
    attempt to fit. allowance: the duty-cycle budget. degraded: the calibration failed its check. moves:
    recent changes of place. memory: the rests that temperature and wander are learnt from. thermometer:
    its readings of late. charger: its changes of late. attitudes: number of distinct ones in the pool.
    fresh: rests gathered since the last attempt to fit. gyro_tail: gyroscope samples that the next
    rotation segment may be cut from. sound_until: when a calibration that now fails last passed a check.
    centre: the calibration that was accepted last, where the accelerometer's in use follows the rests since.
    refusal: why the last attempt to fit was refused. trouble: None where the last check passed. suspected:
    steps of a bias that a single rest since the last check may have shown. trials: terms of a diagnosis that
    are tested on the rests since. faces: how far six known faces have come that were asked for. faults: what
    is wrong with a sensor, in words. inspected: the detector's counts when that was last looked at.
    rates_doubted: what is wrong with the gyroscope by the newest rest, whose rates were left out; else empty.
    """

    detector: DetectorState | None = None
    waiting: dict[Sensor, Samples] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    latest: dict[Sensor, float] = field(default_factory=dict)
    began: float | None = None
    heard: float | None = None
    next_check: float | None = None
    next_review: float | None = None
    early_check: float | None = None
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
    memory: Memory = field(default_factory=Memory)
    thermometer: Thermometer = field(default_factory=Thermometer)
    charger: Charger = field(default_factory=Charger)
    attitudes: int = 0
    fresh: int = 0
    last_rest: RestState | None = None
    gyro_tail: Samples | None = None
    record: CalibrationRecord | None = None
    centre: CalibrationRecord | None = None
    sound_until: float | None = None
    refusal: Refusal | None = None
    trouble: Trouble | None = None
    suspected: dict[Sensor, Suspicion] = field(default_factory=dict)
    trials: tuple[Trial, ...] = ()
    faces: LaidFaces | None = None
    faults: dict[Sensor, str] = field(default_factory=dict)
    inspected: Ledger = field(default_factory=Ledger)
    rates_doubted: str = ""
    counters: Counters = field(default_factory=Counters)

    @property
    def calibrated(self) -> bool:
        """Whether there is a full calibration; before the first one there may be a gyroscope part alone."""
        return self.record is not None and self.record.accelerometer is not None

    @property
    def complete(self) -> bool:
        """Whether there is a full calibration that stands on its rests alone, without a prior."""
        part = None if self.record is None else self.record.accelerometer
        return part is not None and not part.with_prior


def first_state(settings: EngineSettings) -> EngineState:
    """Return the state before the first sample."""
    known = settings.schedule.gravity
    return EngineState(gravity=Gravity() if known is None else local_gravity.given(known))


def without_phone(state: EngineState) -> EngineState:
    """Return what remains of a state when another phone replaces this one: time, place and charger."""
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
