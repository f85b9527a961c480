"""What a daemon is given from outside, and the settings that come of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from socket import socket as Socket  # noqa: N812 - `socket` is a setting here
from typing import Any, TypeVar

from stillcal.daemon.settings import Settings, SettingsError, SocketSettings, SourceSettings, load_settings
from stillcal.daemon.sources.base import SerialSettings
from stillcal.daemon.sources.sysfs import DEVICES
from stillcal.daemon.store.store import StoreSettings

Part = TypeVar("Part", SourceSettings, StoreSettings, SocketSettings)


@dataclass(frozen=True, slots=True)
class LaunchOptions:
    """What was given from outside. config: the settings file, read again on SIGHUP.

    port, store, socket: stand in for the file's, where they are given. passed: sockets systemd opened.
    """

    config: Path | None = None
    port: str | None = None
    store: str | None = None
    socket: str | None = None
    passed: Sequence[Socket] = ()

    def settings(self) -> Settings:
        """Read the settings. Raises SettingsError where they cannot serve."""
        from_file = load_settings(self.config)
        settings = replace(
            from_file,
            source=_with(from_file.source, port=self.port),
            store=_with(from_file.store, path=self.store),
            socket=_with(from_file.socket, path=self.socket),
        )
        serial_settings(settings)
        return settings


def serial_settings(settings: Settings) -> SerialSettings:
    """Return the line's settings, or how the machine's own sensors are looked for.

    Raises SettingsError where no device is named or they make no sense.
    """
    source = settings.source
    port = source.port or (DEVICES if source.kind == "iio" else "")
    if not port:
        raise SettingsError("[source] port is not set: name the phone's serial device, such as /dev/ttyACM0")
    return SerialSettings(port, source.baud, retry_max_s=source.retry_max_s)


def _with(part: Part, **overrides: Any) -> Part:
    return replace(part, **{name: value for name, value in overrides.items() if value is not None})


def needs_restart(old: Settings, new: Settings) -> list[str]:
    """Return the names of what has changed and cannot change while running."""
    changed = {
        "[store] path": (old.store.path, new.store.path),
        "[socket] path": (old.socket.path, new.socket.path),
        "[socket] mode": (old.socket.mode, new.socket.mode),
    }
    return [name for name, (before, after) in changed.items() if before != after]
