"""The files beside a recording: NAME.json, the maker's claims, and NAME.events.jsonl, the events."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeAlias

import msgspec

from stillcal.calib_core.gravity import STANDARD, LocationError, given
from stillcal.calib_core.streams.events import Charging, Location
from stillcal.calib_core.streams.limits import check_ranges
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import NotRegularError, TooLargeError, read_regular
from stillcal.replay.formats.errors import TraceError

MOST_BYTES = 1 << 30
"""Longest file beside a recording that is read."""

MOST_BYTES_OF_CLAIMS = 1 << 20
"""A longer one holds no claims."""

PerAxis: TypeAlias = float | tuple[float, float, float]


class Claims(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the maker claims of a device: SI units, densities per sqrt(Hz); None where it is not given.

    accel_unit, gyro_unit: nominal SI value of one count where the recording holds raw counts, accel_zero
    and gyro_zero the counts taken off first; one value, or one an axis. Fields not known are ignored.
    """

    device: str | None = None
    nominal_rate_hz: float | None = None
    gravity: float | None = None
    accel_range: float | None = None
    gyro_range: float | None = None
    accel_lsb: float | None = None
    gyro_lsb: float | None = None
    accel_noise_density: float | None = None
    gyro_noise_density: float | None = None
    accel_unit: PerAxis | None = None
    gyro_unit: PerAxis | None = None
    accel_zero: PerAxis | None = None
    gyro_zero: PerAxis | None = None

    def without_counts(self) -> Claims:
        """Return the claims as they hold once the values are in SI units."""
        return msgspec.structs.replace(self, accel_unit=None, gyro_unit=None, accel_zero=None, gyro_zero=None)

    def without_noise(self) -> Claims:
        """Return the claims as they hold once noise has been removed."""
        return msgspec.structs.replace(self, accel_noise_density=None, gyro_noise_density=None)

    def counts(self, sensor: Sensor) -> tuple[PerAxis | None, PerAxis | None]:
        """Return (SI value of one count, zero in counts) claimed for a sensor."""
        if sensor is Sensor.ACCELEROMETER:
            return self.accel_unit, self.accel_zero
        return self.gyro_unit, self.gyro_zero


class _Written(msgspec.Struct):
    """The field by which a file of stillcal is recognised."""

    schema: int | None = None


Event: TypeAlias = Charging | Location
NO_JSON = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
"""What decoding raises on what is no JSON of the kind that is asked for, or is too deep."""

_MOST_WRITTEN = 1 << 26
"""Bytes: nothing that a command writes as JSON is longer."""

_LONGEST_LIST = 16
_json = json.JSONDecoder()
_KNOWN: dict[str, type[Charging] | type[Location]] = {"charging": Charging, "location": Location}


def beside(path: Path, suffix: str) -> Path:
    """Return the path of a file beside a recording: NAME.csv or NAME.csv.gz -> NAME + `suffix`."""
    plain = path.with_suffix("") if path.suffix == ".gz" else path
    return plain.parent / (plain.stem + suffix)


def read_claims(path: Path) -> Claims:
    """Read NAME.json beside the recording `path`; no claims where there is none. Raises TraceError.

    Other JSON of that name claims nothing of the device: a calibration, or a recording.
    """
    file = beside(path, ".json")
    text = None if file.name == path.name.removesuffix(".gz") else claims_text(file)
    if text is None:
        return Claims()
    try:
        return msgspec.json.decode(text, type=Claims)
    except NO_JSON as error:
        raise TraceError(file, f"not the maker's claims: {error}", "correct the field it names") from None


def claims_text(file: Path) -> bytes | None:
    """Return what a file of the maker's claims holds: one object with a field of them, or damaged JSON.

    None where there is no file, and where it holds other JSON or more than claims do. Raises TraceError.
    """
    try:
        text = _bytes_of(file, MOST_BYTES_OF_CLAIMS)
    except TooLargeError:
        return None
    try:
        first, _ = _json.raw_decode((text or b"[]").decode().lstrip())
    except (ValueError, RecursionError):
        return text
    return text if _may_be_claims(first) else None


def holds_claims(file: Path) -> bool:
    """Whether a file holds the maker's claims, whole. Raises TraceError where it cannot be read."""
    text = claims_text(file)
    try:
        return text is not None and msgspec.json.decode(text, type=Claims) is not None
    except NO_JSON:
        return False


def _may_be_claims(value: Any) -> bool:
    """Whether a value is an object with a field of claims, or none, without samples and a schema's number."""
    if not isinstance(value, dict) or "schema" in value or _holds_samples(value):
        return False
    return not value or not value.keys().isdisjoint(Claims.__struct_fields__)


def _holds_samples(value: Any) -> bool:
    """Whether a value holds a list longer than any of claims."""
    if isinstance(value, dict):
        return any(map(_holds_samples, value.values()))
    return isinstance(value, list) and len(value) > _LONGEST_LIST


def claimed_gravity(claims: Claims, events: Iterable[Event], path: Path) -> float | None:
    """Return the local gravity, m/s^2, that the maker claims, unless an event says where the phone was.

    None where nothing is claimed, or the standard value, which people write who do not know their own.
    path: of the recording. Raises TraceError where the claim is no gravity of the Earth's.
    """
    claimed = claims.gravity
    located = any(isinstance(event, Location) for event in events)
    if claimed is None or located or claimed == STANDARD:
        return None
    try:
        return given(claimed).value
    except LocationError as error:
        raise TraceError(beside(path, ".json"), str(error), "correct it or leave it out") from error


def written_by_stillcal(path: Path) -> bool:
    """Whether a file is JSON with the number of a schema, as stores, calibrations and diagnoses have."""
    try:
        return msgspec.json.decode(read_regular(path, _MOST_WRITTEN), type=_Written).schema is not None
    except (OSError, *NO_JSON):
        return False


def read_events(path: Path) -> list[Event]:
    """Read NAME.events.jsonl beside the recording `path`, in time order; events of other kinds are skipped.

    Raises TraceError naming the line that is not an event.
    """
    file = beside(path, ".events.jsonl")
    try:
        text = _bytes_of(file)
    except TooLargeError:
        raise TraceError(file, "is too long for events", "delete it or name it otherwise") from None
    if text is None:
        return []
    events = [_event(file, number, line) for number, line in enumerate(text.split(b"\n"), 1) if line.strip()]
    return sorted((event for event in events if event is not None), key=lambda event: event.t)


def plausible_event(event: Event) -> Event:
    """Return an event as it is. Raises ValueError where a number cannot be, such as a latitude of 91."""
    check_ranges(msgspec.structs.asdict(event))
    return event


def event_line(event: Event) -> bytes:
    """Return the line of NAME.events.jsonl for `event`."""
    fields = {name: value for name, value in msgspec.structs.asdict(event).items() if value is not None}
    return msgspec.json.encode({"t": event.t, "event": type(event).__name__.lower(), **fields}) + b"\n"


def _event(file: Path, number: int, line: bytes) -> Event | None:
    try:
        fields = msgspec.json.decode(line, type=dict[str, Any])
        kind = _KNOWN.get(fields.pop("event", None))
        return None if kind is None else plausible_event(msgspec.convert(fields, kind))
    except (ValueError, TypeError, RecursionError) as error:
        raise TraceError(file, f"not an event: {error}", "correct or delete that line", number) from None


def _bytes_of(file: Path, limit: int = MOST_BYTES) -> bytes | None:
    """Return what a file holds, None where there is none. Raises TooLargeError, and TraceError."""
    try:
        return read_regular(file, limit)
    except FileNotFoundError:
        return None
    except TooLargeError:
        raise
    except NotRegularError:
        raise TraceError(file, "is no regular file", "replace or remove it") from None
    except OSError as error:
        raise TraceError(
            file, f"cannot be read ({error.strerror or error})", "check its permissions"
        ) from None
