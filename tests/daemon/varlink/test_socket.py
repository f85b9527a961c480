"""The socket's place and permissions: a second daemon, a dead one's place, the mode that the settings say."""

from __future__ import annotations

import asyncio
import contextlib
import grp
import os
import shutil
import socket
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from stillcal.daemon.app import Service
from stillcal.daemon.app_launch import LaunchOptions
from stillcal.daemon.settings import SettingsError
from stillcal.daemon.system.systemd import Notifier
from stillcal.daemon.varlink import server
from tests.support.asking import NAME, ask, connected
from tests.support.living import answering, until, within_reason


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


def test_a_socket_whose_name_is_removed_is_made_anew(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "LOOK_S", 0.01)

    async def test() -> None:
        async with answering(folder):
            before = await connected(folder)
            (folder / "socket").unlink()
            await until((folder / "socket").exists)
            for line in (before, await connected(folder)):
                assert "parameters" in await ask(line, "GetStatus")
        assert not (folder / "socket").exists()

    within_reason(test())


@pytest.mark.parametrize("mode", ["0o600", "0o660"])
def test_the_sockets_permissions_are_the_settings(folder: Path, mode: str) -> None:
    async def test() -> None:
        async with answering(folder, f"[socket]\nmode = {mode}\n"):
            assert (folder / "socket").stat().st_mode & 0o777 == int(mode, 8)

    within_reason(test())


def groups() -> list[str]:
    """Return groups of this system that the socket may be given to."""
    mine = set(os.getgroups()) | {os.getegid()}
    return [g.gr_name for g in grp.getgrall() if os.geteuid() == 0 or g.gr_gid in mine]


def test_the_sockets_group_is_the_settings(folder: Path) -> None:
    name = groups()[-1]

    async def test() -> None:
        async with answering(folder, f'[socket]\ngroup = "{name}"\nmode = 0o660\n'):
            there = (folder / "socket").stat()
            assert (there.st_gid, there.st_mode & 0o777) == (grp.getgrnam(name).gr_gid, 0o660)

    within_reason(test())


def test_a_member_of_the_group_may_read_and_others_may_not(folder: Path) -> None:
    """The kernel decides: a process of another user, once with the socket's group and once without."""
    if os.geteuid() != 0 or shutil.which("setpriv") is None:
        pytest.skip("needs root and setpriv, to become another user")
    name = next(g.gr_name for g in grp.getgrall() if g.gr_gid not in (0, 65534))
    ask = (
        f"import socket; s = socket.socket(socket.AF_UNIX); s.connect({str(folder / 'socket')!r});"
        f's.sendall(b\'{{"method": "{NAME}.Stream", "more": true}}\' + bytes(1)); print(s.recv(999).decode())'
    )

    def asked(*groups: str) -> subprocess.CompletedProcess[str]:
        words = ["setpriv", "--reuid=65534", "--regid=65534", *groups, "/usr/bin/python3", "-S", "-c", ask]
        return subprocess.run(words, check=False, capture_output=True, text=True)

    async def test() -> None:
        folder.chmod(0o755)
        async with answering(folder, f'[socket]\ngroup = "{name}"\n'):
            assert "begun" in (await asyncio.to_thread(asked, f"--groups={name}")).stdout
            assert "PermissionError" in (await asyncio.to_thread(asked, "--clear-groups")).stderr

    within_reason(test())


def test_a_group_that_is_not_there_is_said(folder: Path) -> None:
    async def test() -> None:
        with pytest.raises(SettingsError, match=r"no such group \(`getent group` lists them\)"):
            async with answering(folder, '[socket]\ngroup = "no-such-group"\n'):
                pass

    within_reason(test())
