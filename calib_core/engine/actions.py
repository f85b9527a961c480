"""The actions that the engine asks for, as plain records; the daemon and the replay carry them out."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.static.settings import Sense, Sleep


class Level(StrEnum):
    """The severity of a log line, by syslog's names."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Log:
    """A line for the log.

    t: s, sample time. what: a stable name for this kind of event. why: a sentence. fields: figures.
    """

    t: float
    level: Level
    what: str
    why: str
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Publish:
    """Store and publish this calibration as the current one; reason: why it was accepted."""

    t: float
    record: CalibrationRecord
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Reject:
    """Enter this candidate into the history as rejected; reason: why it was."""

    t: float
    record: CalibrationRecord
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Forget:
    """Withdraw the current calibration, which is of another phone; reason: how that was noticed."""

    t: float
    record: CalibrationRecord
    reason: str


@dataclass(frozen=True, slots=True)
class Diagnose:
    """Ask for a diagnosis: checks still fail after a new calibration, so the model leaves something out.

    Asked for once.
    """

    t: float
    reason: str


Action = Sense | Sleep | Log | Publish | Reject | Forget | Diagnose
