"""The options that a daemon is started with, and the settings that follow from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from socket import socket as Socket  # noqa: N812 - `socket` is a setting here
from typing import Any, TypeVar

from stillcal.daemon.settings import (
    PublishSettings,
    Settings,
    SettingsError,
    SocketSettings,
    SourceSettings,
    load_settings,
)
from stillcal.daemon.sources.base import SerialSettings
from stillcal.daemon.sources.sysfs import DEVICES
from stillcal.daemon.store.store import StoreSettings
from stillcal.daemon.system.files import input_name, is_read_once
from stillcal.daemon.system.printable import is_utf8

Part = TypeVar("Part", SourceSettings, StoreSettings, SocketSettings, PublishSettings)


@dataclass(frozen=True, slots=True)
class LaunchOptions:
    """The command line's options and systemd's sockets. config: the settings file, read again on SIGHUP.

    port, store, socket, socket_group, publish: override the file where they are given. passed: sockets that
    systemd opened.
    """

    config: Path | None = None
    port: str | None = None
    store: str | None = None
    socket: str | None = None
    passed: Sequence[Socket] = ()
    publish: tuple[str, ...] = ()
    socket_group: str | None = None

    def settings(self) -> Settings:
        """Read the settings file and apply the options. Raises SettingsError."""
        self._refuse_odd_bytes()
        from_file = load_settings(self.config)
        try:
            publish = _with(from_file.publish, to=self.publish or None)
        except ValueError as error:
            raise SettingsError(f"--publish: {error}") from None
        settings = replace(
            from_file,
            source=_with(from_file.source, port=self.port),
            store=_with(from_file.store, path=self.store),
            socket=_with(from_file.socket, path=self.socket, group=self.socket_group),
            publish=publish,
        )
        serial_settings(settings)
        if "iio" in settings.publish.to and settings.source.kind != "iio":
            what = "publishing to iio writes to this machine's own sensors"
            raise SettingsError(f'{what}: set kind = "iio" under [source], or leave it out')
        return settings

    def settings_again(self) -> Settings:
        """Read the settings file once more. Raises SettingsError, also where it was a pipe."""
        if self.config is not None and is_read_once(self.config):
            name = input_name(self.config)
            raise SettingsError(f"{name} can be read only once: restart the daemon, or give it a file")
        return self.settings()

    def _refuse_odd_bytes(self) -> None:
        """Raise SettingsError where an option is no UTF-8: it could be neither answered nor stored."""
        for option in (self.port, self.store, self.socket, self.socket_group, *self.publish):
            if not is_utf8(option or ""):
                raise SettingsError(f"{option!a}: is no UTF-8 text: give another name")


def serial_settings(settings: Settings) -> SerialSettings:
    """Return the settings of the serial line, or of the search for the machine's own sensors.

    Raises SettingsError where no device is named or a value is out of range.
    """
    source = settings.source
    port = source.port or (DEVICES if source.kind == "iio" else "")
    if not port:
        raise SettingsError("[source] port is not set: name the phone's serial device, such as /dev/ttyACM0")
    return SerialSettings(port, source.baud, retry_max_s=source.retry_max_s)


def _with(part: Part, **overrides: Any) -> Part:
    return replace(part, **{name: value for name, value in overrides.items() if value is not None})


def needs_restart(old: Settings, new: Settings) -> list[str]:
    """Return the names of the changed settings that take effect at a restart only."""
    changed = {
        "[store] path": (old.store.path, new.store.path),
        "[socket] path": (old.socket.path, new.socket.path),
        "[socket] mode": (old.socket.mode, new.socket.mode),
        "[socket] group": (old.socket.group, new.socket.group),
        "[publish] to": (old.publish.to, new.publish.to),
    }
    return [name for name, (before, after) in changed.items() if before != after]
