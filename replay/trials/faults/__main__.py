"""Every fault that the daemon must survive, counted.

`python -m stillcal.replay.trials.faults` prints the figures.

Killed while it saves (kill.py) and while it lives (live.py), disks that fail (disk.py), clients that mean no
good and a second daemon (socket.py), calibrations while others wait (fit.py), the wire (wire.py), system
calls that fail once (calls.py), parts that hang (hangs.py), and a daemon that a phone and clients try by
every means (endure.py). Each part also checks what must hold; exit code 1 where something does not.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import click

from stillcal.replay.trials.faults.calls import every_call
from stillcal.replay.trials.faults.disk import failing_disks
from stillcal.replay.trials.faults.endure import hostile_bytes, hostile_messages, leavers, tables
from stillcal.replay.trials.faults.fit import calibrating
from stillcal.replay.trials.faults.hangs import hangs
from stillcal.replay.trials.faults.kill import killed
from stillcal.replay.trials.faults.live import killed_live
from stillcal.replay.trials.faults.socket import attacked
from stillcal.replay.trials.faults.wire import Figures, flipped_bits, pulled_out, random_bytes

T = TypeVar("T")

RANDOM_BYTES, FLIPS, TIMES, FITS = 1_000_000, 20_000, 100, 20
LEAVERS, TABLES_S = 300, 10.0


@dataclass(frozen=True, slots=True)
class Amounts:
    """How much of each fault; the options of the command."""

    kills: int
    lives: int
    messages: int
    clients: int
    hostile: int
    seed: int


Part = Callable[[Amounts, Path], Iterable[Figures]]

PARTS: dict[str, Part] = {
    "kills": lambda n, folder: [killed(n.kills, n.seed, folder)],
    "lives": lambda n, folder: [killed_live(n.lives, n.seed, folder)],
    "disks": lambda n, folder: failing_disks(folder),
    "clients": lambda n, folder: attacked(n.messages, n.clients, n.seed, folder),
    "calibrations": lambda n, folder: calibrating(FITS, n.seed, folder),
    "wire": lambda n, folder: [
        random_bytes(RANDOM_BYTES, n.seed),
        flipped_bits(FLIPS, n.seed),
        pulled_out(TIMES, n.seed),
    ],
    "calls": lambda n, folder: every_call(folder),
    "hangs": lambda n, folder: hangs(folder),
    "leavers": lambda n, folder: [leavers(LEAVERS, folder)],
    "tables": lambda n, folder: [tables(TABLES_S, folder)],
    "bytes": lambda n, folder: [hostile_bytes(RANDOM_BYTES, n.seed, folder)],
    "hostile": lambda n, folder: [hostile_messages(n.hostile, n.seed, folder)],
}
"""What is played, in an empty folder of its own, and what each part yields."""


def in_folder(play: Callable[[Path], T]) -> T:
    """Play in an empty folder of its own, with a short path: a socket's is 107 bytes at most (unix(7))."""
    with tempfile.TemporaryDirectory(prefix="stillcal-") as folder:
        return play(Path(folder))


def played(part: Part, amounts: Amounts) -> list[Figures]:
    """Play a part in a folder of its own."""
    return in_folder(lambda folder: list(part(amounts, folder)))


def lines(figures: Figures) -> Iterator[str]:
    """Write one fault's figures: what it was and whether all that must hold did, then each count."""
    yield f"{figures.name:48}{'holds' if figures.holds else 'FAILS'}"
    for name, count in figures.counts.items():
        yield f"    {name.replace('_', ' '):32}{count:>12}"


def _load() -> str:
    return "load " + " ".join(f"{load:.1f}" for load in os.getloadavg())


@click.command()
@click.option("--part", "chosen", type=click.Choice(list(PARTS)), multiple=True, help="Only these parts.")
@click.option("--kills", default=1000, show_default=True, help="How often to kill a process that saves.")
@click.option("--lives", default=100, show_default=True, help="How often to kill the whole daemon.")
@click.option("--messages", default=10_000, show_default=True, help="Malformed messages to send.")
@click.option("--clients", default=200, show_default=True, help="Clients at once, of which half stall.")
@click.option("--hostile", default=20_000, show_default=True, help="Hostile well-formed messages to send.")
@click.option("--seed", default=1, show_default=True)
def main(*, chosen: tuple[str, ...], **amounts: int) -> None:
    """Count what faults come to; exit code 1 where something that must hold does not."""
    failed: list[str] = []
    began = time.monotonic()
    for number, name in enumerate(chosen or PARTS, 1):
        click.echo(f"--- {number} of {len(chosen or PARTS)}: {name}, {_load()}")
        since = time.monotonic()
        for figures in played(PARTS[name], Amounts(**amounts)):
            click.echo("\n".join(lines(figures)))
            failed += [] if figures.holds else [figures.name]
        click.echo(f"    took {time.monotonic() - since:.0f} s")
    verdict = f"does not hold: {'; '.join(failed)}" if failed else "all hold"
    click.echo(f"--- {verdict}; {time.monotonic() - began:.0f} s, {_load()}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
