"""`stillcal faces`: have a running daemon's phone laid on its six faces, and say which one comes next."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path
from typing import Any

import click

from stillcal.daemon.cli.exits import NO_DAEMON, TOO_LITTLE
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import socket_option
from stillcal.daemon.cli.query import NoDaemonError, exit_with_error, replies
from stillcal.daemon.cli.watch.sentences import laying_faces
from stillcal.daemon.varlink.address import NAME, answering_path

EVERY_S = 0.5
"""Time between two questions, s."""

HOW = """\
Lay the phone on each of its six faces, flat on a level surface, in any order. Leave it there until the next
line comes, some ten seconds. Ctrl-C stops."""

WAITING = "the daemon does not answer: waiting for it; what was laid stays"

LOST = "the daemon has lost how far it was: call `stillcal faces` again"


@click.command(
    "faces",
    short_help="Calibrate from six known faces, told one by one.",
    epilog=examples("stillcal faces", "stillcal watch    # in another terminal, shows the same"),
)
@socket_option
def faces_command(path: str) -> None:
    """Guide a person who lays the phone of a running daemon on each of its six faces, then calibrate.

    Only known faces fix the rotation common to all axes; later calibrations keep it. The phone's sensors stay
    on meanwhile. A daemon that restarts goes on where it was; half an hour without a further face ends it.
    Exit codes: 1 refused (only root and the daemon's own user may do this), 3 ended before the sixth face, 4
    no daemon.
    """
    where = answering_path(path)
    try:
        laid = _guided(where)
    except KeyboardInterrupt:
        with contextlib.suppress(NoDaemonError):
            _asked(where, "LayFaces", stop=True)
        raise
    except NoDaemonError as error:
        click.echo(f"stillcal: {error}", err=True)
        sys.exit(NO_DAEMON)
    if laid["stage"] != "calibrated":
        click.echo(f"stillcal: {laid['note'] if laid['stage'] != 'none' else LOST}", err=True)
        sys.exit(TOO_LITTLE)
    click.echo(f"calibrated: {laid['note']}")


def _guided(where: Path) -> dict[str, Any]:
    """Print how far it is whenever that changes, until it ends; return the daemon's last answer."""
    laid, printed = _asked(where, "LayFaces"), ""
    click.echo(HOW)
    line = laying_faces(laid)
    while laid["stage"] == "laying":
        if line != printed:
            click.echo(line)
        printed = line
        time.sleep(EVERY_S)
        try:
            laid = _asked(where, "GetFaces")
            line = laying_faces(laid) if laid["stage"] == "laying" else printed
        except NoDaemonError:
            line = WAITING
    return laid


def _asked(where: Path, method: str, **parameters: bool) -> dict[str, Any]:
    question = {"method": f"{NAME}.{method}", "parameters": parameters}
    (reply,) = replies(where, question)
    if "error" in reply:
        exit_with_error(str(reply["error"]), reply.get("parameters") or {}, where, question)
    return dict((reply.get("parameters") or {})["faces"])
