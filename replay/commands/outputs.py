"""Where a command may write: never over its inputs and never two outputs into one file.

Checked before any work is done, so that a refusal leaves nothing behind.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path

import click

from stillcal.daemon.store.atomic import led_to, write_atomically
from stillcal.daemon.system.files import naming
from stillcal.replay.formats.claims import beside, written_by_stillcal
from stillcal.replay.formats.conversion.by_name import ENDINGS
from stillcal.replay.formats.writer import STANDARD_OUTPUT


def write_output(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, or into a device or a pipe; "-" is standard output."""
    if path == STANDARD_OUTPUT:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()
    elif _is_written_into(path):
        with naming(path), path.open("wb") as device:
            device.write(data)
    else:
        write_atomically(path, data)


def _is_written_into(path: Path) -> bool:
    """Whether a path is a device or a pipe (/dev/null), or a link of the system (/dev/stdout)."""
    system = path.absolute().is_relative_to("/dev") or path.absolute().is_relative_to("/proc")
    return path.exists() and (system or not path.is_file())


def say(out: Path, text: str) -> None:
    """Print a line about the output `out`: on standard error where that is standard output itself."""
    click.echo(f"{called(out)}: {text}", err=out == STANDARD_OUTPUT)


def called(out: Path) -> str:
    """Return what messages call the output `out`."""
    return "standard output" if out == STANDARD_OUTPUT else str(out)


def files(*paths: Path | None) -> list[Path]:
    """Return the paths that were given: "-" is standard output."""
    return [path for path in paths if path is not None]


def recording_files(path: Path) -> list[Path]:
    """Return a recording's own files: its samples, its events, and its claims unless a command wrote them."""
    claims = beside(path, ".json")
    return [path, beside(path, ".events.jsonl"), *([] if written_by_stillcal(claims) else [claims])]


def new_recording_files(path: Path) -> list[Path]:
    """Return the files that a new recording consists of. Raises UsageError for another ending of the name.

    On standard output ("-") it is the CSV alone.
    """
    if path == STANDARD_OUTPUT:
        return [path]
    if not path.name.endswith(ENDINGS):
        raise click.UsageError(
            f"{path}: choose a name that ends in .csv, .csv.gz or .parquet for a recording"
        )
    return [path, beside(path, ".events.jsonl"), beside(path, ".json")]


def store_files(path: Path) -> list[Path]:
    """Return the files of a store: itself, its last good copy and its lock."""
    return [path, *(path.with_name(path.name + suffix) for suffix in (".last-good", ".lock"))]


def settings_files(name: str) -> list[Path]:
    """Return the file that a scenario or a phone is read from, none where it is a ready one's name."""
    path = Path(name)
    return [path] if path == STANDARD_OUTPUT or path.suffix == ".toml" else []


def refuse_collisions(writes: Iterable[Path], reads: Iterable[Path]) -> None:
    """Raise UsageError where a file would be written over an input, or twice, or cannot be written at all.

    Also where two inputs are "-".
    """
    writes, reads = list(writes), list(reads)
    if reads.count(STANDARD_OUTPUT) > 1:
        raise click.UsageError("standard input ('-') can be one file only; give the others by their names")
    if writes.count(STANDARD_OUTPUT) > 1:
        raise click.UsageError("standard output ('-') can take one file only; give the others a name")
    inputs, outputs = {p.resolve() for p in reads if p.exists()}, set[Path]()
    for path in writes:
        if path == STANDARD_OUTPUT:
            continue
        if led_to(path).is_symlink():
            raise click.UsageError(f"{path} cannot be written: it is a link that leads back to itself")
        if path.resolve() in inputs:
            raise click.UsageError(f"{path} is read by this command; choose another file to write")
        if path.resolve() in outputs:
            raise click.UsageError(f"{path} would be written twice; choose two names")
        folder = led_to(path).parent
        if not (folder.is_dir() and os.access(folder, os.W_OK)):
            raise click.UsageError(f"{path} cannot be written: {folder} is not a writable folder")
        if path.is_dir():
            raise click.UsageError(f"{path} cannot be written: it is a folder; give a file's name")
        outputs.add(path.resolve())
