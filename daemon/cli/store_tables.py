"""What `stillcal store` prints: a calibration, the history of a store, whether it is whole."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import CalibrationRecord, SensorRecord
from stillcal.daemon.store.document import HistoryEntry, StoreDocument
from stillcal.daemon.store.store import Reading


def history_rows(document: StoreDocument) -> Iterator[dict[str, Any]]:
    """Return a row for the current, each earlier and each rejected calibration, newest first."""
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
    for name in ("back", "id", "what", "at [s]", "rms [m/s²]", "attitudes"):
        table.add_column(name, justify="left" if name in ("id", "what") else "right", no_wrap=True)
    table.add_column("reason", overflow="fold")
    for row in rows:
        figures = (_figure(row["at"]), _figure(row["rms_residual"]), _figure(row["n_states"]))
        table.add_row(_figure(row["back"]), row["id"], row["what"], *figures, row["reason"])
    _print(table)


def print_calibration(record: CalibrationRecord) -> None:
    """Print a calibration: both sensors, then what it rests on."""
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
        since = "".join(f", from {t:.1f} degC on" for t in term.reference.values())
        yield f"term {term.effect}: {values}{since}"
    yield f"fitted at: {_figure(record.fitted_at)} s"
    yield f"accepted: {record.acceptance.how}, {record.acceptance.reason or 'no reason recorded'}"
    if record.provenance.software:
        yield f"by: {record.provenance.software} from {record.provenance.source or 'an unnamed source'}"


def _numbers(values: Array) -> str:
    return "[" + ", ".join(_numbers(v) if v.ndim else f"{v:.4g}" for v in values) + "]"


def reading_json(reading: Reading) -> dict[str, Any]:
    """Return what lies at a path, for JSON."""
    current = reading.document.current if reading.document else None
    return {
        "path": str(reading.path),
        "schema": reading.schema,
        "id": current.id if current else None,
        "history": len(reading.document.history) if reading.document else 0,
        "problem": str(reading.problem) if reading.problem else None,
    }


def verdict(reading: Reading) -> str:
    """Say in words what lies at a path."""
    if reading.problem is not None:
        return str(reading.problem)
    if reading.document is None:
        return "missing"
    current = reading.document.current
    held = f"calibration {current.id}" if current else "no calibration yet"
    return f"whole, schema {reading.schema}, {held}, {len(reading.document.history)} in the history"


def _figure(value: float | int | None) -> str:
    if value is None or not np.isfinite(value):
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def _print(table: Table) -> None:
    """Print a table, taking no square bracket for markup; 120 columns where there is no terminal."""
    Console(width=None if sys.stdout.isatty() else 120, markup=False, highlight=False).print(table)
