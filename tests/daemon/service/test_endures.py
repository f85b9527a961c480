"""The whole daemon: nothing that a phone sends or an operator types takes it down or keeps it from ending."""

from __future__ import annotations

import asyncio
import errno
import math
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.engine.actions import Publish
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.streams.events import Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.app import Service
from stillcal.daemon.service.engine_thread import EngineThread
from stillcal.daemon.settings import SettingsError
from stillcal.daemon.store.store import Store
from stillcal.daemon.system.systemd import Notifier
from tests.daemon.service.test_process import STILLCAL, arguments, heard, process
from tests.support.asking import ask, connected
from tests.support.living import answering, given_in, running, until, within_reason
from tests.support.serial_line import Device


@pytest.mark.parametrize("what", ["the store", "another file", "a folder"])
def test_a_socket_path_where_something_else_lies_is_refused_and_left_alone(
    tmp_path: Path, make_record: Any, what: str
) -> None:
    Store(tmp_path / "store.json").publish(make_record(1))
    place = {"the store": "store.json", "another file": "notes.txt", "a folder": "folder"}[what]
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "folder").mkdir()
    before = (tmp_path / "store.json").read_bytes()
    command = [
        *STILLCAL,
        "run",
        "--port",
        "none",
        "--store",
        tmp_path / "store.json",
        "--socket",
        tmp_path / place,
    ]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 2, ran.stderr
    assert (tmp_path / "store.json").read_bytes() == before
    assert (tmp_path / "notes.txt").read_text() == "mine" and (tmp_path / "folder").is_dir()


@pytest.mark.parametrize("name", ["store.json", "store.state", "store.json.last-good", "store.json.lock"])
def test_the_socket_may_not_lie_where_the_stores_files_do_even_where_none_is_yet(
    tmp_path: Path, name: str
) -> None:
    options = replace(given_in(tmp_path), socket=str(tmp_path / name))
    with pytest.raises(SettingsError, match="are the same"):
        Service(options.settings(), options, Notifier({})).open()
    assert not (tmp_path / name).exists()


def test_a_dead_sockets_place_is_taken_and_no_other_name_is_left(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder):
            assert "parameters" in await ask(await connected(folder), "GetStatus")
            assert [p.name for p in folder.iterdir() if p.is_socket()] == ["socket"]
        assert not (folder / "socket").exists()

    within_reason(test())


@pytest.mark.parametrize("error", [errno.EIO, errno.EMFILE, errno.ENOMEM], ids=errno.errorcode.get)
@pytest.mark.parametrize("name", ["store.json", "store.state", "stillcal.toml"])
def test_a_passing_error_at_the_start_ends_it_so_that_systemd_starts_it_again(
    tmp_path: Path, make_record: Any, error: int, name: str
) -> None:
    """75, which the unit does not except from restarting; what was there stays as it was."""
    Store(tmp_path / "store.json").publish(make_record(1))
    given_in(tmp_path)
    before = (tmp_path / "store.json").read_bytes()
    script = (
        "import os, sys; opened = os.open\n"
        "def failing(path, *more, **named):\n"
        f"    if str(path).endswith({name!r}): raise OSError({error}, os.strerror({error}), str(path))\n"
        "    return opened(path, *more, **named)\n"
        "os.open = failing\n"
        "from stillcal.daemon.cli.main import main; main()\n"
    )
    command = [sys.executable, "-c", script, "run"]
    more = ["--config", str(tmp_path / "stillcal.toml"), *arguments(tmp_path)]
    ran = subprocess.run([*command, *more], capture_output=True, text=True, check=False)
    assert ran.returncode == 75, ran.stderr
    assert "Traceback" not in ran.stderr
    assert (tmp_path / "store.json").read_bytes() == before
    assert not list(tmp_path.glob("*unreadable*"))


def test_the_unit_starts_it_again_after_every_exit_but_bad_settings() -> None:
    unit = Path("config/systemd/stillcal.service").read_text()
    assert "Restart=on-failure" in unit and "RestartPreventExitStatus=2\n" in unit
    assert "StartLimitIntervalSec=0" in unit


def test_lines_that_took_it_down_are_counted_as_bad(tmp_path: Path) -> None:
    device = Device(tmp_path / "tty")
    with process(tmp_path, *arguments(tmp_path)) as daemon:
        heard(daemon, "connected")
        for number in (10**19, 10**25, 2**63):
            device.write(b"S,0,0,1,%d\nA,%d,0,0,9.8\nA,0,0,0,%d\n" % (number, number, 10**308))
        time.sleep(0.5)
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(30) == 0
    device.unplug()


def test_a_state_that_cannot_be_encoded_is_said_and_survived(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def test() -> None:
        async with running(given_in(tmp_path)) as service:
            service.saved.energy.began = 10**400  # type: ignore[assignment]
            assert not await service.saving.save()
            service.saved.energy.began = None
            assert await service.saving.save()

    within_reason(test())
    assert "cannot be written" in caplog.text


def test_a_calibration_that_cannot_be_written_is_left_out_and_the_next_one_is_kept(
    tmp_path: Path, make_record: Any
) -> None:
    async def test() -> None:
        async with running(given_in(tmp_path)) as service:
            bad = replace(make_record(1), fitted_at=math.nan)
            service.actions.carry_out([Publish(1.0, bad, "hostile"), Publish(2.0, make_record(2), "good")])
            await until(lambda: service.current_id == make_record(2).id)
            assert service.current_id == make_record(2).id

    within_reason(test())


def test_an_engine_that_fails_goes_on_with_what_it_gathered(
    monkeypatch: pytest.MonkeyPatch, make_record: Any
) -> None:
    feed = Engine.feed

    def failing(self: Engine, *items: Any) -> Any:
        if isinstance(items[0], Tick):
            raise ZeroDivisionError("a fault of ours")
        return feed(self, *items)

    monkeypatch.setattr(Engine, "feed", failing)

    async def test() -> None:
        thread = EngineThread(EngineSettings(), None, make_record(1))
        reply = await thread.feed([Tick(1.0)])
        assert "a fault of ours" in reply.refused[0]
        block = Samples.checked(Sensor.ACCELEROMETER, np.arange(10) / 100 + 2.0, np.full((10, 3), 5.6))
        assert not (await thread.feed([block])).refused
        assert thread.view.record is not None and thread.view.record.id == make_record(1).id
        thread.close()

    asyncio.run(test())
