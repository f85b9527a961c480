"""Further columns of a recording that may drive its sensors' errors: battery voltage, load, a motor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.time_series import TimeSeries
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.formats.trace import Trace


def read_covariates(trace: Trace, names: Sequence[str]) -> dict[str, TimeSeries]:
    """Return further columns of a recording, each over its time, s, without empty and nan cells.

    They may stand in any table that the samples come from. Raises TraceError where none has such a column, a
    column holds no numbers, or a cell of one that does is none.
    """
    return {name: _read(_with(trace, name), name) for name in names}


def columns_there(trace: Trace, names: Sequence[str]) -> list[str]:
    """Return those of the names that a recording has as columns."""
    return [name for name in names if any(name in file.columns for file in trace.files)]


def _with(trace: Trace, name: str) -> SampleFile:
    """Return the file that has a further column of that name. Raises TraceError."""
    found = next((file for file in trace.files if name in file.further_columns), None)
    if found is not None:
        return found
    if columns_there(trace, [name]):
        raise TraceError(
            trace.path, f"{name!r} is a sensor's own column", "name a further one for --covariate"
        )
    there = [column for file in trace.files for column in file.columns]
    raise TraceError(trace.path, f"it has no column {name!r}", f"it has {', '.join(there) or 'none'}")


def _read(file: SampleFile, name: str) -> TimeSeries:
    others = [other for other in file.further_columns if other != name]
    choice = f"name a column of numbers; further ones: {', '.join(others) or 'none'}"
    try:
        t, values = file.further(name)
    except TraceError as error:
        raise TraceError(error.file, error.what, f"mend the row, or {choice}", error.row) from error
    there = np.flatnonzero(np.isfinite(values))
    if not there.size:
        raise TraceError(file.path, f"the column {name!r} holds no numbers", choice)
    ordered = there[np.argsort(t[there], kind="stable")]
    return TimeSeries(t[ordered], values[ordered])


def of_values(name: str, values: Any, stamps: Array) -> TimeSeries:
    """Return a covariate from memory, without what is not finite.

    values: (n,) at the recording's stamps (n,) s, or a pair of times (m,) s and values (m,). Raises
    TraceError where they are no numbers, of another length, or their times run backwards.
    """
    t, own = values if isinstance(values, tuple) and len(values) == 2 else (stamps, values)
    try:
        t, own = np.asarray(t, dtype=np.float64), np.asarray(own, dtype=np.float64)
    except (TypeError, ValueError):
        raise TraceError(name, "the covariate holds what is not a number", "give numbers") from None
    if t.ndim != 1 or own.shape != t.shape:
        what = f"the covariate has shape {own.shape} and its times {t.shape}"
        raise TraceError(name, what, "give a value for each sample, or a pair (t, values)")
    there = np.isfinite(t) & np.isfinite(own)
    if not there.any() or (np.diff(t[there]) < 0.0).any():
        what = "the covariate holds no numbers" if not there.any() else "the covariate's times run backwards"
        raise TraceError(name, what, "correct it")
    return TimeSeries(t[there], own[there])
