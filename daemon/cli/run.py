"""`stillcal run`: run the daemon in the foreground."""

from __future__ import annotations

import asyncio
import signal
import sys
from pathlib import Path

import click

from stillcal.calib_core.errors import TryAgainError
from stillcal.daemon.app_launch import LaunchOptions
from stillcal.daemon.cli.exits import NOT_SAVED
from stillcal.daemon.cli.interruption import quit_when_interrupted
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import config_option
from stillcal.daemon.system import log, memory
from stillcal.daemon.system.files import passing
from stillcal.daemon.system.imports import without_collection
from stillcal.daemon.system.requirements import DAEMON, require
from stillcal.daemon.system.systemd import Notifier, passed_sockets


@click.command(
    "run",
    short_help="Keep a connected phone calibrated.",
    epilog=examples(
        "stillcal run --port /dev/ttyACM0",
        "stillcal run --port '/dev/serial/by-id/usb-Arduino*' --store store.json",
        "stillcal run --config stillcal.toml",
        "stillcal run --port /dev/ttyACM0 --publish live.mcap",
    ),
)
@config_option
@click.option("--port", help="The phone's serial device or a pattern; overrides [source] port.")
@click.option("--store", type=click.Path(path_type=Path), help="The store's file; overrides [store] path.")
@click.option("--socket", help="The socket for queries; overrides [socket] path.")
@click.option("--socket-group", help="Group whose members may connect; overrides [socket] group.")
@click.option(
    "--publish",
    multiple=True,
    help="Send corrected samples to FILE.mcap or an input device (uinput), or correct the chip (iio).",
)
def run_command(  # noqa: PLR0917 - click hands every option over by name
    config: Path | None,
    port: str | None,
    store: Path | None,
    socket: str | None,
    socket_group: str | None,
    publish: tuple[str, ...],
) -> None:
    """Run the daemon: read a phone's sensors, keep it calibrated and answer queries until SIGTERM.

    The phone is connected by a serial line. With kind = "iio" under [source], the daemon reads this machine's
    own sensors instead. SIGHUP reads the settings again. Logs go to standard error. Exit code 2 when the
    settings are wrong, or the store or the socket cannot be used; 74 when it was stopped while its newest
    calibration could not be written to the store; 75 after a passing fault of the machine
    (disk, memory, descriptors) or while another process holds the store: start it again.
    """
    require("stillcal run", DAEMON)
    quit_when_interrupted()  # until the service listens itself
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # systemd would take it for a clean end
    with without_collection():
        from stillcal.daemon.app import Service  # noqa: PLC0415 - imports what only Linux has

    options = LaunchOptions(
        config=config,
        port=port,
        store=str(store) if store else None,
        socket=socket,
        passed=tuple(passed_sockets()),
        publish=publish,
        socket_group=socket_group,
    )
    settings = options.settings()
    lines = log.set_up(settings.log.level)
    memory.limit_arenas()
    notifier = Notifier()

    service = Service(settings, options, notifier)
    try:
        service.open()
        memory.exempt_from_collection()
        asyncio.run(service.run())
        if service.storage.unsaved is not None:
            sys.exit(NOT_SAVED)  # the log has said why
    except MemoryError as error:
        raise TryAgainError("the system is out of memory: free some") from error
    except OSError as error:
        if not passing(error):
            raise
        raise TryAgainError(f"{error.filename or 'the system'}: {error.strerror}") from error
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to interrupt
        lines.flush()
