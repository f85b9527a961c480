"""Files of named arrays: Parquet, HDF5, MATLAB, NumPy archives and JSON objects.

What an array is follows from its name and from the first samples (recognition/settle.py); a column map given
as --format overrides that. The axes of an array `acc` of three columns are called `acc[0]`, `acc[1]` and
`acc[2]`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.columns import TIME_UNITS, ColumnMap, load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.extras import library
from stillcal.replay.formats.logs.json_log import json_arrays, json_document
from stillcal.replay.formats.logs.matlab import TooLongError, read_matlab
from stillcal.replay.formats.recognition import magic
from stillcal.replay.formats.recognition.log import Log, LoggedSensor, Part
from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.containers import qualified
from stillcal.replay.formats.recognition.names.kinds import is_own, is_rate_hz, rates_alone
from stillcal.replay.formats.recognition.names.stamps import find_stamps
from stillcal.replay.formats.recognition.row_sensors import sensors_of_rows
from stillcal.replay.formats.recognition.settle import OneSensor, settled
from stillcal.replay.formats.sources import Source, unpacked_copy
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.formats.tables.chosen import MOST_TEXTS
from stillcal.replay.formats.tables.numbers import BLOCK_ROWS, NumberTable, as_floats, of_arrow, side_by_side
from stillcal.replay.formats.tables.table import Table

MOST_ARRAYS = 2000
"""Arrays of a file that are looked at; a recording has a few dozen."""

MOST_BYTES = 2 << 30
"""Bytes of an array that is read whole into memory at most."""


@dataclass(slots=True)
class _Arrays:
    """The arrays of a file, or of one group of it.

    columns: by name, each giving its values between two rows. length: rows. rate_hz: where a number says so.
    windows: whether there are arrays of three dimensions, which are no columns. uneven: rows of the sensors'
    arrays, by name, where no gyroscope has those of an accelerometer. clocks: rows of what may be times.
    words: the texts of columns of texts, whose values are places in them.
    """

    columns: dict[str, Callable[[int, int], Array]] = field(default_factory=dict)
    length: int = 0
    rate_hz: float | None = None
    windows: bool = False
    uneven: dict[str, int] = field(default_factory=dict)
    clocks: frozenset[int] = frozenset()
    words: dict[str, list[str]] = field(default_factory=dict)

    def table(self, path: Path, size: int) -> NumberTable:
        """Return the columns as a table that is read in blocks."""
        names = list(self.columns)

        def rows(places: Sequence[int]) -> Iterator[tuple[Array, float]]:
            for first in range(0, self.length, BLOCK_ROWS):
                last = min(first + BLOCK_ROWS, self.length)
                chosen = [as_floats(self.columns[names[p]](first, last)) for p in places]
                yield side_by_side(chosen), last / self.length

        return NumberTable(path, names, rows, size, self.words)


class _Texts:
    """An array of texts (n,) as places in the list of its different ones."""

    def __init__(self, values: Array) -> None:
        self.words, self.codes = np.unique(values, return_inverse=True)
        self.shape, self.ndim, self.size = self.codes.shape, self.codes.ndim, self.codes.size

    def __getitem__(self, rows: slice) -> Array:
        return np.asarray(self.codes[rows])


def open_arrays(source: Source, kind: str, column_map: ColumnMap | None = None) -> Log:
    """Open a file of named arrays. Raises TraceError where no accelerometer is found in it."""
    stored = unpacked_copy(source)
    readers = {magic.PARQUET: _parquet, magic.HDF5: _hdf5, magic.MATLAB: _matlab, magic.ZIP: _numpy}
    readers[magic.JSON] = _json
    try:
        groups, extra = readers[kind](stored)
    except TraceError:
        raise
    except MemoryError:
        raise TraceError(source.path, "does not fit into memory", "give a part of it") from None
    except Exception as error:  # the libraries raise whatever their parsing meets
        what = f"the {kind} file is damaged ({type(error).__name__}: {' '.join(str(error).split())[:120]})"
        raise TraceError(source.path, what, "write it again") from None
    sensors = _sensors(source, stored.size, groups, column_map)
    notes = [f"{short_name(source.path)}: {line}" for line in extra]
    return Log(source.path, kind if kind != magic.ZIP else "NPZ", sensors, notes, source.local)


def _sensors(
    source: Source, size: int, groups: Mapping[str, _Arrays], column_map: ColumnMap | None
) -> list[LoggedSensor]:
    found: list[LoggedSensor] = []
    tables = {group: _named_table(source.path, size, group, arrays) for group, arrays in groups.items()}
    for group, arrays in groups.items():
        table = tables[group]
        if column_map is not None:
            found += mapped(table, column_map, group)
            continue
        if is_own(table.names or []):
            found += mapped(table, load_map("csv"), group)
            continue
        if arrays.words:
            own = sensors_of_rows(partial(arrays.table, source.path, size), load_map("csv"), arrays.rate_hz)
            found += own
            if own:
                continue
        said = _uneven(source.path, arrays)
        for sensor in settled(table, load_map("csv"), arrays.rate_hz, _rates_of(group, groups, tables)):
            name = "/".join(part for part in (group, sensor.name) if part and part != "imu") or "imu"
            found.append(LoggedSensor(name, sensor.files, sensor.about, (*sensor.notes, *said)))
    if not found:
        names = [name for arrays in groups.values() for name in arrays.columns]
        listed = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
        deep = any(arrays.windows for arrays in groups.values())
        windows = "; arrays of three dimensions are windows, no recording" if deep else ""
        what = f"no accelerometer found in its arrays ({listed or 'there are none of numbers'}){windows}"
        remedy = "name them acc, gyr and t, or say in a column map what they are (docs/formats.md)"
        if any(rates_alone(table.names or []) for table in tables.values()):
            what = f"holds a gyroscope and no accelerometer ({listed})"
            remedy = "give both: without an accelerometer's rests and gravity nothing is calibrated"
        raise TraceError(source.path, what, remedy)
    return found


def _named_table(path: Path, size: int, group: str, arrays: _Arrays) -> NumberTable:
    """Return the table of a group, with what the group's name tells of its columns."""
    table = arrays.table(path, size)
    table.names = qualified(table.names or [], group.rpartition("/")[2])
    return table


def _rates_of(
    group: str, groups: Mapping[str, _Arrays], tables: Mapping[str, NumberTable]
) -> OneSensor | None:
    """Return the group of a gyroscope alone that belongs to a group: the only one beside it, or at all."""
    alone = [other for other in tables if other != group and rates_alone(tables[other].names or [])]
    beside = [other for other in alone if other.rpartition("/")[0] == group.rpartition("/")[0]]
    chosen = next((found[0] for found in (beside, alone) if len(found) == 1), None)
    return None if chosen is None else OneSensor(tables[chosen], load_map("csv"), groups[chosen].rate_hz)


def _with_clocks(by_group: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return groups of arrays; those without times have the times of the groups that hold them."""
    out = {}
    for group, items in by_group.items():
        rows = {_oriented(item)[0] for item in items.values()}
        above, times = group, dict[str, Any]()
        while above and not times and not find_stamps(list(items)):
            above = above.rpartition("/")[0]
            outer = by_group.get(above, {})
            times = {
                n: v
                for n, v in outer.items()
                if find_stamps([n]) and _oriented(v)[:2] in {(r, 1) for r in rows}
            }
        out[group] = {**times, **items}
    return out


def _uneven(path: Path, arrays: _Arrays) -> list[str]:
    """Say what is read of sensors' arrays of unequal lengths. Raises TraceError where each has a clock."""
    if not arrays.uneven:
        return []
    listed = ", ".join(f"{name} {rows}" for name, rows in arrays.uneven.items())
    what = f"arrays of unequal lengths (rows: {listed})"
    if arrays.clocks.issuperset(arrays.uneven.values()):
        remedy = "give them in Python: load(t=, accelerometer=, gyroscope=, gyroscope_t=), or as two files"
        raise TraceError(path, f"{what} with times of their own are not read together", remedy)
    short = [name for name, rows in arrays.uneven.items() if rows < arrays.length]
    left = f"; left out: {', '.join(short)}" if short else ""
    return [f"{short_name(path)}: {what}: the first {arrays.length} rows are read{left}"]


def mapped(table: Table, column_map: ColumnMap, group: str = "") -> list[LoggedSensor]:
    """Return the sensor that a column map finds in a group; of several groups those that have it."""
    sensors = [Sensor.ACCELEROMETER] + ([Sensor.GYROSCOPE] if column_map.gyroscope else [])
    SampleFile(table, column_map, sensors, Claims())  # raises where a column is missing
    return [LoggedSensor.of(group or "imu", [Part(table, column_map, sensors)])]


def _parquet(stored: Source) -> tuple[dict[str, _Arrays], list[str]]:
    """Return the columns of a Parquet file; it is read row group by row group."""
    parquet = library("pyarrow.parquet", "parquet", stored.path, magic.PARQUET)
    file = parquet.ParquetFile(str(stored.local))
    names = [f.name for f in file.schema_arrow if _is_number(f.type)]
    texts = {f.name: _words_of(file, f.name) for f in file.schema_arrow if _is_text(f.type)}
    words = {name: found for name, found in texts.items() if found is not None}
    return {"": _ParquetColumns(stored, [*names, *words], file.metadata.num_rows, words)}, []


def _is_text(kind: Any) -> bool:
    from pyarrow import types  # noqa: PLC0415 - only where a Parquet file is read

    kind = kind.value_type if types.is_dictionary(kind) else kind
    return bool(types.is_string(kind) or types.is_large_string(kind))


def _words_of(file: Any, name: str) -> list[str] | None:
    """Return the different texts of a Parquet file's column; None where they are more than MOST_TEXTS."""
    known: dict[str, None] = {}
    for batch in file.iter_batches(BLOCK_ROWS, columns=[name], use_threads=False):
        known |= dict.fromkeys(text for text in batch.column(0).unique().to_pylist() if text is not None)
        if len(known) > MOST_TEXTS:
            return None
    return list(known)


def _is_number(kind: Any) -> bool:
    from pyarrow import types  # noqa: PLC0415 - only where a Parquet file is read

    return bool(
        types.is_integer(kind)
        or types.is_floating(kind)
        or types.is_timestamp(kind)
        or types.is_duration(kind)
    )


class _ParquetColumns(_Arrays):
    """Columns of a Parquet file."""

    def __init__(self, stored: Source, names: list[str], length: int, words: dict[str, list[str]]) -> None:
        super().__init__(dict.fromkeys(names, lambda first, last: np.empty(0)), length, words=words)
        self._stored = stored

    def table(self, path: Path, size: int) -> NumberTable:
        """Return the columns as a table that is read in batches."""
        names, stored = list(self.columns), self._stored

        def rows(places: Sequence[int]) -> Iterator[tuple[Array, float]]:
            from pyarrow import parquet  # noqa: PLC0415 - only where a Parquet file is read

            wanted = [names[p] for p in places]
            done = 0
            with parquet.ParquetFile(str(stored.local), pre_buffer=False) as file:  # which is for networks
                chosen = list(dict.fromkeys(wanted))
                for batch in file.iter_batches(BLOCK_ROWS, columns=chosen, use_threads=False):
                    done += batch.num_rows
                    columns = [
                        _numbers(batch.column(batch.schema.get_field_index(n)), self.words.get(n))
                        for n in wanted
                    ]
                    yield side_by_side(columns), done / max(self.length, 1)

        return NumberTable(path, names, rows, size, self.words)


def _numbers(column: Any, words: Sequence[str] | None) -> Array:
    """Return an Arrow column as numbers, NaN where it is null; times in s, texts as places in `words`."""
    if words is not None:
        places = {word: float(place) for place, word in enumerate(words)}
        return np.array([places.get(text, np.nan) for text in column.to_pylist()], dtype=np.float64)
    unit = getattr(column.type, "unit", None)
    values = of_arrow(column if unit is None else column.cast("int64"))
    return values if unit is None else values * TIME_UNITS[unit]


def _hdf5(stored: Source) -> tuple[dict[str, _Arrays], list[str]]:
    """Return the arrays of an HDF5 file by group, also of MATLAB 7.3, which stores them transposed.

    A table of structured rows is a group of its columns.
    """
    h5py = library("h5py", "hdf5", stored.path, magic.HDF5)
    file = h5py.File(str(stored.local), "r")
    by_group: dict[str, dict[str, Any]] = {}
    scalars: dict[str, float] = {}

    seen = 0

    def visit(name: str, item: Any) -> bool | None:
        nonlocal seen
        seen += 1
        if seen > MOST_ARRAYS:
            return True  # ends the visit
        for attribute, value in item.attrs.items():
            _note_rate(scalars, attribute, value)
        if isinstance(item, h5py.Dataset) and item.dtype.names is not None and item.nbytes <= MOST_BYTES:
            by_group.setdefault(name, {}).update(_of_numbers(name, item[()]))
        group, _, last = name.rpartition("/")
        if isinstance(item, h5py.Dataset) and h5py.check_string_dtype(item.dtype) and item.ndim == 1:
            by_group.setdefault(group, {}).update(_of_texts(last, item.asstr()[()].astype(str)))
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "iuf":
            return None
        if item.size == 1:
            scalars[last] = float(np.ravel(item[()])[0])
        else:
            by_group.setdefault(group, {})[last] = item
        return None

    file.visititems(visit)
    for attribute, value in file.attrs.items():
        _note_rate(scalars, attribute, value)
    return {group: _gathered(items, scalars) for group, items in _with_clocks(by_group).items()}, []


def _note_rate(scalars: dict[str, float], name: str, value: Any) -> None:
    if is_rate_hz(name) and np.size(value) == 1 and np.asarray(value).dtype.kind in "iuf":
        scalars[name] = float(np.ravel(value)[0])


def _matlab(stored: Source) -> tuple[dict[str, _Arrays], list[str]]:
    """Return the arrays of a MATLAB file up to version 7, those of structs by the struct's name."""
    too_long = TraceError(stored.path, "holds more than 2 GiB of arrays", "save the sensors' arrays alone")
    if stored.size > MOST_BYTES:
        raise too_long
    try:
        groups = read_matlab(Path(str(stored.local)).read_bytes(), MOST_BYTES)
    except TooLongError:
        raise too_long from None
    scalars = {k: float(v) for items in groups.values() for k, v in items.items() if v.ndim == 0}
    arrays = {group: {k: v for k, v in items.items() if v.ndim > 0} for group, items in groups.items()}
    return {group: _gathered(items, scalars) for group, items in _with_clocks(arrays).items()}, []


def _json(stored: Source) -> tuple[dict[str, _Arrays], list[str]]:
    """Return the arrays of one JSON object, those of the objects in it by their paths."""
    by_group, scalars = json_arrays(json_document(stored))
    return {group: _gathered(items, scalars) for group, items in _with_clocks(by_group).items()}, []


def _numpy(stored: Source) -> tuple[dict[str, _Arrays], list[str]]:
    """Return the arrays of an NPZ file, and what its texts say of corrections by the firmware."""
    archive = np.load(str(stored.local), allow_pickle=False)
    items: dict[str, Any] = {}
    texts: dict[str, str] = {}
    names = archive.files[:MOST_ARRAYS]
    if sum(info.file_size for info in archive.zip.infolist()) > MOST_BYTES:
        raise TraceError(stored.path, "holds more than 2 GiB of arrays", "save the sensors' arrays alone")
    for name in names:
        try:
            value = archive[name]
        except ValueError:  # an array of Python objects
            continue
        if value.dtype.kind == "U" and value.ndim == 0:
            texts[name] = str(value)
        items |= _of_numbers(name, value)
    scalars = {k: float(v) for k, v in items.items() if v.size == 1}
    arrays = {k: v for k, v in items.items() if v.size > 1}
    notes = [line for text in texts.values() for line in _firmware(text)]
    return {"": _gathered(arrays, scalars)}, notes


def _of_numbers(name: str, value: Any) -> dict[str, Any]:
    """Return an array of numbers by its name, dates in s; of a structured array its fields, by theirs."""
    if value.dtype.names is not None:
        fields = (_of_numbers(field, value[field]) for field in value.dtype.names)
        return {key: item for found in fields for key, item in found.items()}
    if value.dtype.kind in "mM":
        return {name: value.astype(f"{value.dtype.kind}8[ns]").astype(np.int64) / 1e9}
    if value.dtype.kind in "US" and value.ndim == 1:
        return _of_texts(name, value.astype(str))
    return {name: value} if value.dtype.kind in "iuf" else {}


def _of_texts(name: str, values: Array) -> dict[str, Any]:
    """Return an array of texts by its name; nothing where more than MOST_TEXTS are different."""
    texts = _Texts(values) if values.size > 1 else None
    return {name: texts} if texts is not None and len(texts.words) <= MOST_TEXTS else {}


def _firmware(text: str) -> Iterator[str]:
    """Say what an autopilot's parameters, as JSON, tell of corrections."""
    try:
        parameters = json.loads(text)
    except ValueError:
        return
    if isinstance(parameters, dict):
        from stillcal.replay.formats.logs.dataflash import corrections  # noqa: PLC0415 - a neighbour

        yield from corrections(parameters)


def _gathered(items: Mapping[str, Any], scalars: Mapping[str, float]) -> _Arrays:
    """Return the columns of arrays (n,), (n, 1), (n, k) or (k, n) that share the length that most have."""
    shapes = {name: _oriented(item) for name, item in items.items()}
    gathered = _Arrays(rate_hz=next((v for k, v in scalars.items() if is_rate_hz(k) and v > 0), None))
    gathered.windows = any(len(item.shape) > 2 for item in items.values())
    of_numbers = [shape for name, shape in shapes.items() if not isinstance(items[name], _Texts)]
    lengths = [rows for rows, columns, _ in of_numbers if columns in (1, 3)]
    if not lengths:
        return gathered
    longest = max(lengths)
    near = [n for n in lengths if n >= 0.9 * longest]
    gathered.length = min(near)
    gathered.clocks = frozenset(rows for name, (rows, _, _) in shapes.items() if find_stamps([name]))
    sensors = {name: _sensor_of(name, columns) for name, (_, columns, _) in shapes.items()}
    force, rates = ({shapes[n][0] for n, found in sensors.items() if found is one} for one in Sensor)
    if force and rates and force.isdisjoint(rates):
        gathered.uneven = {name: shapes[name][0] for name, found in sensors.items() if found is not None}
    for name, (rows, columns, transposed) in shapes.items():
        if rows < gathered.length or columns not in (1, 3):
            continue
        if isinstance(items[name], _Texts):
            gathered.words[name] = items[name].words.tolist()
        for i in range(columns):
            gathered.columns[name if columns == 1 else f"{name}[{i}]"] = _slice(items[name], i, transposed)
    return gathered


def _sensor_of(name: str, columns: int) -> Sensor | None:
    """Return the sensor of which an array of that name holds all three axes, or one; None for others."""
    three = [f"{name}[{i}]" for i in range(3)] if columns == 3 else [name[:-1] + axis for axis in "xyz"]
    axes = find_axes(three) if columns == 3 or (columns == 1 and name[-1:].lower() in "xyz") else []
    return axes[0].sensor if axes else None


def _oriented(item: Any) -> tuple[int, int, bool]:
    """Return (rows, columns, whether columns come first) of an array; columns 0 where it is no table."""
    shape = tuple(item.shape)
    if len(shape) == 1:
        return shape[0], 1, False
    if len(shape) == 2:
        first = shape[0] < shape[1] and shape[0] <= 4
        rows, columns = (shape[1], shape[0]) if first else shape
        return int(rows), int(columns), first
    return 0, 0, False


def _slice(item: Any, column: int, transposed: bool) -> Callable[[int, int], Array]:
    def values(first: int, last: int) -> Array:
        if item.ndim == 1:
            return np.asarray(item[first:last])
        return np.asarray(item[column, first:last] if transposed else item[first:last, column])

    return values
