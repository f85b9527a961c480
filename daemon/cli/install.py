"""`stillcal install-service`: install the systemd units, the udev rule and a first settings file."""

from __future__ import annotations

import importlib.resources
import json
import os
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import click

from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.settings import SettingsError
from stillcal.daemon.store.atomic import write_atomically
from stillcal.daemon.system.files import make_folder
from stillcal.daemon.system.printable import is_utf8
from stillcal.daemon.varlink.socket import group_id

SHIPPED = "/usr/local/bin/stillcal"
"""The path of the command in the shipped unit, which installing replaces."""

PLACES = {
    "stillcal.service": "etc/systemd/system",
    "stillcal.socket": "etc/systemd/system",
    "70-stillcal.rules": "etc/udev/rules.d",
}
IIO_PLACES = {
    "stillcal-iio.conf": "etc/systemd/system/stillcal.service.d",
    "71-stillcal-iio.rules": "etc/udev/rules.d",
}
"""What the machine's own sensors take besides: their files in /sys may be written."""

UINPUT_PLACES = {
    "stillcal-uinput.conf": "etc/systemd/system/stillcal.service.d",
    "71-stillcal-uinput.rules": "etc/udev/rules.d",
    "stillcal-uinput-module.conf": "etc/modules-load.d",
}
"""What an input device takes besides: the module, /dev/uinput, and readers who are logged in."""

LINE_GROUPS = ("dialout", "uucp")
"""Groups to which systems give their serial lines: most, then Arch and SteamOS. The first is shipped."""

INPUT_GROUP = "input"
"""The group of /dev/uinput in the shipped files, which systemd makes on every system."""

PUBLISH_UINPUT = 'publish.to = ["uinput"]'
"""The setting by which the daemon makes the input device."""

SHIPPED_MODE = "SocketMode=0660"

DEFAULT_PORT = "/dev/ttyACM0"
UNREACHABLE = {"ProtectHome": ("/home", "/root", "/run/user"), "PrivateTmp": ("/tmp", "/var/tmp")}
"""Settings of the unit, and the folders that they hide from the service."""

UNRUNNABLE = re.compile(r"[\x00-\x1f\x7f\"'\\]")
"""What systemd refuses in the path of a command, also within quotes."""

SETTINGS = Path("etc/stillcal/stillcal.toml")


@click.command(
    "install-service",
    epilog=examples(
        "sudo stillcal install-service --port '/dev/serial/by-id/*'",
        "sudo systemctl daemon-reload && sudo systemctl enable --now stillcal.socket stillcal.service",
        "stillcal install-service --print",
    ),
)
@click.option("--port", help="The phone's serial device or a pattern; without it, /dev/ttyACM0.")
@click.option(
    "--iio", is_flag=True, help="This machine is the phone: read its own sensors, as the kernel has them."
)
@click.option("--uinput", is_flag=True, help="Also show the corrected sensors as an input device.")
@click.option(
    "--group",
    help="Group to which the phone's line and the sensors' files belong "
    "[default: dialout, or uucp where there is no dialout].",
)
@click.option(
    "--socket-group",
    help="Group of the system whose members may connect to the daemon's socket [default: that of --group].",
)
@click.option("--all-users", is_flag=True, help="Every user of this machine may connect to the socket.")
@click.option("--root", type=click.Path(path_type=Path), default=Path("/"), help="Install below this folder.")
@click.option("--print", "only_print", is_flag=True, help="Print the files, change nothing.")
def install_command(  # noqa: PLR0917 - click hands every option over by name
    port: str | None,
    iio: bool,
    uinput: bool,
    group: str | None,
    socket_group: str | None,
    all_users: bool,
    root: Path,
    only_print: bool,
) -> None:
    """Install the systemd service.

    Units go to /etc/systemd/system, udev rules to /etc/udev/rules.d, and settings to
    /etc/stillcal/stillcal.toml unless there are some. Nothing is started.
    """
    if all_users and socket_group is not None:
        raise click.UsageError("--all-users lets everybody connect: leave out --socket-group")
    if iio and port is not None:
        raise click.UsageError("--iio reads this machine's own sensors: leave out --port")
    _refuse_odd_names(port)
    if not only_print:
        for path in (_command(), port or DEFAULT_PORT):
            _warn_unreachable(path)
    group = _line_group() if group is None else group
    access = Access(group, group if socket_group is None else socket_group, all_users)
    here = not only_print and root == Path("/")
    _check_group("--group", access.group, here)
    _check_group("--socket-group", access.socket_group, here)
    if uinput:
        _check_group("--uinput", INPUT_GROUP, here)
    for place, text in files(port or DEFAULT_PORT, access, iio=iio, uinput=uinput):
        target = root / place
        if only_print:
            click.echo(f"# /{place}\n{text}")
        elif place == SETTINGS and target.exists():
            click.echo(f"{target}: exists, not changed{_lacking(target, uinput)}")
        else:
            _write(target, text)
            click.echo(f"{target}: written")
    if not only_print:
        _say_what_is_next(uinput)


@dataclass(frozen=True, slots=True)
class Access:
    """Who may do what. group: of the phone's line and the sensors' files, and so of the daemon.

    socket_group: whose members may connect to the socket; all_users: all may.
    """

    group: str = LINE_GROUPS[0]
    socket_group: str = LINE_GROUPS[0]
    all_users: bool = False

    def put_into(self, text: str) -> str:
        """Return a shipped file with these groups instead of its own."""
        text = text.replace(LINE_GROUPS[0], self.group)
        text = text.replace(f"SocketGroup={self.group}", f"SocketGroup={self.socket_group}")
        return text.replace(SHIPPED_MODE, "SocketMode=0666") if self.all_users else text


def files(
    port: str, access: Access, *, iio: bool = False, uinput: bool = False
) -> Iterator[tuple[Path, str]]:
    """Yield each file to install: its path below the root and its contents."""
    source = 'kind = "iio"' if iio else f"port = {_toml(port)}"
    publish = f"{PUBLISH_UINPUT}\n" if uinput else ""
    shipped = importlib.resources.files("stillcal.config") / "systemd"
    for name, folder in (PLACES | (IIO_PLACES if iio else {}) | (UINPUT_PLACES if uinput else {})).items():
        text = access.put_into((shipped / name).read_text(encoding="utf-8"))
        yield Path(folder) / name, text.replace(SHIPPED, _unit_word(_command()))
    yield (
        SETTINGS,
        f"# See `stillcal run --help`. What is not set here has its default.\n{publish}[source]\n{source}\n",
    )


def _lacking(settings: Path, uinput: bool) -> str:
    """Return what a person should add to settings that are there already; nothing where they have it."""
    if not uinput or PUBLISH_UINPUT in settings.read_text(encoding="utf-8", errors="replace"):
        return ""
    return f"; add as its first line what --uinput needs: {PUBLISH_UINPUT}"


def _say_what_is_next(uinput: bool) -> None:
    if uinput:
        click.echo(
            "Let the input device be made, or start the machine anew:"
            " modprobe uinput && udevadm control --reload && udevadm trigger"
        )
    click.echo("Start it: systemctl daemon-reload && systemctl enable --now stillcal.socket stillcal.service")


def _line_group() -> str:
    """Return this system's group of serial lines; the first of LINE_GROUPS where it has none of them."""
    for name in LINE_GROUPS:
        with suppress(SettingsError, ImportError):  # no module grp: Windows
            group_id(name)
            return name
    return LINE_GROUPS[0]


def _refuse_odd_names(port: str | None) -> None:
    """Raise UsageError where systemd would not run this command, or no settings file can hold the port."""
    if UNRUNNABLE.search(_command()) or not is_utf8(_command()):
        raise click.UsageError(
            f"{_command()!a}: systemd runs no command whose path has a quote, a backslash, "
            "a control character or bytes that are no UTF-8: install stillcal in a folder without them"
        )
    if port == "":
        raise click.UsageError("--port is empty: name the phone's serial device, such as /dev/ttyACM0")
    if not is_utf8(port or ""):
        raise click.UsageError(f"--port {port!a}: is no UTF-8 text: give another name")


def _check_group(option: str, name: str, there: bool) -> None:
    """Refuse a name that no group can have, or (there) that no group of this system has."""
    if not re.fullmatch(r"[A-Za-z_][\w.-]*\$?", name):
        raise click.UsageError(f"{option} {name!r} is no name of a group")
    if there:
        try:
            group_id(name)
        except SettingsError as error:
            raise click.UsageError(str(error).replace("[socket] group =", option)) from None


def _toml(text: str) -> str:
    """Return a text as a basic string of TOML, whose escapes are JSON's and one more."""
    return json.dumps(text).replace("\x7f", "\\u007f")


def _unit_word(text: str) -> str:
    """Return a path without UNRUNNABLE as one word of a unit's command line (systemd.unit(5))."""
    escaped = text.replace("%", "%%")
    return f'"{escaped}"' if any(c.isspace() for c in text) else escaped


def _warn_unreachable(path: str) -> None:
    """Warn of a path that the service cannot see."""
    for setting, folders in UNREACHABLE.items():
        if any(Path(path).is_relative_to(folder) for folder in folders):
            remedy = (
                f"{path} is out of the service's reach ({setting}=): use one outside of {', '.join(folders)}"
            )
            click.echo(f"stillcal: {remedy}", err=True)


def _command() -> str:
    """Return the path of this command for the service."""
    command = Path(sys.argv[0] if os.sep in sys.argv[0] else sys.executable).absolute().with_name("stillcal")
    return str(command)


def _write(target: Path, text: str) -> None:
    make_folder(target.parent, 0o755)
    write_atomically(target, text.encode(), 0o644)
