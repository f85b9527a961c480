"""`stillcal record`: a recording of what a running daemon's phone sends, for `stillcal diagnose`."""

from __future__ import annotations

import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from stillcal.daemon.cli.exits import BAD_INPUT, NO_DAEMON, REFUSED, TOO_LITTLE
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import FiniteRange, quiet_option, socket_option
from stillcal.daemon.cli.query import NoDaemonError, replies
from stillcal.daemon.system.files import RESERVE_BYTES
from stillcal.daemon.varlink.address import NAME, answering_path
from stillcal.replay.commands.outputs import new_recording_files, refuse_collisions
from stillcal.replay.formats.conversion.live_recording import LiveRecording, Parts

CHECK_EVERY = 50
"""Blocks of samples between two looks at the disk: some five seconds of a phone in real time."""


@click.command(
    "record",
    short_help="Record what a running daemon's phone sends.",
    epilog=examples(
        "stillcal record day.csv.gz                 # until Ctrl-C",
        "stillcal record day.csv.gz --hours 24",
        "stillcal record week.csv.gz --rotate 6 --keep 28",
        "stillcal diagnose day.csv.gz",
    ),
)
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--hours", type=FiniteRange(0, 1_000_000, min_open=True), help="Stop after so many hours.")
@click.option(
    "--rotate",
    type=FiniteRange(0.01, 1000),
    default=24.0,
    show_default=True,
    help="Begin another file after so many hours: NAME.2.csv, NAME.3.csv, ...",
)
@click.option(
    "--keep",
    type=click.IntRange(1, 10_000),
    default=7,
    show_default=True,
    help="Files kept; the oldest is deleted when there are more.",
)
@click.option(
    "--sparing", is_flag=True, help="Record only what the daemon measures for itself, to spare the battery."
)
@socket_option
@quiet_option
def record_command(  # noqa: PLR0917 - click hands every option over by name
    out: Path, hours: float | None, rotate: float, keep: int, sparing: bool, path: str, quiet: bool
) -> None:
    """Record the raw samples and events of the phone that a running daemon serves, as stillcal's CSV.

    OUT is NAME.csv or NAME.csv.gz. The phone's sensors stay on meanwhile. Ctrl-C ends the recording and
    leaves a whole file. It also ends, whole, before the disk is full and when the daemon stops. What a kill
    or a power cut leaves is in .NAME.csv.gz.PID.part, for zcat. Exit codes: 1 the daemon refuses (only root
    and its own user may record), 3 no sample came, 4 no daemon, or it stopped.
    """
    _refuse_existing(out)
    where, stop = answering_path(path), _Stop(hours)
    recording = LiveRecording(Parts(out, keep), rotate * 3600.0)
    question = {"method": f"{NAME}.Record", "parameters": {"sparing": sparing}, "more": True}
    try:
        ended, code = _record(recording, out, stop.until_asked(replies(where, question)))
    except NoDaemonError as error:
        ended, code = str(error), NO_DAEMON
    except BaseException:
        recording.discard()
        raise
    if not ended and not stop.asked:
        ended, code = "the daemon has stopped: the recording ends here", NO_DAEMON
    written = recording.close()
    if not written and not code:
        ended, code = "no sample came: see `stillcal watch` for the phone", TOO_LITTLE
    if not quiet:
        for part in written:
            click.echo(part.words())
    if ended:
        click.echo(f"stillcal: {ended}", err=True)
    sys.exit(code)


def _record(recording: LiveRecording, out: Path, messages: Iterator[dict[str, Any]]) -> tuple[str, int]:
    """Record until the messages end; return why it ended early and the exit code, or nothing and 0."""
    for number, reply in enumerate(messages):
        if "error" in reply:
            return _refusal(reply), REFUSED
        recording.take((reply.get("parameters") or {}).get("block") or {})
        low = number % CHECK_EVERY == 0 and shutil.disk_usage(out.absolute().parent).free < RESERVE_BYTES
        if low or recording.filled:
            return f"{out}: less than {RESERVE_BYTES // 2**20} MiB are left on the disk: make room", BAD_INPUT
    return "", 0


class _Stop:
    """Ends a recording between two replies: on SIGINT, SIGTERM and SIGHUP, and after `hours`.

    asked: whether one of them has.
    """

    def __init__(self, hours: float | None) -> None:
        self._waiting = self.asked = False
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
            signal.signal(number, self._ask)
        signal.setitimer(signal.ITIMER_REAL, 0.0 if hours is None else hours * 3600.0)

    def until_asked(self, messages: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        """Yield messages until a signal came; while a message is worked on, a signal waits for its end."""
        while not self.asked:
            self._waiting = True
            try:
                message = next(messages, None)
            except KeyboardInterrupt:
                return
            finally:
                self._waiting = False
            if message is None:
                return
            yield message

    def _ask(self, *_: object) -> None:
        self.asked = True
        if self._waiting:
            raise KeyboardInterrupt


def _refuse_existing(out: Path) -> None:
    """Raise UsageError where a file of the new recording is there already, or cannot be written."""
    if not out.name.endswith((".csv", ".csv.gz")):
        raise click.UsageError(f"{out}: choose a name that ends in .csv or .csv.gz for a live recording")
    files = new_recording_files(out)
    refuse_collisions(files, [])
    for path in files:
        if path.exists():
            raise click.UsageError(f"{path} exists already; choose another name")


def _refusal(reply: dict[str, Any]) -> str:
    name = str(reply["error"]).rpartition(".")[2]
    if name == "PermissionDenied":
        return "only root and the daemon's own user may record: call it as one of them"
    if name == "TooSlow":
        return "this computer or its disk was too slow for the phone's samples: the recording ends here"
    return f"the daemon refuses: {name}"
