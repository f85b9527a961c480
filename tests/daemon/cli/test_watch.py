"""`stillcal watch`: what is shown, in words, on the map, in a frame and in a terminal of its own."""

from __future__ import annotations

import asyncio
import os
import pty
import select
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from stillcal.calib_core.accelerometer.observability import places, sphere
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.cli.main import cli
from stillcal.daemon.cli.watch import sentences as words
from stillcal.daemon.cli.watch.snapshot import Snapshot, snapshot
from stillcal.daemon.cli.watch.sphere import COLUMNS, ROWS, Glyphs, inside, place, sphere_map
from stillcal.daemon.store.store import Store
from tests.support.living import answering, within_reason

STILLCAL = str(Path(sys.executable).with_name("stillcal"))


# The map


def test_every_direction_lies_inside_its_disc_and_opposite_ones_apart() -> None:
    within = inside()
    for up in sphere():
        disc, row, column = place(up)
        assert disc == (up[2] < 0) and within[row, column]
        assert place(-up) != place(up)


def test_equal_areas_of_the_sphere_are_equal_numbers_of_characters() -> None:
    """Lambert's projection: directions spread evenly fall evenly on the disc, here on its inner half."""
    up = sphere(20_000)
    found = np.array([place(u) for u in up if u[2] > 0])
    y = (found[:, 1] - ROWS // 2) / (ROWS // 2)
    x = (found[:, 2] - COLUMNS // 2) / (COLUMNS // 2)
    assert np.mean(x**2 + y**2 <= 0.5) == pytest.approx(0.5, abs=0.06)  # of 13 x 27 characters


def test_faces_stand_where_the_page_says() -> None:
    left, right, upright, over, back, face = (place(up) for up in _faces())
    middle = (ROWS // 2, COLUMNS // 2)
    assert left == (0, ROWS // 2, COLUMNS - 1) and right == (0, ROWS // 2, 0)
    assert upright == (0, 0, COLUMNS // 2) and over == (0, ROWS - 1, COLUMNS // 2)
    assert back == (0, *middle) and face == (1, *middle)


def _faces() -> list[Any]:
    eye = np.eye(3)
    return [sign * eye[k] for k in range(3) for sign in (1.0, -1.0)]


def test_the_map_counts_rests_and_marks_the_newest_and_the_wanted() -> None:
    up = places()
    text = sphere_map([(up[0], 3), (up[10], 12)], up[10], -up[0], Glyphs()).plain
    assert "3" in text and "●" in text and "◎" in text and "9" not in text
    assert "9" in sphere_map([(up[10], 12)], None, None, Glyphs()).plain


# Words


def _snapshot(windows: int = 10, still: int = 10, rests: Any = (), **status: Any) -> Snapshot:
    known = {"connected": True, "sensing": True, "missing": [], "rests_held": 0, "charging": None}
    stillness = {"windows": windows, "windows_still": still, "rests_held": len(rests), "rests": list(rests)}
    return Snapshot(Path("socket"), status=known | status, stillness=stillness)


@pytest.mark.parametrize(
    ("windows", "still", "said"),
    [(14, 14, "at rest"), (14, 10, "moving"), (14, 12, "partly at rest"), (10, 10, "measuring")],
)
def test_stillness_is_what_the_windows_since_the_last_frame_were(windows: int, still: int, said: str) -> None:
    assert words.stillness(_snapshot(windows, still), _snapshot()) == said


def test_it_says_what_is_waited_for_the_most_pressing_first() -> None:
    assert "disk" in words.next_step(_snapshot(trouble="no space left", connected=False))
    assert "phone" in words.next_step(_snapshot(connected=False))
    assert words.next_step(_snapshot()) == "leave the phone lying still"
    assert "charger" in words.next_step(_snapshot(rests_held=8, charging=False))
    wanting = _snapshot(rests_held=8, missing=["lay it on its face", "another"])
    assert words.next_step(wanting) == "lay it on its face; 1 more needed after that"
    calibrated = replace(_snapshot(degraded=True), calibration={"id": "x"})
    assert "no longer fits" in words.next_step(calibrated)


def test_while_known_faces_are_laid_it_says_which_one_comes_next() -> None:
    right, left = "lay it on its right edge (x axis down)", "lay it on its left edge (x axis up)"
    faces = {"stage": "laying", "done": 4, "missing": [right, left], "note": ""}
    laying = replace(_snapshot(degraded=True, rests_held=8), faces=faces)
    assert words.next_step(laying) == f"4 of 6 faces: {right}"
    wanted = words.wanted_attitude(laying)
    assert wanted is not None and wanted.up.tolist() == [-1.0, 0.0, 0.0]
    tilted = replace(laying, faces=faces | {"note": "lay it flat"})
    assert words.next_step(tilted) == f"lay it flat; 4 of 6 faces: {right}"
    over = replace(laying, faces=faces | {"stage": "calibrated", "missing": []})
    assert "no longer fits" in words.next_step(over)


def test_the_attitude_that_would_help_most_is_the_one_left_out() -> None:
    """Of the sphere's 26 named places all but those around screen down."""
    rests = [{"force": (9.8 * up).tolist()} for up in places() if up[2] > -0.1]
    wanted = words.wanted_attitude(_snapshot(rests=rests))
    assert wanted is not None and "screen down" in wanted.words
    assert words.wanted_attitude(_snapshot(rests=[{"force": (9.8 * up).tolist()} for up in places()])) is None


# A daemon


def watched(folder: Path, *options: str, columns: int = 130) -> Result:
    arguments = ["watch", "--once", "--socket", str(folder / "socket"), *options]
    return CliRunner(env={"COLUMNS": str(columns)}).invoke(cli, arguments)


def faces_at_rest() -> list[Any]:
    """Six faces at rest for 20 s each, 50 Hz, and the turning between them, 4 s."""
    rng, items, t0 = np.random.default_rng(3), [], 0.0
    for up in _faces():
        t = t0 + np.arange(1200) / 50.0
        force = 9.8 * np.tile(up, (1200, 1))
        force[1000:] += rng.normal(0, 3, (200, 3))
        rates = rng.normal(0, 0.002, (1200, 3))
        rates[1000:] += rng.normal(0, 1, (200, 3))
        items.append(Samples.checked(Sensor.GYROSCOPE, t, rates))
        items.append(Samples.checked(Sensor.ACCELEROMETER, t, force + rng.normal(0, 0.01, (1200, 3))))
        t0 = float(t[-1]) + 0.02
    return items


def test_one_frame_shows_rests_and_what_is_missing(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder) as service:
            await service.engine_thread.feed([Charging(0.0, False), *faces_at_rest()])
            service.saved.clock.mapped(Charging(150.0, False), 0.0)
            now = await asyncio.to_thread(snapshot, folder / "socket")
            assert 5 <= now.stillness["rests_held"] <= 6  # the last face may still be open
            assert now.stillness["windows_still"] < now.stillness["windows"]
            newest, oldest = now.stillness["rests"][0], now.stillness["rests"][-1]
            assert newest["t_end_s"] > oldest["t_end_s"] and oldest["force"][0] == pytest.approx(
                9.8, abs=0.01
            )
            result = await asyncio.to_thread(watched, folder)
            assert result.exit_code == 0, result.output
            assert "next orientation to record" in result.output and "no calibration yet" in result.output
            picture = folder / "frame.svg"
            drawn = await asyncio.to_thread(watched, folder, "--svg", str(picture))
            assert drawn.exit_code == 0, drawn.output
            text = picture.read_text()
            assert text.startswith("<svg") and "orientation" in text and "url(http" not in text

    within_reason(test())


def test_one_frame_shows_the_calibration_in_the_units_that_people_use(folder: Path, make_record: Any) -> None:
    record = make_record(3)  # x bias 0.03 m/s^2 = 3.06 mg, y bias of the gyroscope -2e-3 rad/s
    Store(folder / "store.json").publish(record)

    async def test() -> None:
        async with answering(folder):
            result = await asyncio.to_thread(watched, folder)
            for shown in (record.id, "not verified yet", "3.06", "-0.1146", "20 to 35 °C", "0.11 mg rms"):
                assert shown in result.output

    within_reason(test())


@pytest.mark.parametrize("columns", [40, 56, 80, 120])
def test_a_frame_is_whole_in_a_terminal_of_any_usual_width(
    folder: Path, make_record: Any, columns: int
) -> None:
    record = make_record(3)
    slow = replace(record.gyroscope, rotation_admitted=np.full(3, 1437.0 * np.pi / 180.0 / 3600.0))
    Store(folder / "store.json").publish(replace(record, gyroscope=slow))

    shown: list[str] = []

    async def test() -> None:
        async with answering(folder) as service:
            service.saved.energy.samples(1.0, 123_456)
            shown.extend((await asyncio.to_thread(watched, folder, columns=columns)).output.splitlines())

    within_reason(test())
    assert max(map(len, shown)) <= columns
    assert not any("…" in line for line in shown)  # no number is cut
    titles = [line for line in shown if "   screen up   " in line or "   screen down   " in line]
    assert len(titles) == (2 if columns < 63 else 1)
    text = " ".join(" ".join(shown).replace("│", " ").split())
    if columns < 120:
        assert "± without slow rotation at rest: up to 1400 °/h" in text
    for number in ("3.06", "-0.1146", "1.00000"):
        assert number in text


def test_no_daemon_is_one_line_and_code_4(folder: Path) -> None:
    result = watched(folder)
    assert result.exit_code == 4 and "no daemon answers" in result.output
    assert len(result.output.strip().splitlines()) == 1


# A terminal


class Terminal:
    """A pseudo-terminal with `stillcal watch` in it."""

    def __init__(self, folder: Path) -> None:
        self.master, slave = pty.openpty()
        command = [STILLCAL, "watch", "--every", "0.1", "--socket", str(folder / "socket")]
        environment = os.environ | {"TERM": "xterm", "COLUMNS": "130", "LINES": "40"}
        self.process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, env=environment)
        os.close(slave)
        self.shown = ""

    def until(self, text: str) -> None:
        """Read until `text` was shown, as the last frame's part."""
        self.shown = self.shown[self.shown.rfind("\x1b[H") :]
        deadline = time.monotonic() + 30
        while text not in self.shown:
            ready, _, _ = select.select([self.master], [], [], max(deadline - time.monotonic(), 0))
            if not ready:
                raise AssertionError(f"{text!r} was not shown: {self.shown[-2000:]!r}")
            try:
                self.shown += os.read(self.master, 65536).decode(errors="replace")
            except OSError:
                raise AssertionError(f"it ended before {text!r}: {self.shown[-2000:]!r}") from None


def daemon(folder: Path) -> subprocess.Popen[bytes]:
    places = [f"--{name}={folder / name}" for name in ("port", "store", "socket")]
    return subprocess.Popen([STILLCAL, "run", *places], stderr=subprocess.DEVNULL)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_outlives_a_daemon_and_gives_the_terminal_back(folder: Path, number: signal.Signals) -> None:
    terminal = Terminal(folder)
    running: list[subprocess.Popen[bytes]] = []
    try:
        terminal.until("no daemon answers")
        for _ in range(2 if number is signal.SIGINT else 1):
            running.append(daemon(folder))
            terminal.until("waiting for the phone")
            running[-1].terminate()
            running[-1].wait()
            terminal.until("no daemon answers")
        terminal.process.send_signal(number)
        terminal.until("\x1b[?1049l")  # the screen from before
        assert "\x1b[?25h" in terminal.shown  # and the cursor
        assert terminal.process.wait(10) == 0
        assert "Traceback" not in terminal.shown
    finally:
        for process in (terminal.process, *running):
            process.kill()
            process.wait()
        os.close(terminal.master)
