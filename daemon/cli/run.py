"""`stillcal run`: the daemon in the foreground, as systemd wants it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import click

from stillcal.calib_core.errors import TryAgainError
from stillcal.daemon.app_launch import LaunchOptions
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import config_option
from stillcal.daemon.system import log, memory
from stillcal.daemon.system.files import passing
from stillcal.daemon.system.requirements import DAEMON, require
from stillcal.daemon.system.systemd import Notifier, passed_sockets


@click.command(
    "run",
    short_help="Keep a phone calibrated, live.",
    epilog=examples(
        "stillcal run --port /dev/ttyACM0",
        "stillcal run --port '/dev/serial/by-id/usb-Arduino*' --store store.json",
        "stillcal run --config stillcal.toml",
    ),
)
@config_option
@click.option("--port", help="The phone's serial device or a pattern, in place of [source] port.")
@click.option("--store", type=click.Path(path_type=Path), help="The store, in place of [store] path.")
@click.option("--socket", help="Where to answer questions, in place of [socket] path.")
def run_command(config: Path | None, port: str | None, store: Path | None, socket: str | None) -> None:
    """Keep a phone calibrated: read its sensors, answer on a socket, until SIGTERM.

    The phone is on a serial line, or with kind = "iio" under [source] this machine is the phone. SIGHUP reads
    the settings again. Logs go to standard error. Exit code 2 where settings, store or socket cannot serve,
    75 where the machine cannot for now (disk, memory, descriptors): start it again.
    """
    require("stillcal run", DAEMON)
    from stillcal.daemon.app import Service  # noqa: PLC0415 - imports what only Linux has

    options = LaunchOptions(config, port, str(store) if store else None, socket, tuple(passed_sockets()))
    settings = options.settings()
    log.set_up(settings.log.level)
    memory.limit_arenas()
    notifier = Notifier()

    async def serve() -> None:
        service = Service(settings, options, notifier)
        service.open()
        await service.run()

    try:
        asyncio.run(serve())
    except MemoryError as error:
        raise TryAgainError("the system is out of memory: free some") from error
    except OSError as error:
        if not passing(error):
            raise
        raise TryAgainError(f"{error.filename or 'the system'}: {error.strerror}") from error
