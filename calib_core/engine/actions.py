"""What comes out of the engine: what it wants done. Plain records; the daemon and replay carry them out."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.static.settings import Sense, Sleep


class Level(StrEnum):
    """How much a log line matters; the names are syslog's."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Log:
    """Something a person may want to know: what (a stable name), why (a sentence), and figures."""

    t: float
    level: Level
    what: str
    why: str
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Publish:
    """Keep this calibration as the current one, with the reason it was accepted."""

    t: float
    record: CalibrationRecord
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Reject:
    """Record that this candidate was fitted and not taken, and why."""

    t: float
    record: CalibrationRecord
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Forget:
    """The current calibration is of another phone: it is current no longer. Why is the reason."""

    t: float
    record: CalibrationRecord
    reason: str


@dataclass(frozen=True, slots=True)
class Diagnose:
    """Calibrating anew does not help: somebody should look for what the model leaves out. Asked once."""

    t: float
    reason: str


Action = Sense | Sleep | Log | Publish | Reject | Forget | Diagnose
