"""Further columns of a recording that may drive its sensors' errors: battery voltage, load, a motor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.time_series import TimeSeries
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.stream import SampleFile


def read_covariates(file: SampleFile, names: Sequence[str]) -> dict[str, TimeSeries]:
    """Return further columns of a recording's table, each over its time, s, without empty and nan cells.

    file: that the accelerometer is read from. Raises TraceError where it has no such column, a column holds
    no numbers, or a cell of one that does is none.
    """
    for name in names:
        if name in file.own_columns:
            what = f"{name!r} is a sensor's own column"
            raise TraceError(file.path, what, "name a further one for --covariate")
        if name not in file.columns:
            raise TraceError(
                file.path, f"it has no column {name!r}", f"it has {', '.join(file.columns) or 'none'}", 1
            )
    try:
        t, values = file.further(names)
    except TraceError as error:
        raise TraceError(error.file, error.what, f"mend the row, or {_choice(file)}", error.row) from error
    return {name: _series(file, name, t, column) for name, column in zip(names, values.T, strict=True)}


def _choice(file: SampleFile) -> str:
    further = [name for name in file.columns if name not in file.own_columns]
    return f"name a column of numbers; further ones: {', '.join(further)}"


def _series(file: SampleFile, name: str, t: Array, values: Array) -> TimeSeries:
    there = np.flatnonzero(np.isfinite(values))
    if not there.size:
        raise TraceError(file.path, f"the column {name!r} holds no numbers", _choice(file))
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
