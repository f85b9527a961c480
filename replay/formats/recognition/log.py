"""What any recording is once it is recognised: a log that holds one sensor, or several to choose from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.columns import ColumnMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.formats.tables.table import Table

USABLE_HZ = 10.0
"""A sensor of a log that was logged less often is listed last: PX4 logs raw sensors at 1 Hz by default."""


class GyroscopeAloneError(TraceError):
    """A recording holds rates and no acceleration."""

    def __init__(self, path: Path) -> None:
        what = "holds a gyroscope and no accelerometer, without whose rests and gravity nothing is calibrated"
        super().__init__(path, what, "give the accelerometer's file, and this one as --gyro")


BOTH = (Sensor.ACCELEROMETER, Sensor.GYROSCOPE)


@dataclass(frozen=True, slots=True)
class Part:
    """One table of a log, how it is read, and the sensors that it holds."""

    table: Table
    column_map: ColumnMap
    sensors: Sequence[Sensor] = BOTH


@dataclass(frozen=True, slots=True)
class LoggedSensor:
    """One accelerometer of a log, with the gyroscope that belongs to it.

    name: by which it is chosen. about: what it is, for a list. files: opens it, given the maker's claims.
    notes: what is to be said of it, a line each, such as what the firmware has corrected already.
    """

    name: str
    files: Callable[[Claims], list[SampleFile]]
    about: str = ""
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, name: str, parts: Sequence[Part], about: str = "", notes: Sequence[str] = ()) -> LoggedSensor:
        """Return the sensor that one or two tables hold."""

        def files(claims: Claims) -> list[SampleFile]:
            return [SampleFile(p.table, p.column_map, p.sensors, claims) for p in parts]

        return cls(name, files, about, tuple(notes))


@dataclass(frozen=True, slots=True)
class Log:
    """A recording that was recognised.

    path: what messages call it. kind: the format, as it is called in messages. sensors: best first.
    beside: the path beside which events and claims lie, None where they cannot. claims: of the log itself.
    by_gravity: whether nothing but the size of gravity tells that its accelerometer is one.
    """

    path: Path
    kind: str
    sensors: list[LoggedSensor]
    notes: list[str] = field(default_factory=list)
    beside: Path | None = None
    claims: Claims = field(default_factory=Claims)
    by_gravity: bool = False

    def choose(self, name: str | None) -> tuple[LoggedSensor, list[str]]:
        """Return the sensor of that name, or the first, and what is to be said of the choice.

        Raises TraceError, listing what there is, where no sensor has the name.
        """
        there = ", ".join(f"{s.name} ({s.about})" if s.about else s.name for s in self.sensors)
        if name is None:
            first = self.sensors[0]
            several = (
                f"{short_name(self.path)}: has {len(self.sensors)} sensors: {there}; reading {first.name}"
            )
            return first, [f"{several} (--sensor chooses another)"] if len(self.sensors) > 1 else []
        for sensor in self.sensors:
            if sensor.name == name:
                return sensor, []
        raise TraceError(self.path, f"no sensor {name!r}", f"choose one of: {there}")
