"""A phone that floods the daemon with events, hellos and names: memory, log and terminals are bounded."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.calib_core.codec import packed
from stillcal.calib_core.engine.actions import Log
from stillcal.calib_core.engine.engine import MAX_EVENTS, Engine
from stillcal.calib_core.engine.intake import MAX_MOVES
from stillcal.calib_core.streams.events import Charging, End, Location
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.cli.query import query_command
from stillcal.daemon.cli.watch.snapshot import snapshot
from stillcal.daemon.service.phone_clock import GAPS_S, LEAP_S
from stillcal.daemon.service.phone_session import DEVICE_CHARACTERS
from stillcal.daemon.system import log
from stillcal.daemon.system.log import BURST, MAX_KINDS, REFILL_S, Quota, say
from stillcal.daemon.system.printable import printable
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Hello, Status
from tests.support.asking import ask, connected
from tests.support.living import answering, until, within_reason
from tests.support.serial_line import Device


def block(start: float, n: int = 100) -> list[Samples]:
    t = start + np.arange(n) / 100
    return [Samples.checked(s, t, np.full((n, 3), 5.6)) for s in (Sensor.GYROSCOPE, Sensor.ACCELEROMETER)]


def test_events_ahead_are_bounded_and_those_that_come_first_are_kept() -> None:
    engine = Engine()
    engine.feed(*block(0.0))
    said = []
    for i in range(2 * MAX_EVENTS):
        said += engine.feed(Charging(1e5 - i, bool(i % 2)))
    assert len(engine.state.events) == MAX_EVENTS
    assert engine.state.events[0].t == 1e5 - 2 * MAX_EVENTS + 1
    assert [e.t for e in engine.state.events] == sorted(e.t for e in engine.state.events)
    assert sum(isinstance(a, Log) and a.what == "events" for a in said) == MAX_EVENTS
    assert len(packed(engine.state.events)) < 100_000


def test_the_end_of_a_stream_is_never_what_is_forgotten() -> None:
    engine = Engine()
    engine.feed(*block(0.0))
    flood = [Charging(50.0 + i, True) for i in range(MAX_EVENTS)]
    engine.feed(*flood, End(1e6))
    assert not engine.state.events  # the end was met, and with it all that came before


def test_places_of_late_are_bounded() -> None:
    engine = Engine()
    engine.feed(*block(0.0))
    engine.feed(*(Location(0.5 + i * 1e-4, 10.0 + i % 60, 20.0) for i in range(500)))
    engine.feed(*block(1.0, 1000))
    assert 1 < len(engine.state.moves) <= MAX_MOVES


@pytest.fixture
def written(tmp_path: Path) -> Iterator[Callable[[], str]]:
    """What the log has written so far."""
    root, level = logging.getLogger(), logging.getLogger("stillcal").level
    handlers, root_level = root.handlers[:], root.level
    with (tmp_path / "log").open("w") as stream:
        lines = log.set_up("info", stream, {})

        def text() -> str:
            lines.flush()
            return (tmp_path / "log").read_text()

        yield text
        lines.close()
    root.handlers[:] = handlers
    root.setLevel(root_level)
    logging.getLogger("stillcal").setLevel(level)


def test_one_kind_of_line_repeated_fills_no_disk_and_hides_no_other(written: Callable[[], str]) -> None:
    for i in range(10_000):
        say("warning", "another phone", "it is another one", device=f"phone {i}")
    say("warning", "disconnected", "pulled out")
    lines = written().splitlines()
    assert len(lines) == BURST + 1
    assert "pulled out" in lines[-1]


def test_what_is_held_back_is_counted_and_told_later() -> None:
    now = [0.0]
    quota = Quota(lambda: now[0])

    def lines(number: int) -> list[str]:
        records = [logging.LogRecord("stillcal", 30, "", 0, "%s", ("x",), None) for _ in range(number)]
        return [r.getMessage() for r in records if quota.filter(r)]

    assert len(lines(200)) == BURST
    now[0] = REFILL_S * 0.99
    assert lines(1) == []
    now[0] = REFILL_S
    assert lines(1) == [f"x held_back={200 - BURST + 1:.0f}"]
    now[0] = 1e6
    assert len(lines(200)) == BURST


def test_kinds_of_lines_are_bounded_too() -> None:
    quota = Quota(lambda: 0.0)
    for i in range(10 * MAX_KINDS):
        quota.filter(logging.LogRecord("other", 30, "", 0, f"text {i}", (), None))
    assert len(quota._kinds) <= MAX_KINDS + 1


NASTY = "\x1b]0;mine\x07\x1b[2J\x1b[31mphone\r\n\u202e"


def test_a_name_from_the_phone_moves_no_cursor(tmp_path: Path) -> None:
    """Through a real daemon: what `query` prints and what `watch` shows of a phone named by escapes."""
    hello = Hello(session=1, claims={"device": NASTY + "x" * 1000})

    async def test() -> None:
        async with answering(tmp_path) as service:
            device = Device(tmp_path / "tty")
            await until(lambda: service.source.connected)
            device.write(WireEncoder(WireSettings(form=Form.BINARY)).encode(hello))
            await until(lambda: service.saved.device)
            status = (await ask(await connected(tmp_path), "GetStatus"))["parameters"]["status"]
            assert status["phone"].isprintable() and len(status["phone"]) <= DEVICE_CHARACTERS
            device.unplug()
            service.saved.device = NASTY  # as an earlier version kept it
            arguments = ["GetStatus", "--socket", str(tmp_path / "socket")]
            ran = await asyncio.to_thread(CliRunner().invoke, query_command, arguments)
            shown = await asyncio.to_thread(snapshot, tmp_path / "socket")
            assert all(line.isprintable() for line in ran.output.split("\n")), ran.output
            assert shown.status["phone"] == printable(NASTY)

    within_reason(test())


def test_sensors_are_not_on_for_longer_than_time_has_passed(
    tmp_path: Path, written: Callable[[], str]
) -> None:
    """A phone says that they were on for 30 years within a second, and then that 30 more have passed."""
    encoder = WireEncoder(WireSettings(form=Form.TEXT))
    told = (
        Hello(session=1),
        *block(0.0, 10),
        Status(1.0, 1.0, True, 1),
        *block(1.0, 10),
        Status(2.0, 1e9, True, 1),
        Status(1e9, 2e9, True, 1),
        *block(2.0, 10),
        Status(3.0, 2e9 + 0.5, True, 1),
    )

    async def test() -> None:
        async with answering(tmp_path) as service:
            device = Device(tmp_path / "tty")
            await until(lambda: service.source.connected)
            device.write(b"".join(encoder.encode(message) for message in told))
            await until(lambda: service.saved.energy.told == told[-1])
            line = await connected(tmp_path)
            (day,) = (await ask(line, "GetEnergy"))["parameters"]["days"]
            assert 1.5 <= day["sensors_on_s"] <= day["observed_s"] < 60.0
            assert "sensors were on for 1e+09 s more than have passed" in written()
            device.unplug()

    within_reason(test())


def test_a_description_is_still_printed_line_by_line(tmp_path: Path) -> None:
    async def test() -> None:
        async with answering(tmp_path):
            name = "org.varlink.service.GetInterfaceDescription"
            more = ['{"interface": "io.stillcal.Calibration"}', "--socket", str(tmp_path / "socket")]
            ran = await asyncio.to_thread(CliRunner().invoke, query_command, [name, *more])
            assert "\nmethod Correct(" in ran.output

    within_reason(test())


def test_hellos_in_turn_under_two_names_write_little(tmp_path: Path, written: Callable[[], str]) -> None:
    encoder = WireEncoder(WireSettings(form=Form.BINARY))

    async def test() -> None:
        async with answering(tmp_path) as service:
            device = Device(tmp_path / "tty")
            await until(lambda: service.source.connected)
            for i in range(300):
                device.write(encoder.encode(Hello(session=i, claims={"device": f"phone {i % 2}"})))
                if i % 20 == 19:
                    await until(lambda i=i: service.session.hello and service.session.hello.session == i)
            device.unplug()

    within_reason(test())
    assert len(written().splitlines()) < 5 * BURST


def test_a_block_of_stamps_a_day_apart_does_not_hold_up_the_engine(tmp_path: Path) -> None:
    """A day without samples takes the engine 0.2 s; blocks of 100 such days would take 20 s each."""
    encoder = WireEncoder(WireSettings(form=Form.BINARY))

    def days(first: int) -> Samples:
        t = LEAP_S * (first + np.arange(100.0))
        return Samples.checked(Sensor.ACCELEROMETER, t, np.full((100, 3), 5.6))

    async def test() -> None:
        async with answering(tmp_path) as service:
            device = Device(tmp_path / "tty")
            await until(lambda: service.source.connected)
            for number in range(2):
                before = service.saved.clock.disordered
                device.write(encoder.encode(days(100 * number)))
                await until(lambda before=before: service.saved.clock.disordered > before)
                await until(lambda: not service.saved.clock._gaps)
            device.unplug()
            assert GAPS_S < service.saved.clock.newest <= 2 * GAPS_S + LEAP_S

    within_reason(test())
