"""Writing a recording as Parquet: the columns of the CSV format, empty cells as nulls."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.logs.extras import library
from stillcal.replay.formats.writer import TraceWriter

_GROUP_ROWS = 1 << 17
"""Rows of a row group: large enough to compress and read fast, 8 MB in memory."""

_STAMPS = ("t", "t_arrival")
"""Columns in which no number comes twice; their high bytes repeat, and are stored side by side."""

_MOST_CODES = 1 << 16
"""Readings of a sensor of 16 bits take so many values: a row group holds each value once, and for every row
which one it is. That is read three times as fast as plain numbers in zstd, and a third smaller. A column of
more values is stored plain."""


class ParquetTraceWriter(TraceWriter):
    """Writes NAME.parquet, with events and claims beside it; used as TraceWriter is."""

    def _begin(self, file: BinaryIO) -> None:
        self._arrow = library("pyarrow", "parquet", self.path, "Parquet")
        parquet = library("pyarrow.parquet", "parquet", self.path, "Parquet")
        schema = self._arrow.schema([(name, self._arrow.float64()) for name in self.columns])
        stamps = [name for name in self.columns if name in _STAMPS]
        self._writer: Any = parquet.ParquetWriter(
            file,
            schema,
            compression="lz4",
            use_dictionary=[name for name in self.columns if name not in stamps],
            dictionary_pagesize_limit=_MOST_CODES * 8,
            column_encoding=dict.fromkeys(stamps, "BYTE_STREAM_SPLIT"),
        )
        self._schema = schema
        self._waiting: list[Array] = []

    def _append(self, rows: Array) -> None:
        self._waiting.append(rows)
        if sum(map(len, self._waiting)) >= _GROUP_ROWS:
            self._write_group()

    def _write_group(self) -> None:
        rows = np.concatenate(self._waiting)
        self._waiting = []
        columns = [self._arrow.array(column, mask=np.isnan(column)) for column in rows.T]
        self._writer.write_table(self._arrow.table(columns, schema=self._schema))

    def _end(self) -> None:
        if self._waiting:
            self._write_group()
        self._writer.close()
