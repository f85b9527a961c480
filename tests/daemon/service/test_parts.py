"""The energy ledger, the saved state, the log and systemd's protocol, each by itself."""

from __future__ import annotations

import dataclasses
import io
import logging
import os
import platform
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.codec import packed
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.streams.events import Charging, Location, Temperature
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.service import saved_state
from stillcal.daemon.service.batching import join_blocks
from stillcal.daemon.service.energy_ledger import DAY_S, KEPT_DAYS, EnergyLedger
from stillcal.daemon.service.sample_readers import SampleReaders
from stillcal.daemon.service.saved_state import SavedState, StateError, decode, encode
from stillcal.daemon.sources.base import Record
from stillcal.daemon.store.msgpack_arrays import encoded
from stillcal.daemon.system import log
from stillcal.daemon.system.systemd import Notifier, passed_sockets
from stillcal.daemon.wire.messages import Status

# The energy ledger


def test_a_day_adds_up_what_the_phone_and_the_engine_say():
    ledger = EnergyLedger()
    ledger.samples(1000.0, 100)
    ledger.status(1060.0, Status(1060.0, 20.0, True, 2))
    ledger.status(1100.0, Status(1100.0, 30.0, False, 3))
    ledger.totals(1100.0, 25.0, 1.5)
    ledger.samples(1010.0 + DAY_S, 7)
    ledger.totals(1010.0 + DAY_S, 26.0, 1.75)
    first, second = ledger.days
    assert (first.number, first.samples, first.sensors_on_s, first.wakeups) == (0, 100, 30.0, 3)
    assert (first.asked_s, first.cpu_s, first.observed_s) == (25.0, 1.5, DAY_S)
    assert (second.number, second.samples, second.asked_s, second.cpu_s) == (1, 7, 1.0, 0.25)
    assert second.observed_s == 10.0


def test_time_goes_to_the_day_it_went_by_in_and_a_day_ends_with_its_last_moment():
    ledger = EnergyLedger()
    for t in (-1e-4, 86_340.0, 86_400.0):
        ledger.samples(t, 1)
    assert [(d.number, round(d.observed_s, 3)) for d in ledger.days] == [(0, 86_400.0)]
    ledger.samples(86_400.0 + 3600.0, 1)
    ledger.samples(4 * 86_400.0 + 60.0, 1)
    assert [(d.number, round(d.observed_s)) for d in ledger.days] == [(0, 86_400), (1, 86_400), (4, 60)]


def test_a_phone_that_counts_anew_loses_nothing():
    ledger = EnergyLedger()
    ledger.samples(0.0, 1)
    ledger.status(10.0, Status(10.0, 8.0, True, 5))
    ledger.status(20.0, Status(3.0, 2.0, True, 1))
    assert (ledger.days[0].sensors_on_s, ledger.days[0].wakeups) == (10.0, 6)


def test_sensor_time_beyond_what_has_passed_is_left_out_and_returned():
    ledger = EnergyLedger()
    assert ledger.status(1000.0, Status(1000.0, 900.0, True, 1)) == 0.0  # before anything was observed
    assert ledger.days[0].sensors_on_s == 0.0
    assert ledger.status(1060.0, Status(1060.0, 960.0, True, 1)) == 0.0
    assert ledger.status(1120.0, Status(1120.0, 1e10, True, 1)) == pytest.approx(1e10 - 960.0 - 60.0)
    assert ledger.status(1180.0, Status(1180.0, 1e10 + 30.0, True, 1)) == -30.0
    assert ledger.days[0].sensors_on_s == 60.0 + 60.0 + 30.0


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(0, 1e10), st.integers(0, 9)), max_size=50))
def test_no_phone_makes_its_sensors_on_for_longer_than_was_observed(told: list[tuple[float, float, int]]):
    ledger = EnergyLedger()
    for t, on_time, wakeups in told:
        ledger.status(t, Status(t, on_time, True, wakeups))
    assert all(0.0 <= day.sensors_on_s <= DAY_S for day in ledger.days)
    passed = 0.0 if ledger.began is None else ledger.newest - ledger.began
    assert sum(day.sensors_on_s for day in ledger.days) <= passed * (1 + 1e-9)


@given(st.lists(st.floats(0, 1e9), min_size=1, max_size=50))
def test_the_ledger_is_bounded_and_its_days_in_order(times: list[float]):
    ledger = EnergyLedger()
    for t in [*times, *(DAY_S * n for n in range(0, 2 * KEPT_DAYS, 40))]:
        ledger.samples(t, 1)
    numbers = [day.number for day in ledger.days]
    assert numbers == sorted(set(numbers)) and len(numbers) <= KEPT_DAYS


# The saved state


def lived() -> SavedState:
    engine = Engine()
    t = np.arange(0, 5, 0.01)
    rng = np.random.default_rng(5)
    for sensor, mean in ((Sensor.GYROSCOPE, (0, 0, 0)), (Sensor.ACCELEROMETER, (0, 0, 9.8))):
        engine.feed(Samples.checked(sensor, t, rng.normal(mean, 0.01, (len(t), 3))))
    ledger = EnergyLedger()
    ledger.samples(3.0, 500)
    return SavedState(engine.state, energy=ledger, device="p")


def test_a_state_comes_back_to_the_last_bit():
    state = lived()
    assert encode(decode(encode(state))) == encode(state)
    assert decode(encode(state)).energy.days == state.energy.days


@pytest.mark.parametrize(
    "shape", [(0,), (1,), (15,), (16,), (65_535,), (65_536,), (0, 3), (3, 0), (2, 3), (5, 16), (65_536, 3)]
)
def test_arrays_are_written_as_the_lists_of_their_numbers_to_the_byte(shape: tuple[int, ...]):
    values = np.random.default_rng(1).normal(size=shape)
    values.flat[:2] = (np.nan, -np.inf)[: values.size]
    record = {
        "held": [values, values[::-1].copy()],
        "other": (np.arange(3), np.float64(2.0), np.ones((2, 2, 2))),
    }
    assert encoded(record) == packed(record)
    if values.ndim > 1:
        assert encoded([values.T]) == packed([values.T])


def test_any_damage_to_a_state_is_seen():
    data = encode(lived())
    rng = np.random.default_rng(1)
    for place in rng.integers(0, len(data), 200):
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(rng.integers(8))
        with pytest.raises(StateError):
            decode(bytes(damaged))
    for length in (0, 5, 40, len(data) - 1):
        with pytest.raises(StateError):
            decode(data[:length])


def test_what_another_version_wrote_is_refused():
    body = packed({"engine": 5})
    data = saved_state.HEAD + saved_state.hashlib.sha256(body).digest() + body
    with pytest.raises(StateError, match="this version"):
        decode(data)


def test_an_unreadable_state_is_set_aside_and_its_room_is_bounded(tmp_path: Path):
    path = tmp_path / "store.state"
    assert saved_state.load(path) == saved_state.Loaded()
    for n in range(saved_state.ASIDE + 2):
        path.write_bytes(b"nonsense %d" % n)
        found = saved_state.load(path)
        assert found.state is None and "moved to" in found.note
    assert not path.exists()
    assert len(list(tmp_path.iterdir())) == saved_state.ASIDE


# The log


def test_a_line_is_one_line_whatever_is_in_it():
    line = log.entry(
        "what", "why\nso", {"a": 1.23456789, "b": "two words", "c": None, "d": "x\x1b[0m", "e": True}
    )
    assert line == 'what: why\\nso a=1.23457 b="two words" d=x\\x1b[0m e=True'


def test_journald_gets_priorities(tmp_path: Path):
    with (tmp_path / "log").open("w") as stream:
        found = os.fstat(stream.fileno())
        environ = {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"}
        kept = logging.getLogger().handlers[:]
        try:
            lines = log.set_up("info", stream, environ)
            log.say("debug", "quiet")
            log.say("warning", "loud", "why", n=3)
            lines.flush()
            lines.close()
        finally:
            logging.getLogger().handlers[:] = kept
    assert (tmp_path / "log").read_text() == "<4>loud: why n=3\n"
    assert not log.reads_journal(io.StringIO(), environ)


# systemd


@pytest.fixture
def manager(tmp_path: Path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "notify"))
        line.settimeout(10)
        yield line


def test_what_systemd_is_told(manager: socket.socket):
    notifier = Notifier({"NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "3000000"})
    assert notifier.watchdog_s == 3.0
    notifier.ready("two\nlines")
    notifier.alive()
    before = time.monotonic_ns() // 1000
    notifier.reloading()
    notifier.stopping("bye")
    ready, alive, reloading, stopping = (manager.recv(4096).decode() for _ in range(4))
    assert (ready, alive) == ("READY=1\nSTATUS=two lines", "WATCHDOG=1")
    first, clock = reloading.split("\n")
    assert first == "RELOADING=1" and before <= int(clock.removeprefix("MONOTONIC_USEC="))
    assert stopping == "STOPPING=1\nSTATUS=bye"


@pytest.mark.parametrize("address", ["", "relative", "/nobody/there", "@nobody/there"])
def test_without_a_manager_nothing_happens(address: str):
    notifier = Notifier({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "10", "WATCHDOG_PID": "1"})
    notifier.ready("up")
    notifier.close()
    assert notifier.watchdog_s is None


def test_sockets_meant_for_others_are_left_alone():
    for environ in (
        {},
        {"LISTEN_PID": "1", "LISTEN_FDS": "1"},
        {"LISTEN_PID": str(os.getpid()), "LISTEN_FDS": "x"},
    ):
        assert passed_sockets(environ) == []
        assert not environ


def test_a_copy_of_the_ledger_goes_its_own_way():
    ledger = EnergyLedger()
    ledger.samples(0.0, 1)
    copy = ledger.copy()
    ledger.samples(1.0, 1)
    assert copy.days[0].samples == 1 and dataclasses.asdict(copy) != dataclasses.asdict(ledger)


# Blocks joined


def run_of(sensor: Sensor, *t: float, celsius: float | None = None) -> Samples:
    warm = None if celsius is None else np.full(len(t), celsius)
    return Samples.checked(sensor, t, np.outer(t, (1.0, 2.0, 3.0)), warm)


def test_blocks_are_joined_up_to_the_next_event_the_gyroscopes_first():
    accel, gyro = Sensor.ACCELEROMETER, Sensor.GYROSCOPE
    records: list[Record] = [
        run_of(accel, 0.0, 0.1),
        run_of(gyro, 0.05),
        run_of(accel, 0.2),
        Temperature(0.2, 25.0),
        run_of(accel, 0.3),
    ]
    first, second, told, last = join_blocks(records)
    assert isinstance(first, Samples) and isinstance(second, Samples) and isinstance(last, Samples)
    assert (first.sensor, first.t.tolist()) == (gyro, [0.05])
    assert (second.sensor, second.t.tolist()) == (accel, [0.0, 0.1, 0.2])
    assert second.xyz.tolist() == np.outer(second.t, (1.0, 2.0, 3.0)).tolist()
    assert told == Temperature(0.2, 25.0) and last.t.tolist() == [0.3]


def test_of_long_blocks_read_at_once_the_gyroscope_does_not_come_alone() -> None:
    accel, gyro = Sensor.ACCELEROMETER, Sensor.GYROSCOPE
    records = [run_of(sensor, t, t + 9.9) for t in np.arange(0.0, 1200.0, 10.0) for sensor in (accel, gyro)]
    heard = {accel: 0.0, gyro: 0.0}
    for block in join_blocks(records):
        assert isinstance(block, Samples)
        heard[block.sensor] = block.t[-1]
        assert heard[gyro] - heard[accel] < 80.0


@pytest.mark.parametrize("later", [-0.5, 1.5, 1e6])
def test_blocks_are_not_joined_where_time_does_not_go_on_or_columns_differ(later: float):
    """What a restart or a leap of the phone's clock does is judged by the first stamp of a block."""
    accel = Sensor.ACCELEROMETER
    records: list[Record] = [run_of(accel, 10.0), run_of(accel, 10.0 + later)]
    assert len(list(join_blocks(records))) == 2
    assert len(list(join_blocks([run_of(accel, 10.0), run_of(accel, 10.1, celsius=20.0)]))) == 2


# Memory

PATCHY = """
import sys
import numpy as np
from stillcal.daemon.system import memory
if "limit_arenas" in sys.argv:
    memory.limit_arenas()
np.empty(1 << 22, "u1").fill(1)  # once freed, glibc keeps blocks of this size
before, kept = memory.resident_bytes(), []
for _ in range(100):
    large = np.ones(200_000, "u1")
    kept += [large, np.ones(2_000, "u1")]
del large, kept[::2]
if "release_free_pages" in sys.argv:
    memory.release_free_pages()
print(memory.resident_bytes() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another allocator")
@pytest.mark.parametrize(
    ("calls", "given"), [([], False), (["limit_arenas"], True), (["release_free_pages"], True)]
)
def test_what_was_freed_between_what_is_kept_is_given_back(calls: list[str], given: bool):
    """20 MB in pieces with something small behind each; left alone, glibc keeps nearly all of it."""
    ran = subprocess.run([sys.executable, "-c", PATCHY, *calls], capture_output=True, text=True, check=True)
    assert (int(ran.stdout) < 4e6) == given


def test_a_recording_begins_with_what_the_phone_said_last_of_its_charger_and_place():
    """A phone says them once, and a recording may begin hours later."""
    readers, place = SampleReaders(), Location(2.0, 46.0, 7.0)
    for event in (Charging(1.0, True), place, Charging(3.0, False)):
        readers.record(event)
    with readers.recording(sparing=True) as subscriber:
        assert [subscriber.queue.get_nowait() for _ in range(2)] == [Charging(3.0, False), place]
        assert subscriber.queue.empty()
    readers.forget()
    with readers.recording(sparing=True) as subscriber:
        assert subscriber.queue.empty()
