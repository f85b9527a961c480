"""The two tables of a fleet, one row a recording and one a finding, as Parquet."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from stillcal.calib_core.accelerometer.parameters import AXES
from stillcal.daemon.store.atomic import led_to

Rows = list[dict[str, Any]]

_TEXT, _REAL, _WHOLE = pa.string(), pa.float64(), pa.int64()


def _sensor(name: str) -> list[tuple[str, Any]]:
    entries = [f"bias_{a}" for a in AXES] + [f"scale_{a}{b}" for a in AXES for b in AXES]
    columns: list[tuple[str, Any]] = [(f"{name}_parameters", _WHOLE), (f"{name}_rms_residual", _REAL)]
    columns += [(f"{name}_{entry}{end}", _REAL) for entry in entries for end in ("", "_sd")]
    return [*columns, (f"{name}_names", pa.list_(_TEXT)), (f"{name}_covariance", pa.list_(_REAL))]


RECORDINGS = pa.schema(
    [
        ("name", _TEXT),
        ("model", _TEXT),
        ("device", _TEXT),
        ("format", _TEXT),
        ("made_by", _TEXT),
        ("size_bytes", _WHOLE),
        ("mtime_ns", _WHOLE),
        ("content", _TEXT),
        ("status", _TEXT),
        ("reason", _TEXT),
        ("missing", pa.list_(_TEXT)),
        ("duration_s", _REAL),
        ("samples", _WHOLE),
        ("rate_hz", _REAL),
        ("rate_jitter", _REAL),
        ("noise", _REAL),
        ("gravity", _REAL),
        ("temperature_min", _REAL),
        ("temperature_max", _REAL),
        ("rests", _WHOLE),
        ("turns", _WHOLE),
        ("attitudes", _WHOLE),
        ("most_helpful_attitude", _TEXT),
        *_sensor("accel"),
        *_sensor("gyro"),
        ("verdict", _TEXT),
        ("findings", _WHOLE),
        ("limits", pa.list_(_TEXT)),
        ("calibrate_s", _REAL),
        ("diagnose_s", _REAL),
    ],
    {"units": "SI: s, m/s^2, rad/s, degC; calibrated = scale @ (raw - bias); *_sd: standard uncertainty"},
)
"""One row a recording. Empty where something was not found."""

FINDINGS = pa.schema(
    [
        ("name", _TEXT),
        ("model", _TEXT),
        ("device", _TEXT),
        ("effect", _TEXT),
        ("sensor", _TEXT),
        ("axes", pa.list_(_TEXT)),
        ("t_start", _REAL),
        ("t_end", _REAL),
        ("driver", _TEXT),
        ("parameter", _TEXT),
        ("value", pa.list_(_REAL)),
        ("unit", _TEXT),
        ("probability", _REAL),
        ("heldout_log_score_gain", _REAL),
        ("indistinguishable", pa.list_(_TEXT)),
        ("statement", _TEXT),
    ]
)
"""One row a finding; `name` is its recording's. parameter, value, unit: its first parameter, row by row."""


def write(path: Path, rows: Sequence[dict[str, Any]], schema: Any) -> None:
    """Write a table whole or not at all."""
    path = led_to(path)
    temporary = path.with_name(f".{path.name}.part")
    try:
        pq.write_table(pa.Table.from_pylist(list(rows), schema), temporary, compression="zstd")
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def read(path: Path) -> Rows:
    """Read a table; no rows where there is no file."""
    if not path.is_file():
        return []
    rows: Rows = pq.read_table(path, partitioning=None).to_pylist()
    return rows
