"""Every fault that the daemon must survive, counted.

`python -m stillcal.replay.trials.faults` prints the figures.

Killed while it saves (faults_kill.py) and while it lives (faults_live.py), disks that fail (faults_disk.py),
clients that mean no good and a second daemon (faults_socket.py), calibrations while others wait
(faults_fit.py), the wire (replay/trials/faults/wire.py), system calls that fail once (calls.py), and a daemon
that a phone and clients try by every means (endure.py). Each part also checks what must hold; exit code 1
where something does not.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import click

from stillcal.replay.trials.faults.calls import every_call
from stillcal.replay.trials.faults.disk import failing_disks
from stillcal.replay.trials.faults.endure import hostile_bytes, hostile_messages, leavers, tables
from stillcal.replay.trials.faults.fit import calibrating
from stillcal.replay.trials.faults.kill import killed
from stillcal.replay.trials.faults.live import killed_live
from stillcal.replay.trials.faults.socket import attacked
from stillcal.replay.trials.faults.wire import Figures, flipped_bits, pulled_out, random_bytes

T = TypeVar("T")

RANDOM_BYTES, FLIPS, TIMES, FITS = 1_000_000, 20_000, 100, 20
LEAVERS, TABLES_S = 300, 10.0


def all_faults(
    *, kills: int, lives: int, messages: int, clients: int, hostile: int, seed: int
) -> Iterator[Figures]:
    """Play every fault, one after another."""
    yield in_folder(lambda folder: killed(kills, seed, folder))
    yield in_folder(lambda folder: killed_live(lives, seed, folder))
    yield from in_folder(failing_disks)
    yield from in_folder(lambda folder: attacked(messages, clients, seed, folder))
    yield from in_folder(lambda folder: calibrating(FITS, seed, folder))
    yield random_bytes(RANDOM_BYTES, seed)
    yield flipped_bits(FLIPS, seed)
    yield pulled_out(TIMES, seed)
    yield from in_folder(lambda folder: list(every_call(folder)))
    yield in_folder(lambda folder: leavers(LEAVERS, folder))
    yield in_folder(lambda folder: tables(TABLES_S, folder))
    yield in_folder(lambda folder: hostile_bytes(RANDOM_BYTES, seed, folder))
    yield in_folder(lambda folder: hostile_messages(hostile, seed, folder))


def in_folder(play: Callable[[Path], T]) -> T:
    """Play in an empty folder of its own, with a short path: a socket's is 107 bytes at most (unix(7))."""
    with tempfile.TemporaryDirectory(prefix="stillcal-") as folder:
        return play(Path(folder))


def lines(figures: Figures) -> Iterator[str]:
    """Write one fault's figures: what it was and whether all that must hold did, then each count."""
    yield f"{figures.name:48}{'holds' if figures.holds else 'FAILS'}"
    for name, count in figures.counts.items():
        yield f"    {name.replace('_', ' '):32}{count:>12}"


@click.command()
@click.option("--kills", default=1000, show_default=True, help="How often to kill a process that saves.")
@click.option("--lives", default=100, show_default=True, help="How often to kill the whole daemon.")
@click.option("--messages", default=10_000, show_default=True, help="Malformed messages to send.")
@click.option("--clients", default=200, show_default=True, help="Clients at once, of which half stall.")
@click.option("--hostile", default=20_000, show_default=True, help="Hostile well-formed messages to send.")
@click.option("--seed", default=1, show_default=True)
def main(*, kills: int, lives: int, messages: int, clients: int, hostile: int, seed: int) -> None:
    """Count what faults come to; exit code 1 where something that must hold does not."""
    holds = True
    for figures in all_faults(
        kills=kills, lives=lives, messages=messages, clients=clients, hostile=hostile, seed=seed
    ):
        holds &= figures.holds
        click.echo("\n".join(lines(figures)))
    sys.exit(not holds)


if __name__ == "__main__":
    main()
