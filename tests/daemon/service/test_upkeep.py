"""The running daemon and its host: settings read again, what the manager hears, a full disk."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import signal
import socket
from pathlib import Path
from typing import Any

import pytest

from stillcal.daemon.store.files import StoreError
from stillcal.daemon.store.store import Store
from stillcal.replay.serial_phone.link import serve_phone
from stillcal.replay.trials.faults.calls import failing_call
from tests.support.asking import ask, connected
from tests.support.living import answering, given_in, running, until, within_reason


def test_another_device_is_taken_on_reload_and_bad_settings_are_refused(
    tmp_path: Path, lab: list[Any], caplog: pytest.LogCaptureFixture
) -> None:
    given = given_in(tmp_path)

    async def test() -> None:
        async with running(given) as service:
            given.config.write_text("[engine.schedule]\nattitudes_wanted = 3\n")
            os.kill(os.getpid(), signal.SIGHUP)
            await until(lambda: "attitudes_wanted = 3: must be 6 or more" in caplog.text)
            assert service.settings.engine.schedule.attitudes_wanted == 30
            with failing_call(3, errno.EMFILE) as calls:  # after two looks at what kind of file it is
                assert "Too many open files" in await service.reload()
            assert calls.name == "open"
            given.config.write_text("[engine.schedule]\nattitudes_wanted = 12\n[source]\nbaud = 9600\n")
            os.kill(os.getpid(), signal.SIGHUP)
            await until(lambda: service.settings.source.baud == 9600)
            await serve_phone(lab[:3], {}, path=tmp_path / "tty")
            await until(lambda: service.saved.clock.newest > 100)
            assert service.source.settings.baud == 9600

    within_reason(test())


def test_limits_of_clients_are_those_of_the_settings_read_last(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder, "[socket]\nmessage_bytes = 1024\n") as service:
            long = {"to": "x" * 2000}
            with pytest.raises(asyncio.IncompleteReadError):
                await ask(await connected(folder), "Rollback", parameters=long)
            (folder / "stillcal.toml").write_text("[socket]\nmessage_bytes = 4096\n")
            assert await service.reload() == ""
            assert "no earlier" in str(await ask(await connected(folder), "Rollback", parameters=long))

    within_reason(test())


def test_the_manager_hears_everything_in_order(tmp_path: Path) -> None:
    given = given_in(tmp_path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as manager:
        manager.bind(str(tmp_path / "notify"))
        heard: list[str] = []

        def listen() -> bool:
            with contextlib.suppress(BlockingIOError):
                while True:
                    heard.extend(manager.recv(4096).decode().splitlines())
            return heard.count("WATCHDOG=1") >= 3

        async def test() -> None:
            environ = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "200000"}
            async with running(given, environ) as service:
                await until(listen)
                await service.reload()
            listen()

        within_reason(test())
    order = [line for line in heard if line.partition("=")[0] in ("READY", "RELOADING", "STOPPING")]
    assert order == ["READY=1", "RELOADING=1", "READY=1", "STOPPING=1"]
    assert any(line.startswith("STATUS=no phone; no calibration yet") for line in heard)


def test_a_full_disk_delays_nothing_and_is_made_up_for(
    tmp_path: Path, lab: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = given_in(tmp_path)
    publish = Store.publish
    monkeypatch.setattr(
        "stillcal.daemon.service.saving.SAVE_EVERY_S", 600.0
    )  # the next try does not wait for this
    monkeypatch.setattr("stillcal.daemon.service.saving.RETRY_EVERY_S", 0.05)

    def refuse(*arguments: Any) -> None:
        raise StoreError("the disk is full: free some space")

    async def test() -> None:
        async with running(given) as service:
            monkeypatch.setattr(Store, "publish", refuse)
            await serve_phone(lab, {}, path=tmp_path / "tty")
            await until(lambda: service.trouble)
            assert service.view.record is not None and service.document.current is None
            monkeypatch.setattr(Store, "publish", publish)
            await until(lambda: service.document.current is not None)
            await until(lambda: not service.trouble)

    within_reason(test())
