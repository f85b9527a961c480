"""`stillcal store export` and `stillcal store import`: a calibration in another tool's own file, and back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from stillcal.calib_core.errors import UserError
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.store.files import existing
from stillcal.daemon.store.store import Store
from stillcal.daemon.system.files import is_read_once, read_input, short_name
from stillcal.replay.commands.outputs import (
    called,
    files,
    refuse_collisions,
    say,
    settings_files,
    store_files,
    write_output,
)
from stillcal.replay.export.imu import of_record
from stillcal.replay.export.stored import not_in_file, record_of
from stillcal.replay.export.target import MAX_BYTES, exported
from stillcal.replay.export.targets import INVERTIBLE, TARGETS, target_named
from stillcal.replay.outcome import current_in_store
from stillcal.replay.phone.phone import Phone, load_phone

_path = click.Path(path_type=Path)


@click.command(
    "export",
    short_help="Write the calibration as another tool's own file.",
    epilog=examples(
        "stillcal store export store.json --to px4 --out imu.params",
        "stillcal store export store.json --to kalibr --phone phone.toml --out imu.yaml",
        "stillcal store export store.json --to airsim --phone phone.toml --out settings.json",
        "stillcal store export store.json --to numpy --out correct.py",
    ),
)
@click.argument("path", type=_path)
@click.option("--to", "tool", type=click.Choice(list(TARGETS)), required=True, help="The tool.")
@click.option("--out", type=_path, required=True, help="The file to write ('-': standard output).")
@click.option(
    "--phone",
    help="Where noise comes from: a phone file that diagnose --phone-out wrote. airsim and ros2 hold nothing"
    " but noise and need it.",
)
def export_command(path: Path, tool: str, out: Path, phone: str | None) -> None:
    """Write the current calibration of the store PATH ('-': standard input) as another tool's own file.

    What the tool cannot hold is named on standard error and in the file's comments, with its numbers.
    docs/export.md says what each tool holds and in which units, signs and axes.
    """
    reads = [*store_files(path), *([] if phone is None else settings_files(phone))]
    refuse_collisions([out], reads)
    target = target_named(tool)
    known = None if phone is None else _phone(phone)
    store = path if is_read_once(path) else existing(path)
    made = exported(target, of_record(current_in_store(store), known), short_name(path))
    write_output(out, made.data)
    if made.left_out:
        names = ", ".join(made.left_out)
        click.echo(
            f"stillcal: {called(out)}: {target.title} cannot hold: {names} (see its comments)", err=True
        )
    for line in made.notes:
        click.echo(f"stillcal: {called(out)}: {line}", err=True)
    say(out, f"written for {target.title}")


@click.command(
    "import",
    short_help="Take a calibration from another tool's own file.",
    epilog=examples("stillcal store import store.json --from px4 --in imu.params"),
)
@click.argument("path", type=_path)
@click.option("--from", "tool", type=click.Choice(INVERTIBLE), required=True, help="The tool.")
@click.option("--in", "source", type=_path, required=True, help="The tool's file ('-': standard input).")
def import_command(path: Path, tool: str, source: Path) -> None:
    """Make the calibration in another tool's file the current one of the store PATH, new or existing.

    What the file does not hold stays as the store has it; the calibration before stays in the history.
    """
    refuse_collisions(store_files(path), files(source))
    target = target_named(tool)
    with _naming(source):
        parameters = target.read(read_input(source, MAX_BYTES))
    with Store(path) as store:
        document = store.load()
        before = None if document is None else document.current
        with _naming(source):
            record = record_of(parameters, before, f"{short_name(source)} ({target.title})")
        store.publish(record, record.acceptance.reason)
    for line in not_in_file(parameters, before):
        click.echo(f"stillcal: {short_name(source)}: holds no {line}", err=True)
    click.echo(f"{path}: calibration {record.id} is current, from {short_name(source)}")


@contextmanager
def _naming(source: Path) -> Iterator[None]:
    """Name the file in what is refused of its contents."""
    try:
        yield
    except ValueError as error:
        raise UserError(f"{short_name(source)}: {error}") from error


def _phone(name: str) -> Phone:
    try:
        return load_phone(name)
    except ValueError as error:
        raise UserError(str(error)) from error
