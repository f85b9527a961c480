"""The options by which every command reads a recording: format, sensor, gyroscope's file and part."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import click

from stillcal.daemon.cli.options import FiniteRange
from stillcal.daemon.system.files import is_read_once
from stillcal.replay.commands.outputs import settings_files
from stillcal.replay.formats.columns import ColumnMap, load_map
from stillcal.replay.formats.daemon_state import is_daemon_state, kept_rests
from stillcal.replay.formats.recognition.opened import is_rest_table, kept
from stillcal.replay.formats.rest_table import RestTable, open_rest_table
from stillcal.replay.formats.sources import Source
from stillcal.replay.formats.trace import Trace, open_trace

Command = TypeVar("Command", bound=Callable[..., Any])

READING = ("format", "sensor", "gyro", "from", "to")
"""The options of `reading_options`, without dashes and prefix."""


@dataclass(frozen=True)
class Reading:
    """How a recording is read, and what it gave if it is a pipe, which can be read only once.

    format: None where its content decides; start, stop: s after its start.
    """

    format: str | None = None
    gyro: Path | None = None
    sensor: str | None = None
    start: float | None = None
    stop: float | None = None
    _kept: dict[Path, Path | Source] = field(default_factory=dict, init=False, compare=False, repr=False)

    @property
    def files(self) -> list[Path]:
        """The files that are read besides the recording: the gyroscope's own, and a column map."""
        gyro = [] if self.gyro is None else [self.gyro]
        return gyro if self.format is None else [*gyro, *settings_files(self.format)]

    def kept(self, trace: Path) -> Path | Source:
        """Return what `formats.recognition.opened.kept` does, and for the same path the same bytes again."""
        if trace not in self._kept:
            self._kept[trace] = kept(trace)
        return self._kept[trace]

    def open(self, trace: Path) -> Trace:
        """Open a recording of samples. Raises TraceError."""
        return open_trace(
            self.kept(trace), self._map, self.gyro, sensor=self.sensor, start=self.start, stop=self.stop
        )

    @cached_property
    def _map(self) -> str | ColumnMap | None:
        """The format, or the column map that a pipe gave in its place."""
        return load_map(self.format) if self.format is not None and is_read_once(self.format) else self.format

    def is_rest_table(self, trace: Path) -> bool:
        """Whether the file is a rest table, or holds rests as a daemon's state does. Raises TraceError."""
        return is_daemon_state(trace) or is_rest_table(self.kept(trace), self.format)

    def rest_table(self, trace: Path) -> RestTable:
        """Read a rest table, or the rests of a daemon's state. Raises TraceError."""
        if any(given is not None for given in (self.sensor, self.start, self.stop, self.gyro)):
            raise click.UsageError(
                "--sensor, --gyro, --from and --to are for samples, which a rest table has not"
            )
        if is_daemon_state(trace):
            return RestTable(kept_rests(trace), [])
        return open_rest_table(self.kept(trace))


def show_notes(notes: Iterable[str], quiet: bool) -> None:
    """Print on standard error what was recognised, assumed or tolerated while reading, a line each."""
    for note in () if quiet else notes:
        click.echo(f"stillcal: {note}", err=True)


def reading_options(what: str = "TRACE", prefix: str = "") -> Callable[[Command], Command]:
    """Return a decorator that gives a command the options of reading `what`, as one argument `reading`.

    prefix: with "simulated" they are --simulated-format and so on, and the argument is `simulated_reading`.
    """
    dash, under = (f"{prefix}-", f"{prefix}_") if prefix else ("", "")
    ours = f" [{what}]" if prefix else ""
    options = (
        click.option(
            f"--{dash}format",
            f"{under}format_",
            help=f"Format of {what} (docs/formats.md), or a column map (.toml; '-': standard input)"
            " [default: by its content].",
        ),
        click.option(
            f"--{dash}sensor",
            f"{under}sensor",
            help=f"Which sensor of a log that has several; a wrong name lists them.{ours}",
        ),
        click.option(
            f"--{dash}gyro",
            f"{under}gyro",
            type=click.Path(path_type=Path),
            help=f"The gyroscope's file, where the format has a file for each sensor.{ours}",
        ),
        click.option(
            f"--{dash}from",
            f"{under}start",
            type=FiniteRange(0),
            help=f"Leave out what is earlier, s after the start.{ours}",
        ),
        click.option(
            f"--{dash}to",
            f"{under}stop",
            type=FiniteRange(0),
            help=f"Leave out what is later, s after the start.{ours}",
        ),
    )
    names = [f"{under}{name}" for name in ("format_", "gyro", "sensor", "start", "stop")]

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def called(**given: Any) -> Any:
            reading = Reading(*(given.pop(name) for name in names))
            start, stop = reading.start, reading.stop
            if start is not None and stop is not None and stop <= start:
                raise click.UsageError(f"--{dash}to {stop:g} is not after --{dash}from {start:g}")
            return command(**{f"{under}reading": reading}, **given)

        decorated: Any = called
        for option in reversed(options):
            decorated = option(decorated)
        return decorated  # type: ignore[no-any-return]

    return decorate
