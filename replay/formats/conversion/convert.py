"""A recording into another format, chunk by chunk: CSV, Parquet or MCAP, by the name of the new file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.errors import UserError
from stillcal.replay.formats.conversion import by_name
from stillcal.replay.formats.conversion.by_name import writer_class
from stillcal.replay.formats.conversion.mcap import McapTraceWriter
from stillcal.replay.formats.trace import Trace
from stillcal.replay.formats.writer import STANDARD_OUTPUT, TraceWriter

ENDINGS = (*by_name.ENDINGS, ".mcap")


def writer_for(trace: Trace, out: Path, *, side_files: bool = True) -> TraceWriter:
    """Return the writer of the format that the name `out` asks for. Raises UserError for another name.

    side_files: whether events and claims are written too.
    """
    if out != STANDARD_OUTPUT and not out.name.endswith(ENDINGS):
        raise UserError(f"{out}: choose a name that ends in {', '.join(ENDINGS)}")
    first = next(iter(trace.chunks(max_rows=64)))
    columns: dict[str, Any] = {
        "gyroscope": trace.has_gyroscope,
        "temperature": trace.has_temperature,
        "arrival": first.accelerometer.t_arrival is not None,
        "claims": trace.claims.without_counts(),
        "side_files": side_files,
    }
    if out.suffix == ".mcap":
        return McapTraceWriter(out, shared=_stamps_are_shared(trace), **columns)
    return writer_class(out)(out, **columns)


def _stamps_are_shared(trace: Trace) -> bool:
    """Whether every sample of one sensor has one of the other at the same time; reads the recording once."""
    return all(np.array_equal(chunk.accelerometer.t, chunk.gyroscope.t) for chunk in trace)
