"""The settings: sections read from TOML, checked, with errors that name file, line and key.

A section belongs to the module that uses it; this one puts them together, reads the file and explains
what is wrong with it. config/default.toml documents every setting and its default, the same as in the code:
first those that a user needs, then those that are rarely needed. A file cannot change what FIXED names.
"""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.errors import TryAgainError, UserError
from stillcal.daemon.store.store import StoreSettings
from stillcal.daemon.system.files import NoWriterError, input_name, passing, read_input

T = TypeVar("T")

MAX_BYTES = 2**20
"""Of a settings file."""


_DETECTOR, _FIT = ("engine", "detector"), ("engine", "calibrate", "accelerometer")
_ANGLE = "5 degrees, one number for the pool and for the fit, which count the same attitudes"
_SOLVER = "it decides how fast the fit converges, not where"

FIXED: dict[tuple[str, ...], str] = {
    (*_DETECTOR, "mode"): "the engine switches between scanning and probing by itself",
    (*_DETECTOR, "half_life_s"): "the noise floor is only tested with this memory",
    (*_DETECTOR, "cluster_windows"): "the noise floor is only tested with clusters of this size",
    (*_DETECTOR, "cluster_share"): "the noise floor is only tested with clusters of this size",
    ("engine", "pool", "attitude_angle"): _ANGLE,
    (*_FIT, "attitude_angle"): _ANGLE,
    ("engine", "calibrate", "folds"): "more parts cost time and change no verdict",
    (*_FIT, "rounds"): _SOLVER,
    (*_FIT, "damping"): _SOLVER,
    ("engine", "calibrate", "gyroscope", "tolerance"): _SOLVER,
    ("engine", "calibrate", "gyroscope", "max_iterations"): _SOLVER,
}
"""What a file may not change, and why. A file that repeats the default is accepted: older ones named all."""


class SettingsError(UserError):
    """The settings cannot be used; the message names file, line, key and remedy."""


@dataclass(frozen=True, slots=True)
class SourceSettings:
    """Where the samples come from.

    kind: "serial" for a phone on a line, "iio" for the machine's own sensors as the kernel has them.
    port: the serial device's path, or a pattern of such paths; of iio the folder of devices, "" for the
    kernel's. baud: symbols per s on a real line. retry_max_s: longest pause between two attempts to open
    it. rate_hz: what the phone is asked to sample at, 0 for its own rate.
    """

    kind: Literal["serial", "iio"] = "serial"
    port: str = ""
    baud: int = 115200
    retry_max_s: float = 5.0
    rate_hz: float = 0.0

    def __post_init__(self) -> None:
        if not 1200 <= self.baud <= 4_000_000:
            raise ValueError(f"baud = {self.baud}: must be within 1200..4000000")
        if not 0.1 <= self.retry_max_s <= 3600:
            raise ValueError(f"retry_max_s = {self.retry_max_s}: must be within 0.1..3600 s")
        if not 0 <= self.rate_hz <= 10_000:
            raise ValueError(f"rate_hz = {self.rate_hz}: must be within 0..10000 Hz")


@dataclass(frozen=True, slots=True)
class SocketSettings:
    """The socket, and limits for its clients.

    path: "" for the service's runtime folder. mode: permissions. group: of the system, to which the socket
    belongs; "" for the daemon's own. connections: open at once; a further one takes the place of the one that
    has been idle longest. message_bytes: of one question. calls_per_s: of one client, above which it waits.
    stall_s: a client that takes so long to finish a question or to take an answer is dropped.
    """

    path: str = ""
    mode: int = 0o660
    group: str = ""
    connections: int = 128
    message_bytes: int = 262_144
    calls_per_s: float = 100.0
    stall_s: float = 10.0

    def __post_init__(self) -> None:
        if not 0o600 <= self.mode <= 0o666 or self.mode & 0o111:
            raise ValueError(f"mode = 0o{self.mode:o}: must be within 0o600..0o666, not executable")
        if not 1 <= self.connections <= 4096:
            raise ValueError(f"connections = {self.connections}: must be within 1..4096")
        if not 1024 <= self.message_bytes <= 2**24:
            raise ValueError(f"message_bytes = {self.message_bytes}: must be within 1024..16777216")
        if not 1 <= self.calls_per_s <= 1e6:
            raise ValueError(f"calls_per_s = {self.calls_per_s}: must be within 1..1e6")
        if not 0.1 <= self.stall_s <= 3600:
            raise ValueError(f"stall_s = {self.stall_s}: must be within 0.1..3600 s")


@dataclass(frozen=True, slots=True)
class PublishSettings:
    """Where corrected samples go besides the socket.

    to: "uinput" for an input device, "iio" for the registers of this machine's own sensors, and paths that
    end in .mcap.
    """

    to: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for target in self.to:
            if target not in {"uinput", "iio"} and not target.endswith(".mcap"):
                raise ValueError(f'to = {target!r}: must be "uinput", "iio" or a path that ends in .mcap')
        if len(set(self.to)) < len(self.to):
            raise ValueError(f"to = {list(self.to)}: names a target twice")


@dataclass(frozen=True, slots=True)
class LogSettings:
    """The log. level: the least that is logged."""

    level: Literal["debug", "info", "warning", "error"] = "info"


@dataclass(frozen=True, slots=True)
class DiagnosisSettings:
    """The self-diagnosis. at_night: whether there is one.

    It begins once the phone has been on the charger for charging_s, and every_s after the one before.
    processor_s, memory_mib: its budget; it is ended where it takes more.
    """

    at_night: bool = True
    charging_s: float = 3600.0
    every_s: float = 72_000.0
    processor_s: float = 60.0
    memory_mib: float = 384.0

    def __post_init__(self) -> None:
        for name in ("charging_s", "every_s"):
            if not 0 <= getattr(self, name) <= 1e7:
                raise ValueError(f"{name} = {getattr(self, name)}: must be within 0..1e7 s")
        if not 0 < self.processor_s <= 3600:
            raise ValueError(f"processor_s = {self.processor_s}: must be above 0, at most 3600 s")
        if not 0 < self.memory_mib <= 1e6:
            raise ValueError(f"memory_mib = {self.memory_mib}: must be above 0, at most 1e6 MiB")


@dataclass(frozen=True, slots=True)
class Settings:
    """All sections, one per table of the TOML file."""

    engine: EngineSettings = field(default_factory=EngineSettings)
    store: StoreSettings = field(default_factory=StoreSettings)
    source: SourceSettings = field(default_factory=SourceSettings)
    socket: SocketSettings = field(default_factory=SocketSettings)
    publish: PublishSettings = field(default_factory=PublishSettings)
    log: LogSettings = field(default_factory=LogSettings)
    diagnosis: DiagnosisSettings = field(default_factory=DiagnosisSettings)


def load_settings(path: Path | str | None = None) -> Settings:
    """Read settings from a TOML file ("-": standard input); what it leaves out, or no file, is the default.

    Raises SettingsError on a file that cannot be read, is not TOML, names an unknown key, or gives a
    value of the wrong type or out of its range, and TryAgainError where the system cannot read it now.
    """
    if path is None:
        return Settings()
    name = input_name(path)
    try:
        text = read_input(path, MAX_BYTES).decode("utf-8")
    except UnicodeDecodeError as error:
        raise SettingsError(f"{name}: not UTF-8 text: give the path of a TOML file") from error
    except OSError as error:
        if passing(error):
            raise TryAgainError(f"{name}: {error.strerror}") from error
        remedy = "" if isinstance(error, NoWriterError) else ": give the path of a TOML file"
        raise SettingsError(f"{name}: {error.strerror}{remedy}") from error
    return parse_settings(text, name)


def parse_settings(text: str, name: str = "settings") -> Settings:
    """Read settings from TOML text; `name` is what errors call it. Raises SettingsError."""
    try:
        return _section(Settings, tomllib.loads(text), ())
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"at line (\d+)", str(error))
        last = len(text.splitlines())
        raise SettingsError(f"{name}:{line[1] if line else last}: not TOML: {error}") from error
    except _BadKeyError as error:
        line_number = line_of(text, error.keys)
        where = f"{name}:{line_number}" if line_number else name
        raise SettingsError(f"{where}: {error}") from error


def store_path(settings: StoreSettings, environ: Mapping[str, str]) -> Path:
    """Return the store's path: as set, else store.json in the service's or the user's state folder.

    systemd names the service's (STATE_DIRECTORY); the user's is XDG_STATE_HOME or ~/.local/state.
    """
    if settings.path:
        return Path(settings.path)
    if service := environ.get("STATE_DIRECTORY"):
        return Path(service.split(":")[0]) / "store.json"
    home = environ.get("XDG_STATE_HOME") or Path(environ.get("HOME", "/")) / ".local" / "state"
    return Path(home) / "stillcal" / "store.json"


def line_of(text: str, keys: tuple[str, ...]) -> int | None:
    """Return the line, from 1, where TOML text sets the key or, failing that, opens a table above it."""
    lines = {keys_there: number for number, keys_there in reversed(list(_keys_by_line(text)))}
    for length in range(len(keys), 0, -1):
        if keys[:length] in lines:
            return lines[keys[:length]]
    return None


class _BadKeyError(ValueError):
    """A value cannot be used; `keys` is the path to it."""

    def __init__(self, keys: tuple[str, ...], problem: str) -> None:
        *tables, key = keys
        named = problem if problem.startswith(key) else f"{key} {problem}"
        super().__init__(f"[{'.'.join(tables)}] {named}" if tables else named)
        self.keys = keys


def _section(kind: type[T], table: Any, keys: tuple[str, ...]) -> T:
    if not isinstance(table, dict):
        raise _BadKeyError(keys, f"= {table!r}: must be a table, [{'.'.join(keys)}]")
    hints = get_type_hints(kind)
    for key in (key for key in table if key not in hints):
        raise _BadKeyError(
            (*keys, key), f"is not a {'setting' if keys else 'section'}: {_suggestion(key, list(hints))}"
        )
    values = {key: _value(hints[key], value, (*keys, key)) for key, value in table.items()}
    try:
        section = kind(**values)
    except ValueError as error:
        blamed = next((key for key in values if re.search(rf"\b{key}\b", str(error))), None)
        raise _BadKeyError((*keys, blamed) if blamed else keys, str(error)) from error
    _refuse_fixed(kind(), values, keys)
    return section


def _refuse_fixed(default: object, values: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    for key, value in values.items():
        reason = FIXED.get((*keys, key))
        if reason is not None and value != getattr(default, key):
            raise _BadKeyError((*keys, key), f"is no setting any more ({reason}): remove it")


def _value(hint: Any, value: Any, keys: tuple[str, ...]) -> Any:
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return _section(hint, value, keys)
    if isinstance(value, float) and math.isnan(value):
        raise _BadKeyError(keys, "= nan: must be a number")
    try:
        return msgspec.convert(value, type=hint)
    except msgspec.ValidationError as error:
        raise _BadKeyError(
            keys, f"= {value!r}: must be {_allowed(hint) or _expected_type(str(error))}"
        ) from error


def _allowed(hint: Any) -> str:
    """Return the values of a choice in words; empty for other types."""
    is_choice = isinstance(hint, type) and issubclass(hint, StrEnum)
    choices = [str(member) for member in hint] if is_choice else get_args(hint)
    return f"one of {', '.join(map(repr, choices))}" if is_choice or get_origin(hint) is Literal else ""


def _expected_type(problem: str) -> str:
    """Turn "Expected `int`, got `str` - at `$`" into "int"."""
    return problem.removeprefix("Expected ").split(", got")[0].replace("`", "")


def _suggestion(key: str, known: list[str]) -> str:
    import difflib  # noqa: PLC0415 - only for a mistake; the daemon would hold it for months

    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    return f"did you mean {close[0]}?" if close else f"known are {', '.join(known)}"


def _keys_by_line(text: str) -> Iterator[tuple[int, tuple[str, ...]]]:
    table: tuple[str, ...] = ()
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[\[?\s*([^\[\]]+?)\s*\]", line):
            table = _parts(header[1])
            yield number, table
        elif assigned := re.match(r"\s*([\w.\-\"' ]+?)\s*=", line):
            yield number, table + _parts(assigned[1])


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip(" \"'") for part in dotted.split("."))
