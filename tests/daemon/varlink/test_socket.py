"""The socket's place and permissions: a second daemon, a dead one's place, the mode that the settings say."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from stillcal.daemon.app import Service
from stillcal.daemon.app_launch import LaunchOptions
from stillcal.daemon.system.systemd import Notifier
from tests.support.asking import connected
from tests.support.living import answering, within_reason


def test_a_second_daemon_on_the_same_socket_is_refused_and_a_dead_ones_place_is_taken(folder: Path) -> None:
    dead = socket.socket(socket.AF_UNIX)
    dead.bind(str(folder / "socket"))
    dead.close()

    async def test() -> None:
        given = LaunchOptions(None, "none", str(folder / "other.json"), str(folder / "socket"))
        config = folder / "stillcal.toml"
        config.write_text("")
        async with answering_after(folder):
            second = Service(given.settings(), given, Notifier({}))
            second.open()
            with pytest.raises(ValueError, match="in use by another daemon"):
                await second.run()
            second.storage.close()

    within_reason(test())


@contextlib.asynccontextmanager
async def answering_after(folder: Path) -> AsyncIterator[Service]:
    """Run the daemon where a dead one's socket lies, and wait until it answers."""
    async with answering(folder) as service:
        while True:
            with contextlib.suppress(ConnectionRefusedError):
                (await connected(folder))[1].close()
                break
            await asyncio.sleep(0.001)
        yield service


@pytest.mark.parametrize("mode", ["0o600", "0o660"])
def test_the_sockets_permissions_are_the_settings(folder: Path, mode: str) -> None:
    async def test() -> None:
        async with answering(folder, f"[socket]\nmode = {mode}\n"):
            assert (folder / "socket").stat().st_mode & 0o777 == int(mode, 8)

    within_reason(test())
