"""The whole daemon on a simulated phone's pseudo-terminal, in this process and as a process of its own."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from living import given_in, running, until, within_reason

from stillcal.calib_core.engine import Engine
from stillcal.calib_core.engine_state import EngineSettings, EngineState
from stillcal.calib_core.events import Charging, Reject
from stillcal.calib_core.events import Store as Keep
from stillcal.calib_core.samples import Samples, Sensor
from stillcal.calib_core.schedule import ScheduleSettings
from stillcal.daemon import saved_state
from stillcal.daemon.cli_query import replies
from stillcal.daemon.saved_state import SavedState
from stillcal.daemon.serial_source import SerialSource
from stillcal.daemon.service_mind import Mind
from stillcal.daemon.service_pump import Pump, host_time
from stillcal.daemon.source_base import SerialSettings
from stillcal.daemon.store import Store, StoreError
from stillcal.daemon.store_document import StoreDocument
from stillcal.daemon.wire import Hello
from stillcal.replay.phone import load_phone, load_scenario, simulate
from stillcal.replay.phone_link import LinkSettings, PhoneLink, serve_phone
from stillcal.replay.phone_stream import PhoneStream
from stillcal.replay.runner import replay

STILLCAL = [str(Path(sys.executable).with_name("stillcal"))]

PROBING = """
[engine.schedule]
watch = "probing"
review_interval_s = 1.0
[engine.detector]
probe_min_s = 0.5
probe_max_s = 0.6
w_min_s = 1.0
w_spread_s = 0.0
"""


@pytest.fixture(scope="module")
def lab() -> list[Any]:
    """Ten minutes of a phone laid in 24 attitudes."""
    return list(simulate(load_scenario("lab"), load_phone("consumer"), 1).chunks())


# The same life, live and replayed


@pytest.mark.parametrize("watch", ["auto", "probing"])
def test_lived_over_the_wire_and_replayed_give_the_same_store(
    tmp_path: Path, lab: list[Any], watch: Any
) -> None:
    schedule = ScheduleSettings(watch=watch, attitudes_wanted=12)
    kept: list[Any] = []
    replayed = replay(lab, Engine(EngineSettings(schedule)), kept.append)
    given = given_in(tmp_path, f'[engine.schedule]\nwatch = "{watch}"\nattitudes_wanted = 12\n')

    async def test() -> None:
        async with running(given) as service:
            await serve_phone(lab, {"device": "p"}, path=tmp_path / "tty")
            await until(lambda: service.mind.view.counters == replayed.state.counters)
            counts = service.saved.energy.days[0]
            assert counts.asked_s == replayed.ledger.asked_s
            if watch == "probing":
                assert 0 < counts.sensors_on_s < 0.5 * counts.observed_s

    within_reason(test())
    found = Store(tmp_path / "store.json").load() or StoreDocument()
    assert [found.current.id if found.current else None] == [
        None,
        *[a.record.id for a in kept if isinstance(a, Keep)],
    ][-1:]
    rejected = [e.calibration.id for e in found.history if e.what == "rejected"]
    assert rejected == [a.record.id for a in kept if isinstance(a, Reject)]
    assert saved_state.load(tmp_path / "store.state").state.device == "p"


def test_rests_gathered_before_a_restart_still_count(tmp_path: Path, lab: list[Any]) -> None:
    """Two lives of the daemon find what one finds."""
    given = given_in(tmp_path)

    async def test() -> None:
        stream = PhoneStream(lab)
        async with PhoneLink(stream, Hello(session=4, flow="credit"), LinkSettings(speed=600.0)) as link:
            link.plug(tmp_path / "tty")
            phone = asyncio.create_task(link.serve())
            async with running(given) as service:
                await until(lambda: service.mind.view.counters.rests >= 8)
            held = saved_state.load(tmp_path / "store.state").state.engine.counters.rests
            assert held >= 8
            async with running(given) as service:
                assert service.mind.view.counters.rests == held
                await until(lambda: service.document.current is not None)
            await phone
        assert service.document.current.accelerometer.n_rests >= 23

    within_reason(test())


def test_a_phone_that_restarts_is_carried_on(tmp_path: Path, lab: list[Any]) -> None:
    given = given_in(tmp_path)

    async def test() -> None:
        async with running(given) as service:
            for _ in range(2):
                await serve_phone(lab[:5], {}, path=tmp_path / "tty")
                await until(lambda: not service.source.connected)
            await until(lambda: service.saved.clock.newest > 550)
            assert service.saved.clock.restarts == 1
            assert service.mind.view.counters.rests >= 20
            assert service.pump.refused == 0

    within_reason(test())


def test_a_phone_in_real_time_sleeps_when_it_is_told(tmp_path: Path, lab: list[Any]) -> None:
    """One whose time does not wait: probes of 1 s, and nothing between them."""
    given = given_in(tmp_path, PROBING)

    async def test() -> None:
        phone = LinkSettings(speed=1.0, credit=False)
        async with running(given) as service:
            link = asyncio.create_task(serve_phone(lab, {}, phone, tmp_path / "tty"))
            await until(lambda: service.mind.view.ledger.probes >= 2)
            day = service.saved.energy.days[0]
            assert day.wakeups >= 2 and day.sensors_on_s < 0.9 * day.observed_s
            assert service.mind.view.ledger.lapsed == 0
            link.cancel()

    within_reason(test())


def test_watched_without_a_break_a_phone_in_real_time_is_thought_of_now_and_then_and_at_its_end(
    tmp_path: Path, lab: list[Any]
) -> None:
    """The engine lags behind what was read, by no more than GATHER_S; what was read before the end counts."""
    given = given_in(tmp_path, '[engine.schedule]\nwatch = "continuous"\n')
    behind: set[bool] = set()

    async def test() -> None:
        async with running(given) as service:
            link = asyncio.create_task(
                serve_phone(lab, {}, LinkSettings(speed=1.0, credit=False), tmp_path / "tty")
            )
            clock = service.saved.clock
            while not clock.newest > 2.5:
                if known := service.mind._engine.present.latest:
                    behind.add(max(known.values()) < clock.newest)
                await asyncio.sleep(0.01)
        link.cancel()
        assert behind == {False, True}
        state = saved_state.load(tmp_path / "store.state").state
        assert state is not None and max(state.engine.latest.values()) == clock.newest

    within_reason(test())


def test_what_is_due_hurries_the_engine_and_samples_alone_do_not() -> None:
    mind = Mind(EngineSettings(ScheduleSettings(watch="continuous")), None, None)
    pump = Pump(SerialSource(SerialSettings("none")), mind, SavedState(EngineState()), 0.0, lambda _: None)
    few = [Samples.checked(Sensor.ACCELEROMETER, [0.0, 1.0], np.zeros((2, 3)))]
    pump._thought = host_time() + 1e6

    async def test() -> None:
        for record in (*few, Charging(2.0, True)):
            await pump._handle(record)
        assert not pump._urgent(few) and pump._urgent([*few, Charging(2.0, True)]) and pump._urgent([])
        await pump._think()  # which leaves the charger for when samples are known up to it
        assert mind.view.decides == 2.0 and pump._urgent(few)
        mind.close()

    asyncio.run(test())


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
            given.config.write_text("[engine.schedule]\nattitudes_wanted = 12\n[source]\nbaud = 9600\n")
            os.kill(os.getpid(), signal.SIGHUP)
            await until(lambda: service.settings.source.baud == 9600)
            await serve_phone(lab[:3], {}, path=tmp_path / "tty")
            await until(lambda: service.saved.clock.newest > 100)
            assert service.source.settings.baud == 9600

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
    monkeypatch.setattr("stillcal.daemon.service.SAVE_EVERY_S", 0.01)

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


# As a process of its own


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
                assert second.returncode == 2
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


def test_the_daemon_holds_no_more_than_it_uses() -> None:
    script = (
        "import sys, json, stillcal.daemon.cli, stillcal.daemon.cli_run, stillcal.daemon.service;"
        "print(json.dumps(sorted(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in json.loads(found.stdout)}
    assert {"numpy", "serial", "msgspec", "asyncvarlink", "click"} <= loaded
    assert not loaded & {"scipy", "rich", "matplotlib", "sklearn", "pandas", "dask", "pyarrow", "varlink"}
    assert not [name for name in json.loads(found.stdout) if name.startswith("stillcal.replay")]


def test_run_holds_no_openssl(tmp_path: Path) -> None:
    with process(tmp_path, *arguments(tmp_path)) as daemon:
        heard(daemon, "ready")
        held = Path(f"/proc/{daemon.pid}/maps").read_text()
        assert "numpy" in held and "libcrypto" not in held and "libssl" not in held


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


def test_another_phone_begins_anew_and_the_olds_calibration_is_in_the_history(
    tmp_path: Path, lab: list[Any], caplog: pytest.LogCaptureFixture
) -> None:
    async def test() -> None:
        async with running(given_in(tmp_path)) as service:
            await serve_phone(lab, {"device": "old"}, path=tmp_path / "tty")
            await until(lambda: service.document.current is not None)
            first = service.document.current.id
            await serve_phone(lab[:1], {"device": "old"}, path=tmp_path / "tty")
            assert service.current_id == first
            held = service.view.rests_held
            await serve_phone(lab[:1], {"device": "new"}, path=tmp_path / "tty")
            await until(lambda: service.document.current is None)
            assert service.view.record is None and service.view.rests_held < held
            (entry,) = [e for e in service.document.history if e.what == "replaced"]
            assert entry.calibration.id == first and "another phone, new" in entry.reason
            assert service.saved.device == "new"

    within_reason(test())
    assert saved_state.load(tmp_path / "store.state").state.device == "new"
    found = Store(tmp_path / "store.json").rollback().document.current
    assert found is not None and found.acceptance.how == "rollback"
