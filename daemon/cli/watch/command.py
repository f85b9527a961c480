"""`stillcal watch`: show a running daemon live in a terminal."""

from __future__ import annotations

import io
import re
import signal
import sys
import time
from pathlib import Path

import click
from rich.console import Console
from rich.live import Live

from stillcal.daemon.cli.exits import NO_DAEMON
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import FiniteRange, socket_option
from stillcal.daemon.cli.watch.frame import frame
from stillcal.daemon.cli.watch.snapshot import Snapshot, snapshot
from stillcal.daemon.cli.watch.sphere import ASCII, Glyphs
from stillcal.daemon.store.atomic import write_atomically
from stillcal.daemon.varlink.address import answering_path

PICTURE_WIDTH = 122
"""Columns of a picture: both columns of the frame and the space between them."""


@click.command(
    "watch",
    short_help="Show a running daemon live in the terminal.",
    epilog=examples("stillcal watch", "stillcal watch --every 5", "stillcal watch --once > frame.txt"),
)
@socket_option
@click.option("--once", is_flag=True, help="Print one frame and exit, as without a terminal.")
@click.option("--svg", type=click.Path(path_type=Path), help="Write one frame as a picture to this file.")
@click.option(
    "--every",
    default=1.0,
    show_default=True,
    type=FiniteRange(0.1, 3600),
    help="Seconds between two frames.",
)
def watch_command(path: str, once: bool, svg: Path | None, every: float) -> None:
    """Show a running daemon: the phone, the calibration, the energy used, the orientations recorded.

    Also shows what the daemon needs next and which orientation to record next. Reconnects when the daemon
    restarts. Ctrl-C quits. Best in a terminal of 120 columns or more. Exit code 4 with --once when no daemon
    answers.
    """
    console, where = Console(), answering_path(path)
    glyphs = ASCII if console.options.ascii_only else Glyphs()
    first = snapshot(where)
    if once or svg is not None or not console.is_terminal:
        if first.absent:
            click.echo(f"stillcal: {first.absent}", err=True)
            sys.exit(NO_DAEMON)
        if svg is not None:
            write_atomically(svg, picture(first).encode(), 0o644)
        else:
            console.print(frame(first, None, glyphs, console.width))
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # restores the screen as Ctrl-C does
    try:
        _live(console, where, first, glyphs, every)
    except KeyboardInterrupt:
        return


def picture(now: Snapshot) -> str:
    """Return a frame as SVG, without the fonts that rich would load from the web."""
    console = Console(record=True, width=PICTURE_WIDTH, file=io.StringIO())
    console.print(frame(now, None, Glyphs(), PICTURE_WIDTH))
    svg = console.export_svg(title="stillcal watch", unique_id="watch")
    svg = re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL)
    return "\n".join(line.rstrip() for line in svg.splitlines()) + "\n"


def _live(console: Console, where: Path, now: Snapshot, glyphs: Glyphs, every: float) -> None:
    """Show frame after frame on the terminal's alternate screen until interrupted."""
    with Live(
        frame(now, None, glyphs, console.width), console=console, screen=True, auto_refresh=False
    ) as live:
        live.refresh()
        while True:
            time.sleep(every)
            now, before = snapshot(where), now
            live.update(frame(now, before, glyphs, console.width), refresh=True)
