"""What the socket answers to the independent varlink client."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import varlink

from stillcal.calib_core.accelerometer.parameters import BIAS
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.suspicion import Suspicion
from stillcal.calib_core.engine.actions import Publish, Reject
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.streams.smoothing import RollingMean
from stillcal.calib_core.temperature.charger import Charger
from stillcal.calib_core.temperature.forecast import Forecast
from stillcal.calib_core.temperature.thermometer import FRESH_S, Thermometer
from stillcal.daemon.service import saved_state
from stillcal.daemon.service.phone_clock import PhoneClock
from stillcal.daemon.service.saved_state import SavedState
from stillcal.daemon.store.store import Store
from stillcal.replay.trials.faults.kill import example
from tests.support.asking import NAME, STILLCAL, ask, asked, client, connected, stored
from tests.support.living import answering, until, within_reason


def test_the_interface_describes_itself(folder: Path) -> None:
    def look() -> tuple[Any, Any]:
        with varlink.Client(address=f"unix:{folder}/socket") as found:
            found.get_interfaces()
            return found.info, found.get_interface(NAME)

    async def test() -> None:
        async with answering(folder):
            info, interface = await asyncio.to_thread(look)
            assert NAME in info["interfaces"] and info["product"] == "stillcal"
            methods = {
                "GetCalibration",
                "GetStatus",
                "GetHistory",
                "GetEnergy",
                "Correct",
                "Monitor",
                "Rollback",
            }
            assert methods <= interface.members.keys()

    within_reason(test())


def test_the_current_calibration_is_the_stores(folder: Path, make_record: Any) -> None:
    record = make_record(3)
    stored(folder, make_record(2), record)

    async def test() -> None:
        async with answering(folder):
            found = (await asked(folder, lambda c: c.GetCalibration()))["calibration"]
            assert found["id"] == record.id
            assert found["accelerometer"]["bias"] == record.accelerometer.bias.tolist()
            assert found["accelerometer"]["unit"] == "m/s^2"
            assert found["accelerometer"].get("bias_uncertainty") is None  # not known on all axes
            assert (found["temperature_min_c"], found["confidence"]) == (20.0, "unchecked")
            entries = (await asked(folder, lambda c: c.GetHistory()))["entries"]
            assert [e["what"] for e in entries] == ["current", "replaced"]
            status = (await asked(folder, lambda c: c.GetStatus()))["status"]
            assert not status["connected"] and status["calibration"] == record.id

    within_reason(test())


def test_a_temperature_that_no_sensor_can_have_is_refused(folder: Path, make_record: Any) -> None:
    stored(folder, make_record(3))

    async def test() -> None:
        async with answering(folder):
            for bad in (-400.0, 1001.0):
                with pytest.raises(varlink.VarlinkError, match=r"InvalidParameter.*temperature_c"):
                    await asked(folder, lambda c, b=bad: c.GetCalibration(b))
                with pytest.raises(varlink.VarlinkError, match=r"InvalidParameter.*temperature_c"):
                    await asked(folder, lambda c, b=bad: c.Correct("gyroscope", [[0.0] * 3], b))
            for possible in (-273.15, 1000.0):
                await asked(folder, lambda c, p=possible: c.GetCalibration(p))

    within_reason(test())


@pytest.mark.parametrize(
    ("method", "given", "wrong"),
    [
        ("GetCalibration", {"temperature_c": -400.0}, "temperature_c"),
        ("GetCalibration", {"temperature_c": 1e9}, "temperature_c"),
        ("Correct", {"sensor": "gyroscope", "samples": [], "temperature_c": -400.0}, "temperature_c"),
        ("Correct", {"sensor": "gyroscope", "samples": [], "smooth_hz": -1.0}, "smooth_hz"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused_also_before_there_is_a_calibration(
    folder: Path, method: str, given: dict[str, Any], wrong: str
) -> None:
    async def test() -> None:
        async with answering(folder):
            said = await ask(await connected(folder), method, parameters=given)
            assert said["error"] == "org.varlink.service.InvalidParameter"
            assert said["parameters"] == {"parameter": wrong}

    within_reason(test())


@pytest.mark.parametrize(
    ("method", "given"),
    [
        ("GetCalibration", {"temperature_c": True}),
        ("GetHistory", {"limit": True}),
        ("GetStillness", {"limit": False}),
        ("GetEnergy", {"limit": True}),
        ("Correct", {"sensor": "gyroscope", "samples": [[0, 0, 0]], "temperature_c": False}),
        ("Correct", {"sensor": "gyroscope", "samples": [[0, 0, 0]], "smooth_hz": True}),
        ("Correct", {"sensor": "gyroscope", "samples": [[0, 0, True]]}),
        ("Stream", {"batch_s": True}),
    ],
)
def test_true_and_false_are_no_numbers(
    folder: Path, make_record: Any, method: str, given: dict[str, Any]
) -> None:
    stored(folder, make_record(3))

    async def test() -> None:
        async with answering(folder):
            said = await ask(await connected(folder), method, parameters=given, more=method == "Stream")
            assert said["error"] == "org.varlink.service.InvalidParameter"

    within_reason(test())


def test_a_calibration_says_which_attitude_would_help_most(folder: Path, make_record: Any) -> None:
    words = "lay it on its left edge (x axis up)"
    record = make_record(3)
    known = dataclasses.replace(record.accelerometer, most_helpful_attitude=words)
    stored(folder, make_record(2), dataclasses.replace(record, accelerometer=known))

    async def test() -> None:
        async with answering(folder):
            found = (await asked(folder, lambda c: c.GetCalibration()))["calibration"]
            assert found["accelerometer"]["most_helpful_attitude"] == words
            assert not found["gyroscope"].get("most_helpful_attitude")
            command = [STILLCAL, "query", "--socket", str(folder / "socket")]
            said = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True)
            assert words in said.stdout, said.stderr

    within_reason(test())


def test_samples_are_corrected_and_their_number_is_bounded(folder: Path, make_record: Any) -> None:
    record = make_record(3)
    stored(folder, record)
    raw = np.random.default_rng(2).normal(0, 9, (1000, 3))

    async def test() -> None:
        async with answering(folder):
            for sensor in Sensor:
                found = await asked(folder, lambda c, s=sensor: c.Correct(str(s), raw.tolist()))
                assert np.array_equal(found["samples"], record.apply(raw, sensor))
            for bad in ([[0.0] * 3] * 1001, [[1.0, 2.0]], [["x", 1.0, 2.0]], [[1.79e308] * 3]):
                with pytest.raises(varlink.VarlinkError, match="InvalidParameter"):
                    await asked(folder, lambda c, b=bad: c.Correct("accelerometer", b))

    within_reason(test())


def test_a_gyroscope_says_what_slow_rotation_may_hide_and_whether_it_is_provisional(
    folder: Path, make_record: Any
) -> None:
    record = make_record(3)
    hourly = np.array([3.0, 4.0, 5.0])
    bounded = dataclasses.replace(record.gyroscope, rotation_admitted=np.radians(hourly) / 3600.0)
    evidence = dataclasses.replace(record.acceptance, how="zeroing", evidence={"provisional": True})
    alone = dataclasses.replace(record, accelerometer=None, gyroscope=bounded, acceptance=evidence)
    stored(folder, alone)

    async def test() -> None:
        async with answering(folder):
            found = (await asked(folder, lambda c: c.GetCalibration()))["calibration"]
            assert found["gyroscope"]["slow_rotation_deg_per_h"] == pytest.approx(hourly)
            assert found["gyroscope"]["provisional"] and found["confidence"] == "unchecked"
            assert found.get("accelerometer") is None
            watch = [STILLCAL, "watch", "--once", "--socket", str(folder / "socket")]
            said = await asyncio.to_thread(subprocess.run, watch, capture_output=True, text=True)
            assert "provisional" in said.stdout and "no calibration yet" in said.stdout
            assert "± without slow rotation at rest: up to 5 °/h" in said.stdout

    within_reason(test())


def test_a_clients_samples_are_smoothed_from_call_to_call(folder: Path, make_record: Any) -> None:
    record = make_record(3)
    stored(folder, record)
    raw = np.random.default_rng(2).normal(0, 9, (100, 3))
    expected = RollingMean(100.0).smoothed(record.apply(raw, Sensor.GYROSCOPE))

    def smoothed(caller: Any, rows: Any, smooth_hz: float) -> Any:
        return caller.Correct(sensor="gyroscope", samples=rows.tolist(), smooth_hz=smooth_hz)

    def two_calls(rate: float) -> list[Any]:
        with client(folder) as caller:
            return [smoothed(caller, raw[:30], 100.0), smoothed(caller, raw[30:], rate)]

    async def test() -> None:
        async with answering(folder):
            first, second = await asyncio.to_thread(two_calls, 100.0)
            assert np.array_equal(first["samples"] + second["samples"], expected)
            assert second["delay_s"] == pytest.approx(0.045)
            _, other = await asyncio.to_thread(two_calls, 50.0)  # another rate begins anew, as a client does
            assert other["samples"][0] == record.apply(raw[30], Sensor.GYROSCOPE).tolist()
            assert "delay_s" not in await asked(folder, lambda c: c.Correct("gyroscope", raw.tolist()))
            with pytest.raises(varlink.VarlinkError, match="InvalidParameter"):
                await asked(folder, lambda c: smoothed(c, raw, 0.0))

    within_reason(test())


def test_without_a_calibration_it_says_what_is_missing(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder):
            with pytest.raises(varlink.VarlinkError) as caught:
                await asked(folder, lambda c: c.GetCalibration())
            assert caught.value.error() == f"{NAME}.NotCalibrated"
            command = [STILLCAL, "query", "--socket", str(folder / "socket")]
            found = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True)
            assert found.returncode == 3 and "too few rests" in found.stderr

    within_reason(test())


def test_changes_are_told_until_the_daemon_stops(folder: Path, make_record: Any) -> None:
    stored(folder, make_record(1))

    def listen(told: list[Any]) -> None:
        with client(folder) as opened:
            told.extend(e["event"] for e in opened.Monitor(_more=True))

    async def test() -> None:
        told: list[Any] = []
        async with answering(folder) as service:
            listening = asyncio.create_task(asyncio.to_thread(listen, told))
            while not len(service.subscribers):
                await asyncio.sleep(0.001)
            service.actions.carry_out(
                [Publish(5.0, make_record(2), "better"), Reject(6.0, make_record(3), "not better")]
            )
        await listening
        assert [e["what"] for e in told] == ["current", "calibrated", "rejected", "ended"]
        assert told[1]["calibration"]["id"] == make_record(2).id and told[1]["reason"] == "better"

    within_reason(test())


def test_rolling_back_is_for_root_and_the_daemons_own_user(folder: Path, make_record: Any) -> None:
    first, second = make_record(1), make_record(2)
    stored(folder, first, second)
    question = json.dumps({"method": f"{NAME}.Rollback"})
    stranger = (
        f"import socket; s = socket.socket(socket.AF_UNIX); s.connect({str(folder / 'socket')!r});"
        f"s.sendall({question!r}.encode() + bytes(1)); print(s.recv(9999).decode())"
    )

    async def test() -> None:
        async with answering(folder, "[socket]\nmode = 0o666\n") as service:
            if os.geteuid() == 0:
                python = [
                    sys.executable if os.access(sys.executable, os.X_OK) else "python3",
                    "-S",
                    "-c",
                    stranger,
                ]
                found = await asyncio.to_thread(
                    subprocess.run,
                    ["setpriv", "--reuid=65534", "--clear-groups", "/usr/bin/python3", *python[1:]],
                    capture_output=True,
                    text=True,
                )
                assert "org.varlink.service.PermissionDenied" in found.stdout, found.stderr
                assert service.document.current.id == second.id
            found = await asked(folder, lambda c: c.Rollback())
            assert found["calibration"]["id"] == first.id == service.view.record.id
            with pytest.raises(varlink.VarlinkError, match="Refused"):
                await asked(folder, lambda c: c.Rollback("ffff"))
        assert Store(folder / "store.json").load().current.id == first.id

    within_reason(test())


def test_who_may_asks_for_a_calibration_and_for_zeroing(folder: Path) -> None:
    record, rests = example()
    assert record.accelerometer is not None

    async def test() -> None:
        async with answering(folder) as service:
            with pytest.raises(varlink.VarlinkError, match="Refused"):
                await asked(folder, lambda c: c.Calibrate())
            service.engine_thread._engine.add_rests(rests)
            found = await asked(folder, lambda c: c.Calibrate())
            assert found["calibration"]["accelerometer"]["n_rests"] == record.accelerometer.n_rests
            await until(lambda: service.document.current is not None)
            assert service.document.current is not None
            assert service.document.current.id == found["calibration"]["id"]
            with pytest.raises(varlink.VarlinkError, match="Refused"):
                await asked(folder, lambda c: c.ZeroNow())  # rests without a gyroscope
            status = (await asked(folder, lambda c: c.GetStatus()))["status"]
            assert status["failed_checks"] == 0 and status["diagnosis"] == ""

    within_reason(test())


def test_answers_follow_the_charger_where_there_is_no_thermometer(folder: Path, make_record: Any) -> None:
    """It was plugged in 4000 s before: a sensor 2400 s behind it has warmed up in part."""
    record, full = make_record(3), np.array([0.001, -0.002, 0.003])
    amplitude = {"amplitude": TermParameter(value=full, unit="rad/s")}
    term = Term(
        effect=BY_CHARGING, sensor=Sensor.GYROSCOPE, parameters=amplitude, reference={"lag_s": 2400.0}
    )
    record = dataclasses.replace(record, terms=(term,))
    stored(folder, record)
    charger = Charger().with_events([Charging(-1e5, False), Charging(1000.0, True)])
    saved = SavedState(EngineState(charger=charger, record=record), PhoneClock(newest=5000.0))
    saved_state.save(saved_state.state_path(folder / "store.json"), saved_state.encode(saved))
    bias = record.gyroscope.bias + full * (1.0 - np.exp(-4000.0 / 2400.0))

    async def test() -> None:
        async with answering(folder):
            found = (await asked(folder, lambda c: c.GetCalibration()))["calibration"]["gyroscope"]
            assert found["follows_charging"] and not found["follows_temperature"]
            assert found["bias_now"] == pytest.approx(bias)
            told = await asked(folder, lambda c: c.Correct("gyroscope", [bias.tolist()]))
            assert np.ravel(told["samples"]) == pytest.approx(np.zeros(3), abs=1e-12)

    within_reason(test())


@pytest.mark.parametrize("known", [True, False])
def test_answers_correct_a_bias_while_charging_or_say_how_far_it_may_be_off(
    folder: Path, make_record: Any, known: bool
) -> None:
    """Before a phone has told of its charger, the bias may be off by the step, and is not corrected."""
    record, step = make_record(3), np.array([0.001, -0.002, 0.003])
    given = {"step": TermParameter(value=step, unit="rad/s")}
    term = Term(effect="gyro_charging_bias", sensor=Sensor.GYROSCOPE, parameters=given)
    bend = {"quadratic": TermParameter(value=np.array([1e-3, 0.0, 0.0]), unit="1/(m/s^2)")}
    bent = Term(effect="accel_nonlinearity", sensor=Sensor.ACCELEROMETER, parameters=bend)
    certain = Forecast(
        at=5000.0, reference=25.0, curve=np.zeros((3, 3)), error=np.zeros((4, 3)),
        covariance=np.zeros((12, 12)), white=0.0, flicker=0.0, walk=0.0,
    )  # fmt: skip
    record = dataclasses.replace(record, terms=(term, bent), forecast={"gyroscope": certain})
    stored(folder, record)
    charger = Charger().with_events([Charging(1000.0, True)] if known else [])
    saved = SavedState(EngineState(charger=charger, record=record), PhoneClock(newest=5000.0))
    saved_state.save(saved_state.state_path(folder / "store.json"), saved_state.encode(saved))
    bias = record.gyroscope.bias + (step if known else 0.0)
    raw = record.accelerometer.bias + np.array([5.0 + 1e-3 * 25.0, 0.0, 0.0])

    async def test() -> None:
        async with answering(folder):
            found = (await asked(folder, lambda c: c.GetCalibration()))["calibration"]["gyroscope"]
            assert found["follows_charging"] and found["bias_now"] == pytest.approx(bias)
            off = np.zeros(3) if known else np.abs(step) / np.sqrt(2.0)
            assert found["bias_uncertainty_now"] == pytest.approx(off)
            told = await asked(folder, lambda c: c.Correct("gyroscope", [bias.tolist()]))
            assert np.ravel(told["samples"]) == pytest.approx(np.zeros(3), abs=1e-12)
            told = await asked(folder, lambda c: c.Correct("accelerometer", [raw.tolist()]))
            straight = record.accelerometer.scale @ np.array([5.0, 0.0, 0.0])
            assert np.ravel(told["samples"]) == pytest.approx(straight, abs=1e-6)

    within_reason(test())


@pytest.mark.parametrize("age_s", [90.0, FRESH_S + 1.0])
def test_biases_are_for_the_latest_reading_of_the_thermometer_unless_a_temperature_is_told(
    folder: Path, make_record: Any, age_s: float
) -> None:
    """One that is too old is none; one of before widens the uncertainty by its age."""
    record, slope = make_record(3), np.array([0.001, -0.002, 0.003])
    term = Term(
        effect="gyro_bias_temperature",
        sensor=Sensor.GYROSCOPE,
        parameters={"slope": TermParameter(value=slope, unit="rad/s/K")},
        reference={"temperature": 25.0},
    )
    curve = np.vstack((10.0 * slope, np.zeros((2, 3))))
    forecast = Forecast(
        at=5000.0, reference=25.0, curve=curve, error=np.zeros((4, 3)), covariance=np.zeros((12, 12)),
        white=0.0, flicker=0.0, walk=0.0, temperature_min=20.0, temperature_max=40.0,
    )  # fmt: skip
    record = dataclasses.replace(record, terms=(term,), forecast={"gyroscope": forecast})
    stored(folder, record)
    heard = Thermometer(np.array([5000.0 - age_s]), np.array([35.0]))
    saved = SavedState(EngineState(thermometer=heard, record=record), PhoneClock(newest=5000.0))
    saved_state.save(saved_state.state_path(folder / "store.json"), saved_state.encode(saved))

    async def test() -> None:
        async with answering(folder):
            told = (await asked(folder, lambda c: c.GetCalibration(30.0)))["calibration"]
            assert (told["temperature_c"], told.get("temperature_age_s")) == (30.0, None)
            assert told["gyroscope"]["bias_now"] == pytest.approx(record.gyroscope.bias + 5.0 * slope)
            assert told["gyroscope"]["bias_uncertainty_now"] == pytest.approx(np.zeros(3))
            found = (await asked(folder, lambda c: c.GetCalibration()))["calibration"]
            if age_s > FRESH_S:
                assert found.get("temperature_c") is None and found.get("temperature_age_s") is None
                assert found["gyroscope"]["bias_now"] == pytest.approx(record.gyroscope.bias)
                return
            assert (found["temperature_c"], found["temperature_age_s"]) == (35.0, age_s)
            assert found["gyroscope"]["bias_now"] == pytest.approx(record.gyroscope.bias + 10.0 * slope)
            uncertain = np.abs(slope) * 0.2 * 1.5
            assert found["gyroscope"]["bias_uncertainty_now"] == pytest.approx(uncertain)
            line = [STILLCAL, "query", "--socket", str(folder / "socket")]
            shown = await asyncio.to_thread(subprocess.check_output, line, text=True)
            assert "temperature_c            35" in shown and "temperature_age_s        90" in shown

    within_reason(test())


def test_a_step_that_is_suspected_widens_what_is_stated(folder: Path, make_record: Any) -> None:
    record = make_record(3)
    known = np.array([0.001, 0.002, 0.003])
    part = dataclasses.replace(record.gyroscope, covariance=np.diag(known**2), names=BIAS)
    record = dataclasses.replace(record, gyroscope=part)
    stored(folder, record)
    step = Suspicion(np.array([0.02, 0.0, 0.0]), np.diag([1e-6, 4e-6, 0.0]))
    state = EngineState(record=record, suspected={Sensor.GYROSCOPE: step})
    saved = SavedState(state, PhoneClock(newest=5000.0))
    saved_state.save(saved_state.state_path(folder / "store.json"), saved_state.encode(saved))

    async def test() -> None:
        async with answering(folder):
            found = (await asked(folder, lambda c: c.GetCalibration()))["calibration"]["gyroscope"]
            assert found["bias_uncertainty"] == pytest.approx(known)
            even = np.sqrt(0.5 * (np.array([1e-6, 4e-6, 0.0]) + np.array([0.0004, 0.0, 0.0])))
            assert found["bias_uncertainty_now"] == pytest.approx(np.hypot(known, even))

    within_reason(test())
