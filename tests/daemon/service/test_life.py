"""The whole daemon lives with a simulated phone: as replayed, through restarts, asleep, with another one."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from stillcal.calib_core.engine.actions import Publish, Reject
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.static.settings import DetectorSettings
from stillcal.daemon.app import Service
from stillcal.daemon.app_launch import LaunchOptions
from stillcal.daemon.service import saved_state
from stillcal.daemon.store.document import StoreDocument
from stillcal.daemon.store.store import Store
from stillcal.daemon.wire.messages import Hello
from stillcal.replay.runner import replay
from stillcal.replay.serial_phone.link import LinkSettings, PhoneLink, serve_phone
from stillcal.replay.serial_phone.stream import PhoneStream
from tests.support.living import answering, given_in, running, until, within_reason

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


@pytest.mark.parametrize("watch", ["auto", "probing"])
def test_lived_over_the_wire_and_replayed_give_the_same_store(
    tmp_path: Path, lab: list[Any], watch: Any
) -> None:
    schedule = ScheduleSettings(watch=watch, attitudes_wanted=12)
    kept: list[Any] = []
    settings = EngineSettings(schedule, detector=DetectorSettings(seed=7))
    replayed = replay(lab, Engine(settings), kept.append)
    text = f'[engine.schedule]\nwatch = "{watch}"\nattitudes_wanted = 12\n[engine.detector]\nseed = 7\n'
    given = given_in(tmp_path, text)

    async def test() -> None:
        async with running(given) as service:
            await serve_phone(lab, {"device": "p"}, path=tmp_path / "tty")
            await until(lambda: service.engine_thread.view.counters == replayed.state.counters)
            counts = service.saved.energy.days[0]
            assert counts.asked_s == replayed.ledger.asked_s
            if watch == "probing":
                assert 0 < counts.sensors_on_s < 0.5 * counts.observed_s

    within_reason(test())
    found = Store(tmp_path / "store.json").load() or StoreDocument()
    assert [found.current.id if found.current else None] == [
        None,
        *[a.record.id for a in kept if isinstance(a, Publish)],
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
                await until(lambda: service.engine_thread.view.counters.rests >= 8)
            held = saved_state.load(tmp_path / "store.state").state.engine.counters.rests
            assert held >= 8
            async with running(given) as service:
                assert service.engine_thread.view.counters.rests == held
                await until(lambda: fully_calibrated(service))
            await phone
        assert service.document.current.accelerometer.n_rests >= 23

    within_reason(test())


def test_each_daemon_draws_the_pauses_of_its_own_phone_and_keeps_them(tmp_path: Path) -> None:
    async def seed_of(given: LaunchOptions) -> int:
        async with running(given) as service:
            used = service.engine_thread._engine.settings.detector.seed
            assert used == service.seed
            return used

    async def test() -> None:
        folders = [tmp_path / name for name in "ab"]
        for folder in folders:
            folder.mkdir()
        seeds = [await seed_of(given_in(folder)) for folder in folders]
        assert 0 not in seeds and len(set(seeds)) == 2
        assert await seed_of(given_in(folders[0])) == seeds[0]
        assert await seed_of(given_in(folders[0], "[engine.detector]\nseed = 5\n")) == 5

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
            assert service.engine_thread.view.counters.rests >= 20
            assert service.session.refused == 0

    within_reason(test())


def test_a_phone_in_real_time_sleeps_when_it_is_told(tmp_path: Path, lab: list[Any]) -> None:
    """One whose time does not wait: probes of 1 s, and nothing between them."""
    given = given_in(tmp_path, PROBING)

    async def test() -> None:
        phone = LinkSettings(speed=1.0, credit=False)
        async with running(given) as service:
            link = asyncio.create_task(serve_phone(lab, {}, phone, tmp_path / "tty"))
            await until(lambda: service.engine_thread.view.ledger.probes >= 2)
            day = service.saved.energy.days[0]
            assert day.wakeups >= 2 and day.sensors_on_s < 0.9 * day.observed_s
            assert service.engine_thread.view.ledger.lapsed == 0
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
            while behind != {False, True} or not clock.newest > 1.5:
                if known := service.engine_thread._engine.present.latest:
                    behind.add(max(known.values()) < clock.newest)
                await asyncio.sleep(0.01)
        link.cancel()
        assert behind == {False, True}
        state = saved_state.load(tmp_path / "store.state").state
        assert state is not None and max(state.engine.latest.values()) == clock.newest

    within_reason(test())


def fully_calibrated(service: Service) -> bool:
    """Tell whether the store's calibration is a full one; the gyroscope's bias alone comes before it."""
    current = service.document.current
    return current is not None and current.accelerometer is not None


def test_another_phone_begins_anew_and_the_olds_calibration_is_in_the_history(
    tmp_path: Path, lab: list[Any], caplog: pytest.LogCaptureFixture
) -> None:
    async def test() -> None:
        async with running(given_in(tmp_path)) as service:
            await serve_phone(lab, {"device": "old"}, path=tmp_path / "tty")
            await until(lambda: fully_calibrated(service))
            first = service.document.current.id
            await serve_phone(lab[:1], {"device": "old"}, path=tmp_path / "tty")
            assert service.current_id == first
            held = service.view.rests_held
            await serve_phone(lab[:1], {"device": "new"}, path=tmp_path / "tty")
            await until(lambda: not fully_calibrated(service))
            record = service.view.record
            assert record is None or record.accelerometer is None
            assert service.view.rests_held < held
            (entry,) = [e for e in service.document.history if e.what == "replaced"]
            assert entry.calibration.id == first and "changed from old to new" in entry.reason
            assert service.saved.device == "new"

    within_reason(test())
    assert saved_state.load(tmp_path / "store.state").state.device == "new"
    found = Store(tmp_path / "store.json").rollback().document.current
    assert found is not None and found.acceptance.how == "rollback"


def test_a_phone_that_comes_back_under_the_same_name_is_known_by_bias_and_scale(
    tmp_path: Path, make_record: Any, caplog: pytest.LogCaptureFixture
) -> None:
    async def test() -> None:
        first, other = make_record(0), make_record(300)  # 3 m/s^2 apart
        again = replace(first, fitted_at=1e6)
        async with answering(tmp_path) as service:
            for record in (first, other, again):
                caplog.clear()
                service.actions.carry_out([Publish(1.0, record, "newer")])
                await until(lambda record=record: service.current_id == record.id)
                said = [r.getMessage() for r in caplog.records if r.getMessage().startswith("another phone")]
                assert len(said) == (record is not first)
            assert f"earlier={first.id}" in said[0]

    within_reason(test())
