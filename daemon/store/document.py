"""The store's contents: the document, its JSON, its checksum, and the migration of earlier schemas.

Bytes in, document out, and back; no files here (see files.py and store.py).
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

import msgspec
import numpy as np

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.codec import digest, from_plain, jsonable
from stillcal.calib_core.gravity import STANDARD

SCHEMA = 1
FORMAT = "stillcal calibration"
MODEL = "calibrated = scale @ (raw - bias)"
UNITS = {
    "time": "s",
    "force": "m/s^2",
    "rate": "rad/s",
    "temperature": "degC",
    "covariance": "product of units",
}
WIDTH = 110
"""Longest line of a value, columns, before it is split; a list of numbers never is."""

REPAIR = "`stillcal store repair` shows what, and takes it if you say so"
DERIVED = {"checksum", "id"}
"""Values that follow from the others."""

PASSING = ("zeroing", "following")
"""How a calibration becomes current that differs from the one before by what its newest rests show."""

What = Literal["replaced", "rolled_back", "rejected"]


class Fault(StrEnum):
    """Kinds of bad contents."""

    UNREADABLE = "unreadable"
    FOREIGN = "foreign"
    NEWER = "newer"
    CORRUPT = "corrupt"
    INVALID = "invalid"


class StoreFormatError(ValueError):
    """The bytes are not a good store; `fault` says how."""

    def __init__(self, fault: Fault, detail: str) -> None:
        super().__init__(f"{fault}: {detail}")
        self.fault = fault


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HistoryEntry:
    """A calibration that is not current.

    at: sample time (s) at which it was replaced or rejected, None if unknown. It is stored
    without its rests (`states`), which are most of its size: what they showed stays in its covariance,
    residual and counts, and months of history stay quick to write.
    """

    what: What
    reason: str
    at: float | None
    calibration: CalibrationRecord


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StoreDocument:
    """The contents of a store: the current calibration and, oldest first, the others."""

    current: CalibrationRecord | None = None
    history: tuple[HistoryEntry, ...] = ()

    @property
    def blank(self) -> bool:
        """Whether there is neither a calibration nor a history."""
        return self.current is None and not self.history

    def after_publishing(
        self, calibration: CalibrationRecord, limit: int, reason: str = "", at: float | None = None
    ) -> StoreDocument:
        """Return the document with `calibration` current and the one before in the history.

        reason, at: why and when (s) the change was made, else what the calibration says. Publishing the
        same calibration again changes no history, so that a restart may repeat itself. One of PASSING that
        another one replaces is forgotten: rolling back to a stale bias helps nobody, and hourly ones would
        push out every full calibration. So is a zeroing without an accelerometer part, from before the
        first full calibration.
        """
        old = self.current
        if old is None or old.id == calibration.id or _is_forgotten(old, calibration):
            return dataclasses.replace(self, current=calibration)
        why = f"replaced by {calibration.id}: {reason or calibration.acceptance.reason}".rstrip(": ")
        when = calibration.fitted_at if at is None else at
        entry = _entry("replaced", why, when, old)
        return self._with(calibration, entry, limit)

    def after_rejecting(
        self, candidate: CalibrationRecord, reason: str, limit: int, at: float | None = None
    ) -> StoreDocument:
        """Return the document with a rejected candidate in the history, at most once."""
        if any(e.what == "rejected" and e.calibration.id == candidate.id for e in self.history):
            return self
        when = candidate.fitted_at if at is None else at
        return self._with(self.current, _entry("rejected", reason, when, candidate), limit)

    def after_retiring(self, reason: str, limit: int, at: float | None = None) -> StoreDocument:
        """Return the document without a current calibration; the previous one is in the history."""
        if self.current is None:
            return self
        when = self.current.fitted_at if at is None else at
        return self._with(None, _entry("replaced", reason, when, self.current), limit)

    def after_rollback(self, target: int | str, limit: int) -> StoreDocument:
        """Return the document with an earlier calibration current again.

        target: 1 for the one before the current, 2 for the one before that, or an id (or the beginning
        of one). The current one stays in the history as rolled back, which counting skips and an id
        reaches. Raises ValueError where the history holds no such calibration.
        """
        entry = self._find(target)
        reason = f"rolled back from {self.current.id}" if self.current else "rolled back"
        acceptance = dataclasses.replace(entry.calibration.acceptance, how="rollback", reason=reason)
        restored = dataclasses.replace(entry.calibration, acceptance=acceptance)
        rest = dataclasses.replace(self, history=tuple(e for e in self.history if e is not entry))
        if self.current is None:
            return dataclasses.replace(rest, current=restored)
        retired = _entry("rolled_back", f"rolled back to {restored.id}", None, self.current)
        return rest._with(restored, retired, limit)

    def _with(self, current: CalibrationRecord | None, entry: HistoryEntry, limit: int) -> StoreDocument:
        return StoreDocument(current=current, history=bounded((*self.history, entry), limit))

    def _find(self, target: int | str) -> HistoryEntry:
        if isinstance(target, int):
            earlier = [e for e in reversed(self.history) if e.what == "replaced"]
            if not 1 <= target <= len(earlier):
                raise ValueError(
                    f"cannot roll back by {target}: the history holds {len(earlier)} earlier calibrations"
                )
            return earlier[target - 1]
        if not target:
            raise ValueError("an id must have a letter at least: see `stillcal store history`")
        found = [e for e in self.history if e.calibration.id.startswith(target) and e.what != "rejected"]
        ids = {e.calibration.id for e in found}
        if len(ids) != 1:
            problem = f"{len(ids) or 'no'} earlier calibrations"
            raise ValueError(f"{problem} with an id beginning with {target!r}: see `stillcal store history`")
        return found[-1]


def bounded(entries: tuple[HistoryEntry, ...], limit: int) -> tuple[HistoryEntry, ...]:
    """Keep the newest `limit` entries, at most half of them rejected.

    Otherwise a run of rejected candidates would push out every calibration one could roll back to.
    """
    rejected = [e for e in entries if e.what == "rejected"]
    dropped = rejected[: max(0, len(rejected) - limit // 2)]
    return tuple(e for e in entries if not any(e is d for d in dropped))[-limit:]


def calibration_json(record: CalibrationRecord | None) -> dict[str, Any]:
    """Return a calibration as plain values in the published layout, schema and units first."""
    head: dict[str, Any] = {"schema": SCHEMA, "format": FORMAT, "model": MODEL, "units": UNITS}
    if record is None:
        return head | {"id": None, "accelerometer": None, "gyroscope": None, "states": []}
    return {**head, "id": record.id, **jsonable(record)}


def render(document: StoreDocument) -> bytes:
    """Encode a document as indented JSON, its checksum last."""
    value = calibration_json(document.current)
    value["history"] = [
        {
            "what": e.what,
            "id": e.calibration.id,
            "reason": e.reason,
            "at": e.at,
            "calibration": jsonable(e.calibration),
        }
        for e in document.history
    ]
    value["checksum"] = checksum(value)
    return (pretty(value) + "\n").encode()


def checksum(value: dict[str, Any]) -> str:
    """Return the SHA-256 of all but the checksum, as canonical JSON (sorted keys, no spaces)."""
    return "sha256:" + digest({key: item for key, item in value.items() if key != "checksum"})


def parse(data: bytes, trusted: bool = False) -> tuple[StoreDocument, int]:
    """Decode a store of this schema or an earlier one; returns the document and the schema it came in.

    trusted: take it even where its checksum does not match, because a person says so. Raises StoreFormatError
    where it is not whole, not ours, or from a later version.
    """
    value = _decoded(data)
    schema = _schema(value)
    if schema >= 1 and not trusted and value.get("checksum") != checksum(value):
        raise StoreFormatError(Fault.CORRUPT, f"the checksum does not match: changed after writing; {REPAIR}")
    try:
        for step in range(schema, SCHEMA):
            value = MIGRATIONS[step](value)
        return _document(value), schema
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise StoreFormatError(Fault.INVALID, f"{error}".replace("\n", " ")) from error


def differences(before: StoreDocument, after: StoreDocument) -> list[str]:
    """Return every value in which two documents differ, a line each: where, what it was, what it is."""
    old, new = (dict(_leaves(json.loads(render(document)))) for document in (before, after))
    places = [place for place in {**old, **new} if place not in DERIVED]
    return [
        f"{place}: {old.get(place, 'nothing')} -> {new.get(place, 'nothing')}"
        for place in places
        if old.get(place) != new.get(place)
    ]


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """Yield each value within a JSON value, as JSON, with the path to it; a list of numbers is one value."""
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, dict):
        items = ((f"{place}.{key}".lstrip("."), item) for key, item in value.items())
    elif isinstance(value, list) and any(isinstance(item, dict) for item in value):
        items = ((f"{place}[{index}]", item) for index, item in enumerate(value))
    else:
        yield place, json.dumps(value)
    for where, item in items:
        yield from _leaves(item, where)


def pretty(value: Any, indent: int = 0, lead: int = 0) -> str:
    """Encode plain values as readable JSON: one key per line; vectors and short values on one line.

    lead: columns of the key before the value.
    """
    items = list(value.values()) if isinstance(value, dict) else value
    if not isinstance(items, list) or not any(isinstance(item, dict | list) for item in items):
        line = json.dumps(value, allow_nan=False)
        if not isinstance(value, dict) or indent + lead + len(line) <= WIDTH:
            return line
    keys = [f"{json.dumps(key)}: " for key in value] if isinstance(value, dict) else [""] * len(value)
    parts = [key + pretty(item, indent + 2, len(key)) for key, item in zip(keys, items, strict=True)]
    opened, closed = "{}" if isinstance(value, dict) else "[]"
    line = opened + ", ".join(parts) + closed
    if indent > 0 and "\n" not in line and indent + lead + len(line) <= WIDTH:
        return line
    pad = "\n" + " " * (indent + 2)
    return f"{opened}{pad}{(',' + pad).join(parts)}{pad[:-2]}{closed}"


def _is_forgotten(old: CalibrationRecord, new: CalibrationRecord) -> bool:
    """Tell whether the history leaves out a calibration that another one replaces."""
    if old.acceptance.how not in PASSING:
        return False
    return new.acceptance.how in PASSING or old.accelerometer is None


def _entry(what: What, reason: str, at: float | None, calibration: CalibrationRecord) -> HistoryEntry:
    bare = dataclasses.replace(calibration, states=())
    return HistoryEntry(what=what, reason=reason, at=at, calibration=bare)


def _decoded(data: bytes) -> dict[str, Any]:
    try:
        value = msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise StoreFormatError(Fault.UNREADABLE, f"not JSON: {error}") from error
    if not isinstance(value, dict):
        raise StoreFormatError(Fault.FOREIGN, "JSON, but not a stillcal store")
    return value


def _schema(value: dict[str, Any]) -> int:
    schema = value.get("schema", 0 if {"accel", "gyro"} & value.keys() else None)
    if isinstance(schema, bool) or not isinstance(schema, int) or schema < 0:
        raise StoreFormatError(Fault.FOREIGN, "JSON, but not a stillcal store")
    if schema > SCHEMA and "checksum" in value:  # without one it is another document, such as a diagnosis
        detail = f"written by a later stillcal: schema {schema}, this version reads up to {SCHEMA}"
        raise StoreFormatError(Fault.NEWER, detail)
    if schema == 0 and "checksum" in value:
        detail = "schema 0, which had no checksum, with one: changed or damaged after writing"
        raise StoreFormatError(Fault.CORRUPT, detail)
    if schema >= 1 and not {"accelerometer", "gyroscope", "checksum"} <= value.keys():
        raise StoreFormatError(Fault.FOREIGN, "JSON, but not a stillcal store")
    return schema


def _document(value: dict[str, Any]) -> StoreDocument:
    if value["units"] != UNITS:
        raise ValueError(f"units are {value['units']}, expected {UNITS}")
    calibrated = any(value[sensor] is not None for sensor in ("accelerometer", "gyroscope"))
    return StoreDocument(
        current=from_plain(value, CalibrationRecord) if calibrated else None,
        history=from_plain(value["history"], tuple[HistoryEntry, ...]),
    )


def _from_schema_0(value: dict[str, Any]) -> dict[str, Any]:
    """Migrate {"accel": {"S": 3x3, "b": [3]}, "gyro": {"S": 3x3, "b": [3]}}; either may be absent.

    Calibrated = S (raw - b), m/s^2 and rad/s. It recorded neither gravity nor evidence: gravity becomes
    the standard one that such a fit would have used, evidence is unknown, and the parameters are the
    fewest that give such a matrix.
    """
    parts = {new: value.get(old) for new, old in (("accelerometer", "accel"), ("gyroscope", "gyro"))}
    sensors: dict[str, Any] = {
        name: part and {"scale": part["S"], "bias": part["b"], "parameters": fewest_parameters(part["S"])}
        for name, part in parts.items()
    }
    if sensors["accelerometer"]:
        sensors["accelerometer"]["gravity"] = STANDARD
    acceptance = {"how": "migration", "reason": "from a store of schema 0"}
    return {"schema": 1, "units": UNITS, **sensors, "acceptance": acceptance, "history": []}


MIGRATIONS: dict[int, Callable[[dict[str, Any]], dict[str, Any]]] = {0: _from_schema_0}
"""The migration from each earlier schema to the next."""


def fewest_parameters(scale: Any) -> int:
    """Return the size of the smallest model that gives this scale matrix: 6, 9 or 12 (bias included)."""
    matrix = np.asarray(scale, dtype=np.float64)
    if np.array_equal(matrix, np.diag(np.diag(matrix))):
        return 6
    shaped = (matrix.T, np.triu(matrix), np.tril(matrix))
    return 9 if any(np.array_equal(matrix, like) for like in shaped) else 12
