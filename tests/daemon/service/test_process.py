"""The daemon as a process of its own: killed, refused, what it holds in memory, and its exit codes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from stillcal.daemon.cli.exits import NOT_SAVED, TRY_AGAIN
from stillcal.daemon.cli.query import replies
from stillcal.daemon.service import saved_state
from stillcal.daemon.wire.messages import Hello
from stillcal.replay.serial_phone.link import PhoneLink
from stillcal.replay.serial_phone.stream import PhoneStream
from tests.support.living import given_in, until, within_reason

STILLCAL = [str(Path(sys.executable).with_name("stillcal"))]


@contextlib.contextmanager
def process(folder: Path, *more: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    command = [*STILLCAL, "run", "--config", str(folder / "stillcal.toml"), *more]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **options) as daemon:
        try:
            yield daemon
        finally:
            daemon.kill()


def arguments(folder: Path) -> list[str]:
    given = given_in(folder)
    return ["--port", given.port, "--store", given.store, "--socket", given.socket]


def heard(daemon: subprocess.Popen[str], word: str) -> str:
    assert daemon.stderr is not None
    for line in daemon.stderr:
        if word in line:
            return line
    raise AssertionError(f"the daemon ended before it said {word!r}")


def asked(folder: Path, method: str) -> dict[str, Any]:
    (reply,) = replies(folder / "socket", {"method": f"io.stillcal.Calibration.{method}"})
    return reply["parameters"]


def test_killed_at_once_it_keeps_its_rests_and_a_second_one_is_refused(
    tmp_path: Path, lab: list[Any]
) -> None:
    more = arguments(tmp_path)

    async def test() -> None:
        async with PhoneLink(PhoneStream(lab), Hello(session=4, flow="credit")) as link:
            link.plug(tmp_path / "tty")
            phone = asyncio.create_task(link.serve())
            with process(tmp_path, *more) as daemon:
                await asyncio.to_thread(heard, daemon, "calibrated")
                await until(
                    lambda: saved_state.load(tmp_path / "store.state").state.engine.counters.rests > 0
                )
                second = await asyncio.to_thread(
                    subprocess.run, [*STILLCAL, "run", *more], capture_output=True, text=True, check=False
                )
                assert second.returncode == TRY_AGAIN
                assert f"in use by process {daemon.pid}" in second.stderr.splitlines()[-1]
                daemon.kill()
            await phone
        held = saved_state.load(tmp_path / "store.state").state.engine
        assert held.counters.rests > 0
        with process(tmp_path, *more) as daemon:
            await asyncio.to_thread(heard, daemon, "ready")
            status = (await asyncio.to_thread(asked, tmp_path, "GetStatus"))["status"]
            assert status["rests_held"] == len(held.pool.held)
            daemon.send_signal(signal.SIGTERM)
            assert await asyncio.to_thread(daemon.wait, 30) == 0
        assert not (tmp_path / "socket").exists()

    within_reason(test())


def test_a_calibration_that_cannot_be_written_is_told_at_the_end_with_74(
    tmp_path: Path, lab: list[Any]
) -> None:
    more = arguments(tmp_path)
    store = tmp_path / "folder" / "store.json"

    async def test() -> None:
        async with PhoneLink(PhoneStream(lab), Hello(session=4, flow="credit")) as link:
            link.plug(tmp_path / "tty")
            with process(tmp_path, *more, "--store", str(store)) as daemon:
                await asyncio.to_thread(heard, daemon, "ready")
                store.parent.rename(tmp_path / "away")
                phone = asyncio.create_task(link.serve())
                await asyncio.to_thread(heard, daemon, "calibrated")
                daemon.send_signal(signal.SIGTERM)
                lines = (await asyncio.to_thread(daemon.communicate, timeout=30))[1].splitlines()
                assert daemon.returncode == NOT_SAVED
            phone.cancel()
        why = f"cannot lock {store}: there is no such folder"
        assert [line for line in lines if "stopping: " in line and why in line]
        assert [line for line in lines if "lost: " in line and why in line and "calibration=" in line]
        assert "busy" not in "".join(lines)

    within_reason(test())


def test_a_state_that_cannot_be_written_is_told_at_the_end_with_0(tmp_path: Path) -> None:
    store = tmp_path / "folder" / "store.json"
    with process(tmp_path, *arguments(tmp_path), "--store", str(store)) as daemon:
        heard(daemon, "ready")
        store.parent.rename(tmp_path / "away")
        daemon.send_signal(signal.SIGTERM)
        assert f"cannot lock {store}: there is no such folder" in heard(daemon, "stopping")
        assert daemon.wait(30) == 0


def test_the_daemon_holds_no_more_than_it_uses() -> None:
    script = (
        "import sys, json, stillcal.daemon.cli.main, stillcal.daemon.cli.run, stillcal.daemon.app;"
        "print(json.dumps(sorted(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in json.loads(found.stdout)}
    assert {"numpy", "serial", "msgspec", "asyncvarlink", "click"} <= loaded
    assert not loaded & {"scipy", "rich", "matplotlib", "sklearn", "pandas", "dask", "pyarrow", "varlink"}
    assert not [name for name in json.loads(found.stdout) if name.startswith("stillcal.replay")]


def test_run_holds_no_openssl_and_searches_its_modules_for_no_garbage(tmp_path: Path) -> None:
    script = (
        "import atexit, gc; atexit.register(lambda: print(gc.get_freeze_count(), len(gc.get_objects())))\n"
        "from stillcal.daemon.cli.entry import main; main()\n"
    )
    command = [sys.executable, "-c", script, "run", *arguments(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as daemon:
        try:
            heard(daemon, "ready")
            held = Path(f"/proc/{daemon.pid}/maps").read_text()
            assert "numpy" in held and "libcrypto" not in held and "libssl" not in held
            daemon.send_signal(signal.SIGTERM)
            assert daemon.stdout is not None
            exempt, searched = map(int, daemon.stdout.read().split())
            assert exempt > 10_000 > searched
        finally:
            daemon.kill()


@pytest.mark.parametrize(("text", "reason"), [("", "port is not set"), ("[source]\nport = 3", "must be str")])
def test_settings_that_cannot_serve_end_it_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    given_in(tmp_path, text)
    command = [*STILLCAL, "run", "--config", str(tmp_path / "stillcal.toml")]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 2
    (line,) = found.stderr.splitlines()
    assert reason in line


def test_asking_where_nobody_answers_is_exit_4(tmp_path: Path) -> None:
    command = [*STILLCAL, "query", "--socket", str(tmp_path / "none")]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 4
    assert "no daemon answers" in found.stderr and not found.stdout
