"""One phone's session on a clock of the test's own: when the engine is fed, and what silence leads to."""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.static.settings import Sleep
from stillcal.calib_core.streams.events import Charging, Temperature, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.temperature.thermometer import FRESH_S
from stillcal.daemon.service.engine_thread import EngineThread
from stillcal.daemon.service.live_stream import Interruption
from stillcal.daemon.service.phone_session import CONTINUES_S, GATHER_S, LATE_S, SILENCE_S, PhoneSession
from stillcal.daemon.service.saved_state import SavedState
from stillcal.daemon.sources.base import SerialSettings, Source
from stillcal.daemon.wire.messages import Command, Hello, Identify
from stillcal.daemon.wire.reassembly import WireCounters
from tests.support.clock import ManualClock

CONTINUOUS = EngineSettings(ScheduleSettings(watch="continuous"))
SAMPLES = [Samples.checked(Sensor.ACCELEROMETER, [0.0, 1.0], np.zeros((2, 3)))]


class Phone(Source):
    """A phone that is there and says nothing; what it is sent is kept."""

    def __init__(self) -> None:
        super().__init__(SerialSettings("phone"))
        self.sent: list[Command] = []

    connected, device, wire = True, "phone", WireCounters()

    def send(self, command: Command) -> bool:
        self.sent.append(command)
        return True

    def _connect(self) -> None: ...

    def _lose(self, reason: str, for_good: bool = False) -> None: ...


def with_session(test: Callable[[PhoneSession, Phone, ManualClock], Awaitable[None]]) -> None:
    """Run a test with the session of a phone that has sent SAMPLES and is known up to t = 1 s."""

    async def run() -> None:
        phone, clock = Phone(), ManualClock()
        engine_thread = EngineThread(CONTINUOUS, None, None)
        state = SavedState(EngineState())
        session = PhoneSession(phone, engine_thread, state, 0.0, lambda _: None, clock=clock)
        try:
            await session._on_record(SAMPLES[0])
            await test(session, phone, clock)
        finally:
            engine_thread.close()

    asyncio.run(run())


def test_samples_alone_wait_for_the_engine_and_what_is_due_does_not() -> None:
    async def test(session: PhoneSession, phone: Phone, clock: ManualClock) -> None:
        assert session._may_gather(SAMPLES)
        assert not session._may_gather([*SAMPLES, Charging(2.0, True)])
        assert not session._may_gather([])
        clock.now += 0.999 * GATHER_S
        assert session._may_gather(SAMPLES)
        clock.now += 0.002 * GATHER_S
        assert not session._may_gather(SAMPLES)

    with_session(test)


def test_a_decision_that_is_due_does_not_wait() -> None:
    async def test(session: PhoneSession, phone: Phone, clock: ManualClock) -> None:
        await session._on_record(Charging(2.0, True))
        await session._feed_engine()  # which leaves the charger for when samples are known up to it
        assert session._engine_thread.view.decides == 2.0 and not session._may_gather(SAMPLES)

    with_session(test)


@pytest.mark.parametrize(("silent_s", "asked"), [(0.999 * SILENCE_S, []), (SILENCE_S, [Identify()])])
def test_a_phone_is_asked_again_after_ten_seconds_of_silence(silent_s: float, asked: list[Any]) -> None:
    async def test(session: PhoneSession, phone: Phone, clock: ManualClock) -> None:
        await session._feed_engine()
        assert session._timeout() == SILENCE_S
        clock.now += silent_s
        session._on_timeout()
        assert phone.sent == asked
        session._on_timeout()  # not a second time at once
        assert phone.sent == asked

    with_session(test)


def test_a_silence_is_logged_once_and_the_next_one_again(caplog: pytest.LogCaptureFixture) -> None:
    async def test(session: PhoneSession, phone: Phone, clock: ManualClock) -> None:
        def logged_silences(times: int) -> int:
            caplog.clear()
            for _ in range(times):
                clock.now += SILENCE_S
                session._on_timeout()
            return caplog.text.count("silent: no data")

        assert logged_silences(3) == 1 and phone.sent == [Identify()] * 3
        phone._emit(SAMPLES[0])
        await session._receive()
        assert logged_silences(3) == 1

    with_session(test)


@pytest.mark.parametrize(
    ("t", "what", "reason"),
    [
        (0.5, None, None),  # a little out of order
        (-5.0, "restarted: ", "the phone restarted"),
        (1e9, "leap: ", "the phone's time stamps leapt ahead"),
    ],
)
def test_stamps_that_do_not_continue_are_logged_and_interrupt_the_live_samples(
    t: float, what: str | None, reason: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    async def test(session: PhoneSession, phone: Phone, clock: ManualClock) -> None:
        listener, _ = session._readers.live.subscribe(0.0)
        await session._on_record(Samples.checked(Sensor.ACCELEROMETER, [t, t + 1.0], np.zeros((2, 3))))
        session._send_live()
        heard = [listener.queue.get_nowait() for _ in range(listener.queue.qsize())]
        assert [live.reason for live in heard if isinstance(live, Interruption)] == [reason] * bool(reason)
        assert [record.getMessage().startswith(str(what)) for record in caplog.records] == [True] * bool(what)

    with_session(test)


def test_two_sensors_with_clocks_of_their_own_are_told_once(caplog: pytest.LogCaptureFixture) -> None:
    """Every block is a jump then: each was logged, and cut the live samples."""

    async def test(session: PhoneSession, phone: Phone, clock: ManualClock) -> None:
        listener, _ = session._readers.live.subscribe(0.0)
        for k in range(10):
            clock.now += 1.0
            for sensor, since in ((Sensor.ACCELEROMETER, 0.0), (Sensor.GYROSCOPE, 1.7e9)):
                t = [since + k + 1.0, since + k + 1.5]
                await session._on_record(Samples.checked(sensor, t, np.zeros((2, 3))))
        session._send_live()
        heard = [listener.queue.get_nowait() for _ in range(listener.queue.qsize())]
        assert sum(isinstance(live, Interruption) for live in heard) == 1
        assert len(caplog.records) == 1
        clock.now += CONTINUES_S
        await session._on_record(Samples.checked(Sensor.ACCELEROMETER, [20.0, 21.0], np.zeros((2, 3))))
        assert len(caplog.records) == 2

    with_session(test)


def test_a_session_that_is_another_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    async def test(session: PhoneSession, phone: Phone, clock: ManualClock) -> None:
        for number in (1, 2):
            await session._on_record(Hello(session=number))
            await session._on_record(SAMPLES[0])
        (restarted,) = (r.getMessage() for r in caplog.records if r.getMessage().startswith("restarted"))
        assert "session=2" in restarted

    with_session(test)


def test_the_engine_is_told_the_time_of_a_decision_while_the_phone_sleeps() -> None:
    async def test(session: PhoneSession, phone: Phone, clock: ManualClock) -> None:
        await session._feed_engine()
        due = session._engine_thread.view.decides
        assert session._commands.due(Sleep(math.inf), due, 1.0) == [Sleep(math.inf)]
        wait = session._timeout()
        assert wait == pytest.approx(due - 1.0 + LATE_S)
        clock.now += wait
        assert session._timeout() == 0.0 and session.now == pytest.approx(due + LATE_S)
        session._on_timeout()
        assert session._items == [Tick(due)] and phone.sent == []

    with_session(test)


def test_the_engine_thread_is_busy_for_as_long_as_its_job_goes_on() -> None:
    async def test() -> None:
        clock, go = ManualClock(), threading.Event()
        engine_thread = EngineThread(CONTINUOUS, None, None, clock)
        clock.now += 7.0
        assert engine_thread.busy_for() == 0.0
        job = asyncio.create_task(engine_thread._run(go.wait))
        await asyncio.sleep(0)
        clock.now += 5.0
        assert engine_thread.busy_for() == 5.0
        go.set()
        await job
        assert engine_thread.busy_for() == 0.0
        engine_thread.close()

    asyncio.run(test())


def test_a_reading_of_the_thermometer_ends_with_its_freshness_and_with_its_phone() -> None:
    async def test(session: PhoneSession, phone: Phone, clock: ManualClock) -> None:
        def temperatures(*t: float) -> list[float] | None:
            given = Samples.checked(Sensor.ACCELEROMETER, list(t), np.zeros((len(t), 3)))
            temperature = session._with_temperature(given).temperature
            return None if temperature is None else temperature.tolist()

        await session._on_hello(Hello(claims={"device": "one"}))
        await session._on_record(Temperature(2.0, 30.0))
        assert temperatures(3.0, 2.0 + FRESH_S) == [30.0, 30.0]
        assert np.isnan(temperatures(3.0, 2.1 + FRESH_S) or []).tolist() == [False, True]
        assert temperatures(2.1 + FRESH_S) is None
        await session._on_hello(Hello(claims={"device": "two"}))
        assert temperatures(3.0) is None

    with_session(test)
