"""`stillcal faces` as a process of its own, with a daemon and the simulated phone on its line in this one."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from stillcal.calib_core.accelerometer.known_attitudes import FACE_DIRECTIONS
from stillcal.daemon.app import Service
from stillcal.daemon.cli.faces import EVERY_S, WAITING
from stillcal.daemon.cli.main import cli
from stillcal.daemon.service import saved_state
from stillcal.daemon.store.store import Store
from stillcal.daemon.wire.messages import Hello
from stillcal.replay.phone import load_phone, simulate
from stillcal.replay.phone.activities.resting import Poses, Rest
from stillcal.replay.phone.scenario import Scenario
from stillcal.replay.serial_phone.link import LinkSettings, PhoneLink, serve_phone
from stillcal.replay.serial_phone.stream import PhoneStream
from tests.support.living import answering, given_in, running, until, within_reason

COMMAND = [str(Path(sys.executable).with_name("stillcal")), "faces"]


@pytest.fixture(scope="module")
def six() -> list[Any]:
    """A phone that is laid on each of its faces, for longer than what a restart may lose."""
    ups = tuple((float(x), float(y), float(z)) for x, y, z in FACE_DIRECTIONS)
    scenario = Scenario(segments=(Poses(ups=ups, rest_s=(30.0, 31.0)), Rest(duration_s=60.0)))
    return list(simulate(scenario, load_phone("consumer"), 1).chunks())


def begun(folder: Path) -> subprocess.Popen[str]:
    words = [*COMMAND, "--socket", str(folder / "socket")]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def laid(service: Service) -> int:
    """Return how many faces the daemon has seen; -1 before it was asked."""
    faces = service.view.faces
    return -1 if faces is None else len(faces.done)


async def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    out, err = await asyncio.to_thread(process.communicate, timeout=30)
    return process.returncode, out, err


def test_a_person_is_told_the_faces_and_gets_the_calibration(folder: Path, six: list[Any]) -> None:
    async def test() -> None:
        async with running(given_in(folder)) as service:
            process = begun(folder)
            await until(lambda: laid(service) == 0)
            await serve_phone(six, {"device": "p"}, path=folder / "tty")
            code, out, err = await ended(process)
            assert (code, err) == (0, "")
            how, _, *lines = out.splitlines()
            assert how.startswith("Lay the phone on each of its six faces")
            assert "0 of 6 faces: lay it on its right edge" in lines[0]
            assert lines[-1].startswith("calibrated: six known faces")

    within_reason(test())
    current = Store(folder / "store.json").load().current
    assert current is not None and current.accelerometer is not None
    assert current.accelerometer.parameters == 12


def test_it_goes_on_through_a_restart_of_the_daemon(folder: Path, six: list[Any]) -> None:
    async def test() -> None:
        given = given_in(folder)
        hello = Hello(session=4, flow="credit")
        async with PhoneLink(PhoneStream(six), hello, LinkSettings(speed=60.0)) as link:
            link.plug(folder / "tty")
            async with running(given) as service:
                process = begun(folder)
                await until(lambda: laid(service) == 0)
                phone = asyncio.create_task(link.serve())
                await until(lambda: laid(service) == 3)
            await asyncio.sleep(4 * EVERY_S)
            async with running(given) as service:
                assert laid(service) >= 3
                code, out, err = await ended(process)
            phone.cancel()
        assert (code, err) == (0, "")
        assert out.count("calibrated: six known faces") == 1
        assert out.count(WAITING) == 1

    within_reason(test())


def test_a_face_is_saved_as_soon_as_it_is_there(folder: Path, six: list[Any]) -> None:
    """A person laid it, and a daemon may be killed at any time."""

    async def test() -> None:
        async with running(given_in(folder)) as service:
            await service.lay_faces(stop=False)
            phone = asyncio.create_task(serve_phone(six, {}, LinkSettings(speed=60.0), path=folder / "tty"))
            await until(lambda: laid(service) == 1)
            await asyncio.sleep(1.0)
            kept = saved_state.load(folder / "store.state").state
            assert kept is not None and kept.engine.faces is not None and kept.engine.faces.done
            phone.cancel()

    within_reason(test())


def test_ctrl_c_stops_it_and_the_sensors_are_not_kept_on(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder) as service:
            process = begun(folder)
            await until(lambda: laid(service) == 0)
            await asyncio.to_thread(process.stdout.readline)  # type: ignore[union-attr]
            process.send_signal(signal.SIGINT)
            code, _, err = await ended(process)
            assert code == 130 and "interrupted" in err
            assert service.view.faces is not None and service.view.faces.stage == "stopped"

    within_reason(test())


def test_what_another_stops_is_said(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder) as service:
            process = begun(folder)
            await until(lambda: laid(service) == 0)
            await service.lay_faces(stop=True)
            code, _, err = await ended(process)
            assert (code, err) == (3, "stillcal: stopped before the sixth face\n")

    within_reason(test())


def test_without_a_daemon_it_says_so(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["faces", "--socket", str(tmp_path / "none")])
    assert result.exit_code == 4 and "no daemon answers" in result.output
