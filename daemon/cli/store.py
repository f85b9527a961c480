"""`stillcal store …`: show a calibration store, check it, and go back to an earlier calibration.

The commands and what they print are here; the package daemon/store defines a store.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.adoption import adopt, beginning_of
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.corrections.term import Term, lag_of
from stillcal.calib_core.calibration.record import CalibrationRecord, SensorRecord
from stillcal.calib_core.streams.beginning import Beginning
from stillcal.daemon.cli.exits import BAD_INPUT, DAMAGED
from stillcal.daemon.cli.lazy import OpenGroup, examples
from stillcal.daemon.store.document import (
    HistoryEntry,
    StoreDocument,
    StoreFormatError,
    calibration_json,
    differences,
    parse,
)
from stillcal.daemon.store.files import MAX_BYTES, Reading, existing, piped, read_piped
from stillcal.daemon.store.store import Store
from stillcal.daemon.system.files import input_name, is_read_once, read_input, read_regular, short_name
from stillcal.daemon.system.printable import printable

MOST_CHANGES = 40
"""Differences that are shown one by one."""

path_argument = click.argument("path", type=click.Path(path_type=Path))
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")


@click.group(
    "store",
    cls=OpenGroup,
    more="stillcal.store",
    short_help="Show, check, roll back, export or import a calibration store.",
)
def store_group() -> None:
    """Show a calibration store, check it, or go back to an earlier calibration.

    PATH is the store's JSON file, such as /var/lib/stillcal/store.json; show, history, verify and export
    also take '-', standard input, and a pipe. Showing and checking are safe while the daemon runs. Changing
    needs it stopped; `stillcal query Rollback` rolls back while it runs.
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
    """List the current, earlier and rejected calibrations, newest first."""
    document = _loaded(path)
    rows = list(history_rows(document))
    if as_json:
        _print_json(rows)
        return
    print_history(input_name(path), rows)


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
@click.option("--to", "identity", metavar="ID", help="The calibration's id, or its first characters.")
@click.option(
    "--steps", type=click.IntRange(1), default=1, show_default=True, help="How many calibrations back."
)
def rollback(path: Path, identity: str | None, steps: int) -> None:
    """Make an earlier calibration current again; the present one moves to the history."""
    with _one_line(), Store(existing(path)) as store:
        outcome = store.rollback(steps if identity is None else identity)
    for note in outcome.notes:
        click.echo(note, err=True)
    if outcome.document.current is not None:
        click.echo(f"{path}: calibration {outcome.document.current.id} is current again")


@store_group.command(
    "adopt-terms",
    short_help="Add corrections that a diagnosis found to the calibration.",
    epilog=examples(
        "stillcal diagnose day.csv --json day.diagnosis.json",
        "stillcal store adopt-terms store.json day.diagnosis.json",
    ),
)
@path_argument
@click.argument("diagnosis", type=click.Path(path_type=Path))
def adopt_terms(path: Path, diagnosis: Path) -> None:
    """Add corrections that a diagnosis found to the current calibration; `stillcal apply` then uses them.

    Bias and scale that follow temperature, nonlinearity, warm-up, a bias while charging, and g-sensitivity of
    the gyroscope can be corrected. DIAGNOSIS is the file that `stillcal diagnose --json` wrote ('-': standard
    input). The calibration without them stays in the history.
    """
    with _one_line(), Store(existing(path)) as store:
        document = store.load()
        if document is None or document.current is None:
            raise ValueError(f"{path}: holds no calibration: run stillcal replay or the daemon first")
        try:
            found, diagnosed = _findings(diagnosis)
            record, refused = adopt(document.current, found, diagnosed)
        except KeyError as error:
            raise ValueError(f"{input_name(diagnosis)}: a finding lacks its {error.args[0]}") from error
        except (TypeError, AttributeError) as error:
            why = "a finding is not as stillcal diagnose --json writes it"
            raise ValueError(f"{input_name(diagnosis)}: {why}") from error
        except ValueError as error:
            raise ValueError(f"{input_name(diagnosis)}: {error}") from error
        store.publish(record, f"terms from {short_name(diagnosis)}")
    click.echo(
        f"{path}: calibration {record.id} now corrects {', '.join(term.effect for term in record.terms)}"
    )
    for effect, why in refused.items():
        click.echo(printable(f"not taken up: {effect}: {why}"), err=True)


def _findings(path: Path) -> tuple[list[dict[str, Any]], Beginning | None]:
    """Read the findings of a diagnosis and when its recording began. Raises ValueError if it is none."""
    data = read_input(path, MAX_BYTES)
    try:
        answer = json.loads(data.decode("utf-8"))
        return [dict(finding) for finding in answer["findings"]], beginning_of(answer)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError("not a diagnosis: write one with stillcal diagnose --json") from error


@store_group.command(
    "repair",
    short_help="Take a store that was edited by hand or set aside.",
    epilog=examples(
        "stillcal store repair store.json                                       shows what was edited",
        "stillcal store repair store.json --yes                                 takes it as edited",
        "stillcal store repair store.json --from store.json.unreadable-1.json   shows a store set aside",
    ),
)
@path_argument
@click.option("--from", "source", type=click.Path(path_type=Path), help="The file to take; else PATH itself.")
@click.option("--yes", "accepted", is_flag=True, help="Take it; without this, only show what would change.")
def repair(path: Path, source: Path | None, accepted: bool) -> None:
    """Take a store whose checksum does not match because it was edited, or one that was set aside.

    Shows what differs from the store that is in use now. With --yes the file becomes the store, with a new
    checksum; what lay at PATH is set aside.
    """
    with _one_line():
        document = _approved(source or existing(path))
        with Store(path) as store:
            changes = differences(store.load_if_any() or StoreDocument(), document)
            for change in changes[:MOST_CHANGES]:
                click.echo(printable(change))
            if len(changes) > MOST_CHANGES:
                click.echo(f"... and {len(changes) - MOST_CHANGES} more")
            if not changes and store.verify().whole:
                click.echo(f"{path}: whole, and nothing differs")
            elif accepted:
                aside = store.put_back(document)
                click.echo(f"{path}: repaired{f'; what was there is now {aside}' if aside else ''}")
            else:
                click.echo(f"{path}: nothing is changed yet; take it with --yes")


def _approved(path: Path) -> StoreDocument:
    """Read a store whose checksum need not match. Raises ValueError, which says what to give instead."""
    try:
        return parse(read_regular(path, MAX_BYTES), trusted=True)[0]
    except (OSError, StoreFormatError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        remedy = "with --from, give a file that stillcal wrote, such as the store's .last-good"
        raise ValueError(f"{path} cannot be taken as a store ({why}): {remedy}") from error


@store_group.command(
    "verify",
    short_help="Check that a store is intact (exit code 1 if not).",
    epilog=examples(
        "stillcal store verify store.json",
        "stillcal store verify store.json --json",
    ),
)
@path_argument
@json_option
def verify(path: Path, as_json: bool) -> None:
    """Check that a store is intact: JSON, checksum, schema, units and values. Exit code 1 if it is not."""
    with _one_line():
        found, last_good = _both_files(path)
    whole = found.document is not None
    report = {
        "whole": whole,
        "store": reading_json(found),
        "last_good": last_good and reading_json(last_good),
    }
    if as_json:
        _print_json(report)
    else:
        for reading in filter(None, (found, last_good)):
            click.echo(f"{reading.path}: {verdict(reading)}")
    sys.exit(0 if whole else DAMAGED)


def _both_files(path: Path) -> tuple[Reading, Reading | None]:
    """Read a store and its last good copy, which one from a pipe has not."""
    if is_read_once(path):
        return read_piped(path), None
    found = Store(existing(path)).verify()
    return found.store, found.last_good


@contextmanager
def _one_line() -> Iterator[None]:
    """Turn a refusal into one line on standard error and exit code 2."""
    try:
        yield
    except ValueError as error:
        click.echo(f"stillcal: {error}", err=True)
        sys.exit(BAD_INPUT)


def _loaded(path: Path) -> StoreDocument:
    """Read a store, warning on standard error where only its last good copy could be used."""
    with _one_line():
        if is_read_once(path):
            return piped(path)
        store = Store(existing(path))
        problem = store.verify().store.problem
        document = store.load()
    if problem is not None:
        click.echo(f"stillcal: {path} is {problem}; showing {store.last_good_path}", err=True)
    return document or StoreDocument()


def _print_json(value: Any) -> None:
    click.echo(json.dumps(value, indent=2, allow_nan=False))


# What is printed


def history_rows(document: StoreDocument) -> Iterator[dict[str, Any]]:
    """Yield a row for the current, each earlier and each rejected calibration, newest first."""
    current = document.current
    if current is not None:
        reason = current.acceptance.reason
        yield _row(current, None, "current", current.fitted_at, reason)
    back = 0
    for entry in reversed(document.history):
        back += entry.what == "replaced"
        yield _entry_row(entry, back if entry.what == "replaced" else None)


def _entry_row(entry: HistoryEntry, back: int | None) -> dict[str, Any]:
    return _row(entry.calibration, back, entry.what.replace("_", " "), entry.at, entry.reason)


def _row(
    record: CalibrationRecord, back: int | None, what: str, at: float | None, reason: str
) -> dict[str, Any]:
    accelerometer = record.accelerometer
    return {
        "back": back,
        "id": record.id,
        "what": what,
        "at": at,
        "reason": reason,
        "rms_residual": accelerometer and accelerometer.rms_residual,
        "n_states": accelerometer and accelerometer.n_states,
    }


def print_history(title: str, rows: Iterable[dict[str, Any]]) -> None:
    """Print the rows of a history as a table."""
    table = Table(title=title)
    for name in ("steps", "id", "what", "at [s]", "rms [m/s²]", "attitudes"):
        table.add_column(name, justify="left" if name in ("id", "what") else "right", no_wrap=True)
    table.add_column("reason", overflow="fold")
    for row in rows:
        figures = (_figure(row["at"]), _figure(row["rms_residual"]), _figure(row["n_states"]))
        table.add_row(_figure(row["back"]), row["id"], row["what"], *figures, row["reason"])
    _print(table)


def print_calibration(record: CalibrationRecord) -> None:
    """Print a calibration: both sensors, then the data behind it."""
    table = Table(title=f"calibration {record.id}", caption="calibrated = scale @ (raw - bias)")
    table.add_column("", no_wrap=True)
    for axis in "xyz":
        table.add_column(axis, justify="right", no_wrap=True)
    for name, part in (("accelerometer", record.accelerometer), ("gyroscope", record.gyroscope)):
        if part is not None:
            _add_sensor(table, name, part.unit, part)
    _print(table)
    for line in _facts(record):
        click.echo(line)


def _add_sensor(table: Table, name: str, unit: str, part: SensorRecord) -> None:
    table.add_row(f"{name} bias [{unit}]", *(f"{v:.6f}" for v in part.bias))
    if (doubt := part.bias_uncertainty) is not None:
        table.add_row("  ± (1 sd)", *map(_figure, doubt.tolist()))
    for axis, row in zip("xyz", part.scale, strict=True):
        table.add_row(f"{name} scale, row {axis}", *(f"{v:.6f}" for v in row))


def _facts(record: CalibrationRecord) -> Iterator[str]:
    if (accelerometer := record.accelerometer) is not None:
        yield (
            f"accelerometer: {accelerometer.parameters} parameters from {accelerometer.n_rests} rests in "
            f"{accelerometer.n_states} attitudes, residual {_figure(accelerometer.rms_residual)} m/s²"
        )
    if record.gravity is not None:
        gravity = record.gravity
        yield f"gravity: {gravity.value:.5f} ± {gravity.uncertainty:.5f} m/s² ({gravity.source})"
    for term in record.terms:
        values = ", ".join(f"{name} {_numbers(p.value)} {p.unit}" for name, p in term.parameters.items())
        yield f"term {term.effect}: {values}{_reference(term)}"
    yield f"fitted at: {_figure(record.fitted_at)} s"
    yield f"accepted: {record.acceptance.how}, {record.acceptance.reason or 'no reason recorded'}"
    if record.provenance.software:
        yield f"made by: {record.provenance.software} from {record.provenance.source or 'an unnamed source'}"


def _reference(term: Term) -> str:
    """Return the temperature that a term counts from, and the span that it was learnt at."""
    at = term.reference
    if term.effect == BY_CHARGING:
        return f" once charging has warmed the phone, {lag_of(term):.0f} s behind the charger"
    since = f", from {at['temperature']:.1f} degC on" if "temperature" in at else ""
    if not {"temperature_min", "temperature_max"} <= at.keys():
        return since
    return f"{since}, learnt at {at['temperature_min']:.1f} to {at['temperature_max']:.1f} degC"


def _numbers(values: Array) -> str:
    if not values.ndim:
        return f"{values:.4g}"
    return "[" + ", ".join(map(_numbers, values)) + "]"


def reading_json(reading: Reading) -> dict[str, Any]:
    """Return the state of one file of the store, for JSON."""
    current = reading.document.current if reading.document else None
    return {
        "path": str(reading.path),
        "schema": reading.schema,
        "id": current.id if current else None,
        "history": len(reading.document.history) if reading.document else 0,
        "problem": str(reading.problem) if reading.problem else None,
    }


def verdict(reading: Reading) -> str:
    """Return the state of one file of the store in words."""
    if reading.problem is not None:
        return str(reading.problem)
    if reading.document is None:
        return "missing"
    current = reading.document.current
    held = f"calibration {current.id}" if current else "no calibration yet"
    return f"intact, schema {reading.schema}, {held}, {len(reading.document.history)} in the history"


def _figure(value: float | int | None) -> str:
    if value is None or not np.isfinite(value):
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def _print(table: Table) -> None:
    """Print a table without markup, 120 columns wide where there is no terminal."""
    Console(width=None if sys.stdout.isatty() else 120, markup=False, highlight=False).print(table)
