"""Opens a recording of any known format: recognises it by its content and finds the sensors in it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol, TypeAlias

from stillcal.daemon.system.files import input_name, is_read_once, short_name
from stillcal.replay.formats.columns import ColumnMap, load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.arrays import open_arrays
from stillcal.replay.formats.logs.axivity import open_axivity
from stillcal.replay.formats.logs.dataflash import open_dataflash
from stillcal.replay.formats.logs.ros import FOLDER_INDEX, open_ros, open_ros_folder
from stillcal.replay.formats.logs.sample_folder import sample_folder, sample_members
from stillcal.replay.formats.logs.ulog import open_ulog
from stillcal.replay.formats.recognition import magic
from stillcal.replay.formats.recognition.log import GyroscopeAloneError, Log
from stillcal.replay.formats.recognition.phone_export import members_of_folder, members_of_zip, phone_export
from stillcal.replay.formats.recognition.table_logs import echo_log, json_log, text_log, without_samples
from stillcal.replay.formats.recognition.text_formats import REST, text_format
from stillcal.replay.formats.shipped import located
from stillcal.replay.formats.sources import Source, source_of
from stillcal.replay.formats.tables.text import NoRowsError

AUTO = "auto"
"""The format of a recording whose content is to decide, as None is."""

Format: TypeAlias = str | Path | ColumnMap | None
"""A format's name or a column map's path, a column map, or None: recognised by content."""

Reader = Callable[[Source, ColumnMap | None, Source | None], Log]
"""Opens a recording by a given column map, or by what is in it; the last argument is the gyroscope's file."""


class TableReader(Protocol):
    """The same for a table; rate_hz: where it has no time stamps."""

    def __call__(
        self,
        source: Source,
        column_map: ColumnMap | None,
        gyro: Source | None,
        rate_hz: float | None = None,
    ) -> Log:
        """Return the log of a table."""


_RATE = re.compile(r"(\d+(?:\.\d+)?) ?Hz", re.IGNORECASE)


def kept(path: Path | str) -> Path | Source:
    """Return where a recording can be read more than once: a pipe's bytes, read to their end, else its path.

    Raises TraceError where there is no such sample, or the pipe gives nothing that is read.
    """
    return source_of(path, magic.kind_of) if is_read_once(path) else located(path)


def open_log(path: Path | str | Source, format: Format = None, gyro: Path | None = None) -> Log:
    """Recognise a recording; format: as `open_trace` takes it. Raises TraceError."""
    if str(format) == REST:
        where = path.path if isinstance(path, Source) else input_name(path)
        raise without_samples(where)
    format = None if str(format) == AUTO else format
    rate_hz = None if format is None else stated_hz(str(format))
    format = format if rate_hz is None else None
    found = path if isinstance(path, Source) else kept(path)
    column_map = format if format is None or isinstance(format, ColumnMap) else load_map(format)
    if isinstance(found, Path) and found.is_dir():
        _refuse_gyro(gyro, found, "a folder")
        if (found / FOLDER_INDEX).is_file():
            return open_ros_folder(found)
        log = sample_folder(found) if column_map is None else None
        return log or _archive(found, members_of_folder(found), column_map)
    source = found if isinstance(found, Source) else source_of(found)
    kind = magic.kind_of(source)
    if kind not in _TABLES:
        _refuse_gyro(gyro, source.path, kind)
    other = None if gyro is None else source_of(gyro)
    if other is not None and source.path.exists() and other.path.resolve() == source.path.resolve():
        raise TraceError(
            other.path, "is the recording itself", "leave --gyro out where it holds both sensors"
        )
    if rate_hz is None:
        log = _log(source, column_map, other)
    elif kind in _TABLES:
        log = _TABLES[kind](source, None, other, rate_hz)
    else:
        raise TraceError(source.path, f"is {kind}, which has its own times", "leave --format out")
    return (
        replace(log, notes=[f"{short_name(source.path)}: {source.said}", *log.notes]) if source.said else log
    )


def stated_hz(format: str) -> float | None:
    """Return the rate, Hz, that a format says a table without time stamps has (100Hz); None of another."""
    found = _RATE.fullmatch(format)
    return float(found[1]) if found and float(found[1]) > 0 else None


def _refuse_gyro(gyro: Path | None, path: Path, kind: str) -> None:
    """Raise TraceError where a gyroscope's own file is given for what holds all its sensors itself."""
    if gyro is not None:
        raise TraceError(
            path, f"is {kind}, which no gyroscope's file of its own goes with", "leave --gyro out"
        )


def is_rest_table(found: Path | Source, format: Format = None) -> bool:
    """Whether a file or a pipe's bytes are a rest table: so named, or recognised. Raises TraceError."""
    if format is not None and str(format) != AUTO:
        return str(format) == REST
    if isinstance(found, Path) and not found.is_file():
        return False
    source = found if isinstance(found, Source) else source_of(found)
    return magic.kind_of(source) == magic.TEXT and text_format(source).name == REST


def _log(source: Source, column_map: ColumnMap | None, gyro: Source | None) -> Log:
    return READERS[magic.kind_of(source)](source, column_map, gyro)


def _arrays(kind: str) -> Reader:
    """Return the reader of files of named arrays."""
    return lambda source, column_map, _: open_arrays(source, kind, column_map)


def _self_described(kind: str, opened: Callable[[Source], Log]) -> Reader:
    """Return the reader of logs that say themselves what is in them, and take no column map."""

    def read(source: Source, column_map: ColumnMap | None, _: Source | None) -> Log:
        if column_map is not None:
            what = f"is {kind}, which says itself what is in it"
            raise TraceError(source.path, what, "leave --format out")
        return opened(source)

    return read


def _one_array(source: Source, _column_map: ColumnMap | None, _gyro: Source | None) -> Log:
    """Refuse an array without a name. Raises TraceError."""
    what = f"is {magic.NPY}, which is not read"
    raise TraceError(source.path, what, "save the arrays as .npz, or export CSV")


def _zip_log(source: Source, column_map: ColumnMap | None, _: Source | None) -> Log:
    """Return what a zip archive holds, which may be NumPy's arrays. Raises TraceError."""
    members = members_of_zip(source)
    if members and all(name.endswith(".npy") for name in members):
        return open_arrays(source, magic.ZIP, column_map)
    return _archive(source.path, members, column_map)


def _archive(path: Path, members: dict[str, Source], column_map: ColumnMap | None) -> Log:
    """Return what a folder or a zip archive holds. Raises TraceError where it is no recording, or several."""
    if "[Content_Types].xml" in members:
        raise TraceError(path, "is an Office document (Excel?)", "export the recording as CSV")
    export = phone_export(path, members) or sample_members(path, members)
    if export is not None:
        return export
    found, alone, empty = _opened(members, column_map)
    if len(found) == 1:
        ((name, log),) = found.items()
        used = {name}
        if len(alone) == 1 and column_map is None and magic.kind_of(members[name]) in _TABLES:
            log = _log(members[name], None, next(iter(alone.values())))
            used |= alone.keys()
        others = [member for member in members if member not in used]
        name = " with ".join([name, *sorted(used - {name})])
        log = replace(log, notes=[*(f"{short_name(path)}: {line}" for line in empty), *log.notes])
        said = [f"{short_name(path)}: {name} is read; passed over: {_first_of(others)}"] if others else []
        return replace(log, notes=[*said, *log.notes])
    if not found and len(alone) == 1:
        raise GyroscopeAloneError(path / next(iter(alone)))
    names = _first_of(list(found or members))
    if not found:
        what = f"holds no recording that is known ({names or 'it is empty'})"
        raise TraceError(path, what, "give an export of phyphox or Sensor Logger, or name a file in it")
    remedy = "give one of them" if path.is_dir() else "unpack it and give one of them"
    raise TraceError(path, f"holds {len(found)} recordings: {names}", remedy)


def _opened(
    members: dict[str, Source], column_map: ColumnMap | None
) -> tuple[dict[str, Log], dict[str, Source], list[str]]:
    """Return the recordings among files, those of a gyroscope alone, and what is said of empty ones.

    Those of an accelerometer that only gravity tells are left out where others name theirs.
    """
    found: dict[str, Log] = {}
    alone: dict[str, Source] = {}
    empty: list[str] = []
    for name, source in members.items():
        try:
            found[name] = _log(source, column_map, None)
        except GyroscopeAloneError:
            alone[name] = source
        except NoRowsError:
            empty.append(f"{name} holds a header and no samples")
        except TraceError:
            continue
    named = {name: log for name, log in found.items() if not log.by_gravity}
    return named or found, alone, empty


def _first_of(names: list[str]) -> str:
    return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")


_TABLES: dict[str, TableReader] = {magic.TEXT: text_log, magic.JSON: json_log, magic.ECHO: echo_log}
"""The tables that a gyroscope's own file may go with."""

_LOGS: dict[str, Callable[[Source], Log]] = {
    magic.AXIVITY: open_axivity,
    magic.DATAFLASH: open_dataflash,
    magic.ULOG: open_ulog,
    **{kind: partial(open_ros, kind=kind) for kind in (magic.ROS1, magic.ROS2, magic.MCAP)},
}


READERS: dict[str, Reader] = {
    **_TABLES,
    **{kind: _arrays(kind) for kind in (magic.PARQUET, magic.HDF5, magic.MATLAB)},
    **{kind: _self_described(kind, opened) for kind, opened in _LOGS.items()},
    magic.ZIP: _zip_log,
    magic.NPY: _one_array,
}
"""What opens a file of each kind that magic.kind_of tells apart."""
