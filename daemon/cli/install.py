"""`stillcal install-service`: install the systemd units, the udev rule and a first settings file."""

from __future__ import annotations

import importlib.resources
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import click

from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.store.atomic import write_atomically

SHIPPED = "/usr/local/bin/stillcal"
"""The path of the command in the shipped unit, which installing replaces."""

PLACES = {
    "stillcal.service": "etc/systemd/system",
    "stillcal.socket": "etc/systemd/system",
    "70-stillcal.rules": "etc/udev/rules.d",
}
SETTINGS = Path("etc/stillcal/stillcal.toml")


@click.command(
    "install-service",
    epilog=examples(
        "sudo stillcal install-service --port '/dev/serial/by-id/*'",
        "sudo systemctl daemon-reload && sudo systemctl enable --now stillcal.socket stillcal.service",
        "stillcal install-service --print",
    ),
)
@click.option(
    "--port", default="/dev/ttyACM0", show_default=True, help="The phone's serial device or a pattern."
)
@click.option("--root", type=click.Path(path_type=Path), default=Path("/"), help="Install below this folder.")
@click.option("--print", "only_print", is_flag=True, help="Print the files, change nothing.")
def install_command(port: str, root: Path, only_print: bool) -> None:
    """Install the systemd service.

    Units go to /etc/systemd/system, the udev rule to /etc/udev/rules.d, and settings to
    /etc/stillcal/stillcal.toml unless there are some. Nothing is started.
    """
    for place, text in files(port):
        target = root / place
        if only_print:
            click.echo(f"# /{place}\n{text}")
        elif place == SETTINGS and target.exists():
            click.echo(f"{target}: exists, not changed")
        else:
            _write(target, text)
            click.echo(f"{target}: written")
    if not only_print:
        click.echo(
            "Start it: systemctl daemon-reload && systemctl enable --now stillcal.socket stillcal.service"
        )


def files(port: str) -> Iterator[tuple[Path, str]]:
    """Yield each file to install: its path below the root and its contents."""
    shipped = importlib.resources.files("stillcal.config") / "systemd"
    for name, folder in PLACES.items():
        text = (shipped / name).read_text(encoding="utf-8")
        yield Path(folder) / name, text.replace(SHIPPED, _command())
    yield (
        SETTINGS,
        f'# See `stillcal run --help`. What is not set here has its default.\n[source]\nport = "{port}"\n',
    )


def _command() -> str:
    """Return the path of this command for the service; warn where the service cannot run it."""
    command = Path(sys.argv[0] if os.sep in sys.argv[0] else sys.executable).absolute().with_name("stillcal")
    if command.is_relative_to("/home") or command.is_relative_to("/root"):
        click.echo(
            f"stillcal: the service cannot run {command} (ProtectHome= hides it): install it in /opt",
            err=True,
        )
    return str(command)


def _write(target: Path, text: str) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target, text.encode(), 0o644)
