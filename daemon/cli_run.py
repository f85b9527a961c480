"""`stillcal run`: the daemon in the foreground, as systemd wants it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import click

from stillcal.daemon import log
from stillcal.daemon.notify import Notifier, passed_sockets
from stillcal.daemon.service import Service
from stillcal.daemon.service_given import Given


@click.command("run")
@click.option("--config", type=click.Path(path_type=Path), help="Settings (TOML); see config/default.toml.")
@click.option("--port", help="The phone's serial device, in place of [source] port.")
@click.option("--store", type=click.Path(path_type=Path), help="The store, in place of [store] path.")
@click.option("--socket", help="Where to answer questions, in place of [socket] path.")
def run_command(config: Path | None, port: str | None, store: Path | None, socket: str | None) -> None:
    """Keep a phone calibrated: read its serial line, answer on a socket, until SIGTERM.

    SIGHUP reads the settings again. Logs go to standard error.
    """
    given = Given(config, port, str(store) if store else None, socket, tuple(passed_sockets()))
    settings = given.settings()
    log.set_up(settings.log.level)
    notifier = Notifier()

    async def serve() -> None:
        service = Service(settings, given, notifier)
        service.open()
        await service.run()

    asyncio.run(serve())
