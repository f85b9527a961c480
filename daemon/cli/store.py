"""`stillcal store …`: look at a calibration store, check it, and go back to an earlier calibration.

The commands live here; what they print is cli_store_tables.py's, what a store is and does is store.py's.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from stillcal.calib_core.calibration.terms import with_terms
from stillcal.daemon.cli.exits import BAD_INPUT, DAMAGED
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.store_tables import (
    history_rows,
    print_calibration,
    print_history,
    reading_json,
    verdict,
)
from stillcal.daemon.store.document import StoreDocument, calibration_json
from stillcal.daemon.store.store import Store

path_argument = click.argument("path", type=click.Path(path_type=Path))
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")


@click.group("store", short_help="Look at a store, check it, go back to earlier ones.")
def store_group() -> None:
    """Look at a calibration store, check it, or go back to an earlier calibration.

    PATH is the store's JSON file, such as /var/lib/stillcal/store.json. Looking and checking are safe
    while the daemon runs; rolling back needs it stopped.
    """


@store_group.command(
    "show",
    epilog=examples(
        "stillcal store show store.json",
        "stillcal store show store.json --json | jq .accelerometer.bias",
    ),
)
@path_argument
@json_option
def show(path: Path, as_json: bool) -> None:
    """Show the current calibration."""
    document = _loaded(path)
    if as_json:
        _print_json(calibration_json(document.current))
    elif document.current is None:
        click.echo("no calibration yet")
    else:
        print_calibration(document.current)


@store_group.command(
    "history",
    short_help="List current, earlier and rejected calibrations.",
    epilog=examples(
        "stillcal store history store.json",
        "stillcal store history store.json --json",
    ),
)
@path_argument
@json_option
def history(path: Path, as_json: bool) -> None:
    """List the current, the earlier and the rejected calibrations, newest first."""
    document = _loaded(path)
    rows = list(history_rows(document))
    if as_json:
        _print_json(rows)
        return
    print_history(str(path), rows)


@store_group.command(
    "rollback",
    short_help="Make an earlier calibration current again.",
    epilog=examples(
        "stillcal store rollback store.json              to the one before",
        "stillcal store rollback store.json --steps 2    to the one before that",
        "stillcal store rollback store.json --to 900d0f  to the one of this id",
    ),
)
@path_argument
@click.option("--to", "identity", metavar="ID", help="The calibration's id, or the beginning of it.")
@click.option("--steps", type=click.IntRange(1), default=1, show_default=True, help="How far back.")
def rollback(path: Path, identity: str | None, steps: int) -> None:
    """Make an earlier calibration current again; the present one stays in the history."""
    with _one_line(), Store(_existing(path)) as store:
        outcome = store.rollback(identity or steps)
    for note in outcome.notes:
        click.echo(note, err=True)
    if outcome.document.current is not None:
        click.echo(f"{path}: calibration {outcome.document.current.id} is current again")


@store_group.command(
    "adopt-terms",
    short_help="Take what a diagnosis found into the calibration.",
    epilog=examples(
        "stillcal diagnose day.csv --json day.diagnosis.json",
        "stillcal store adopt-terms store.json day.diagnosis.json",
    ),
)
@path_argument
@click.argument("diagnosis", type=click.Path(path_type=Path))
def adopt_terms(path: Path, diagnosis: Path) -> None:
    """Take what a diagnosis has found into the current calibration; `stillcal apply` then corrects for it.

    Bias against temperature and a gyroscope's answer to force can be taken; DIAGNOSIS is what `stillcal
    diagnose --json` wrote. The calibration without them stays in the history.
    """
    with _one_line(), Store(_existing(path)) as store:
        document = store.load()
        if document is None or document.current is None:
            raise ValueError(f"{path}: holds no calibration: run stillcal replay or the daemon first")
        try:
            record = with_terms(document.current, _findings(diagnosis))
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{diagnosis}: {error}") from error
        store.publish(record, f"terms from {diagnosis.name}")
    click.echo(f"{path}: calibration {record.id} with {', '.join(term.effect for term in record.terms)}")


def _findings(path: Path) -> list[dict[str, Any]]:
    """Read a diagnosis. Raises ValueError where it is none."""
    try:
        findings = json.loads(path.read_text(encoding="utf-8"))["findings"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError("not a diagnosis: write one with stillcal diagnose --json") from error
    return [dict(finding) for finding in findings]


@store_group.command(
    "verify",
    short_help="Check that a store is whole; exit 1 where it is not.",
    epilog=examples(
        "stillcal store verify store.json",
        "stillcal store verify store.json --json",
    ),
)
@path_argument
@json_option
def verify(path: Path, as_json: bool) -> None:
    """Check that a store is whole: JSON, checksum, schema, units and values; exit 1 where it is not."""
    with _one_line():
        found = Store(_existing(path)).verify()
    report = {
        "whole": found.whole,
        "store": reading_json(found.store),
        "last_good": reading_json(found.last_good),
    }
    if as_json:
        _print_json(report)
    else:
        for reading in (found.store, found.last_good):
            click.echo(f"{reading.path}: {verdict(reading)}")
    sys.exit(0 if found.whole else DAMAGED)


@contextmanager
def _one_line() -> Iterator[None]:
    """Turn a refusal into one line on standard error and exit status 2."""
    try:
        yield
    except ValueError as error:
        click.echo(f"stillcal: {error}", err=True)
        sys.exit(BAD_INPUT)


def _existing(path: Path) -> Path:
    if not path.exists():
        raise ValueError(f"{path}: there is no store: give the path of an existing one")
    return path


def _loaded(path: Path) -> StoreDocument:
    """Read a store, warning on standard error where only its last good copy could be used."""
    with _one_line():
        store = Store(_existing(path))
        problem = store.verify().store.problem
        document = store.load()
    if problem is not None:
        click.echo(f"stillcal: {path} is {problem}; showing {store.last_good_path}", err=True)
    return document or StoreDocument()


def _print_json(value: Any) -> None:
    click.echo(json.dumps(value, indent=2, allow_nan=False))
