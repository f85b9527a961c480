"""Which writer a new recording's name asks for, of those that any recording fits into: CSV or Parquet."""

from __future__ import annotations

from pathlib import Path

from stillcal.replay.formats.conversion.parquet import ParquetTraceWriter
from stillcal.replay.formats.writer import STANDARD_OUTPUT, StandardOutputWriter, TraceWriter

ENDINGS = (".csv", ".csv.gz", ".parquet")


def writer_class(path: Path | str) -> type[TraceWriter]:
    """Return the writer for a name, "-" for standard output. Raises ValueError for another ending."""
    if Path(path) == STANDARD_OUTPUT:
        return StandardOutputWriter
    name = str(path)
    if not name.endswith(ENDINGS):
        raise ValueError(f"{name} is not a name for a recording: let it end in .csv, .csv.gz or .parquet")
    return ParquetTraceWriter if name.endswith(".parquet") else TraceWriter
