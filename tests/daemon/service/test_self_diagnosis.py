"""The daemon diagnoses what it has kept: in a process of its own, within a budget, and says what it found."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from msgspec import structs

from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.streams.events import Tick
from stillcal.daemon import app
from stillcal.daemon.cli.main import cli
from stillcal.daemon.cli.watch import sentences
from stillcal.daemon.cli.watch.snapshot import snapshot
from stillcal.daemon.service import saved_state, self_diagnosis
from stillcal.daemon.service.saved_state import SavedState
from stillcal.daemon.service.self_diagnosis import Night, NightReport
from stillcal.daemon.settings import DiagnosisSettings
from stillcal.daemon.store.store import Store
from stillcal.replay.formats.daemon_state import kept_rests
from stillcal.replay.serial_phone.link import serve_phone
from tests.calib_core.calibration.test_following import HOUR, G, lived
from tests.calib_core.calibration.test_trial import EFFECT, MATRIX, sensitive
from tests.support.asking import asked
from tests.support.living import given_in, running, until, within_reason

KEPT_HOURS = 20.0


def kept_for_the_night(folder: Path) -> None:
    """Leave the state and store of a daemon that was calibrated and is on the charger.

    Its gyroscope is sensitive to force. Its rests end at 0 s, where the phone of the test begins.
    """
    engine = Engine(EngineSettings(schedule=ScheduleSettings(gravity=G)))
    back = KEPT_HOURS * HOUR
    rests = [
        structs.replace(r, t_start=r.t_start - back, t_end=r.t_end - back)
        for r in sensitive(lived(KEPT_HOURS))
    ]
    engine.add_rests(rests)
    engine.feed(Tick(0.0))
    engine.calibrate()
    state = engine.state
    state.charging = True
    assert state.record is not None and state.record.gyroscope is not None
    Store(folder / "store.json").publish(state.record)
    data = saved_state.encode(SavedState(state))
    saved_state.save(saved_state.state_path(folder / "store.json"), data)


def night(folder: Path, lab: list[Any], monkeypatch: pytest.MonkeyPatch, text: str) -> dict[str, Any]:
    """Let the daemon live through a night of a few seconds; return what it then answers."""
    kept_for_the_night(folder)
    monkeypatch.setattr(app, "LOOK_FOR_NIGHT_S", 0.01)
    monkeypatch.setattr(self_diagnosis, "NICENESS", 1)  # on a busy machine it would wait for minutes
    given = given_in(folder, f"[diagnosis]\ncharging_s = 0\n{text}")
    answers = {}

    async def test() -> None:
        async with running(given) as service:
            phone = asyncio.create_task(serve_phone(lab[:1], {}, path=folder / "tty"))
            await until(lambda: service.saved.night.at is not None)
            answers["found"] = (await asked(folder, lambda c: c.GetFindings()))["diagnosis"]
            answers["watched"] = sentences.diagnosis(await asyncio.to_thread(snapshot, folder / "socket"))
            await phone

    within_reason(test(), 300.0)  # its process gives way to all others on a busy machine
    return answers


@pytest.mark.slow
def test_at_night_it_finds_what_its_rests_show_and_puts_it_on_trial(
    folder: Path, lab: list[Any], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    answers = night(folder, lab, monkeypatch, "")
    found = answers["found"]
    assert found["trouble"] == "" and found["verdict"] == "identified"
    handled = {f["effect"]: f["handled"] for f in found["findings"]}
    assert handled[EFFECT] == "on_trial"
    assert handled["accel_bias_temperature"] == handled["gyro_bias_temperature"] == "corrected"
    (one,) = [json.loads(f["json"]) for f in found["findings"] if f["effect"] == EFFECT]
    assert np.allclose(one["parameters"]["matrix"]["value"], MATRIX, atol=1e-5)
    assert 0.5 < found["processor_s"] < 60.0 and 30e6 < found["memory_bytes"] < 384 * 2**20
    assert "sensitive to acceleration (g-sensitivity) (being tested)" in answers["watched"]
    assert "The gyroscope's bias changes with temperature (corrected)" in answers["watched"]
    said = [line for line in caplog.text.splitlines() if "self-diagnosis: " in line]
    assert len(said) == 1 + 3 and "3 found" in said[0] and "simulation" not in caplog.text
    (tested,) = [line for line in said if "g-sensitivity" in line]
    assert "deg/s/g" in tested and "Not corrected yet: tested on later rests" in tested
    assert all("deg/s/K" in line or "mg/K" in line for line in said if "Corrected" in line)
    (shown,) = [f for f in found["findings"] if f["effect"] == "gyro_bias_temperature"]
    assert shown["statement"] == f"The gyroscope's bias changes with temperature: {shown['size']}."
    assert shown["outcome"].startswith("corrected") and "mg/K" not in shown["size"]
    kept = saved_state.load(folder / "store.state").state
    assert kept.night.verdict == "identified"
    assert [trial.term.effect for trial in kept.engine.trials] == [EFFECT]


@pytest.mark.parametrize(
    ("budget", "trouble"),
    [("processor_s = 0.2", "more than 0.2 s of processor"), ("memory_mib = 20", "more than 20 MiB")],
)
def test_it_is_ended_where_it_takes_more_than_its_budget(
    folder: Path, lab: list[Any], monkeypatch: pytest.MonkeyPatch, budget: str, trouble: str
) -> None:
    answers = night(folder, lab, monkeypatch, budget)
    assert trouble in answers["found"]["trouble"] and answers["found"]["findings"] == []
    assert trouble in answers["watched"]


def test_findings_end_with_their_phone_and_are_not_given_to_the_next_one(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = NightReport(5.0, 40, "identified", ("{}",))

    async def test() -> None:
        async with running(given_in(folder, "")) as service:
            service.saved.device, service.saved.night = "one", found

            async def exchanged(*_: object) -> NightReport:
                await service.session._check_identity("two")
                return found

            monkeypatch.setattr(app, "diagnose", exchanged)
            await service._diagnose_itself(5.0, 40)
            assert service.saved.device == "two" and service.saved.night == NightReport()

    within_reason(test(), 60.0)


@pytest.mark.parametrize("answer", ["", "{}", "[]", '{"verdict": "match", "findings": [{"effect": 1}]}'])
def test_an_answer_of_another_version_is_a_trouble_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    monkeypatch.setattr(self_diagnosis, "_PROGRAM", f"print({answer!r})")
    report = asyncio.run(self_diagnosis.diagnose(tmp_path / "store.state", DiagnosisSettings(), 5.0, 40))
    assert "makes no sense" in report.trouble and report.read() == []


def test_the_rests_of_a_state_are_read_as_a_table_of_rests(tmp_path: Path) -> None:
    kept_for_the_night(tmp_path)
    memory = saved_state.load(tmp_path / "store.state").state.engine.memory
    rests = kept_rests(tmp_path / "store.state")
    assert np.array_equal([r.rate for r in rests], memory.rate)
    assert np.array_equal([r.force_uncertainty for r in rests], memory.force_sd)
    assert [r.temperature for r in rests] == memory.celsius.tolist()
    assert np.array_equal([r.charged for r in rests], memory.charged, equal_nan=True)
    saved_state.save(tmp_path / "empty.state", saved_state.encode(SavedState(Engine().state)))
    refused = CliRunner().invoke(cli, ["diagnose", str(tmp_path / "empty.state")])
    assert "no rests are kept yet" in str(refused.exception)


def test_a_night_is_an_hour_on_the_charger_and_comes_once_a_day() -> None:
    tonight, settings, none = Night(), DiagnosisSettings(), NightReport()

    def due(t: float, charging: bool | None = True, rests: int = 100, last: NightReport = none) -> bool:
        return tonight.is_due(t, charging, rests, last, settings)

    assert not due(0.0) and not due(3599.0) and due(3600.0)
    assert not due(3600.0, rests=10)
    assert not due(3700.0, last=NightReport(at=3600.0)) and due(76_000.0, last=NightReport(at=3600.0))
    assert not due(3800.0, charging=False) and not due(3900.0) and due(7500.0)
    assert not due(7500.0, charging=None) and not due(7600.0)
