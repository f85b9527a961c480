"""What an operator may type by mistake: devices, FIFOs, other files, empty ids, odd paths; and Ctrl-C."""

from __future__ import annotations

import asyncio
import errno
import io
import os
import signal
import socket
import subprocess
import sys
import threading
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from stillcal.calib_core.errors import UserError
from stillcal.daemon.app import Service
from stillcal.daemon.cli.install import Access, files, install_command
from stillcal.daemon.cli.query import NoDaemonError, query_command, replies
from stillcal.daemon.cli.store import store_group
from stillcal.daemon.store.document import StoreDocument, differences
from stillcal.daemon.store.store import Store
from stillcal.daemon.system.files import NotRegularError, read_regular
from stillcal.daemon.system.systemd import Notifier
from tests.daemon.service.test_process import heard
from tests.support.asking import STILLCAL
from tests.support.living import given_in

MEMORY = 2**30
"""Bytes that a command may use before it counts as reading without end."""


def limited(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run `stillcal` with bounded memory and patience."""
    script = (
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({MEMORY}, {MEMORY}))\n"
        "from stillcal.daemon.cli.entry import main; main()"
    )
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


@pytest.fixture
def path(tmp_path: Path, make_record: Any) -> Path:
    path = tmp_path / "store.json"
    for number in range(3):
        Store(path).publish(make_record(number))
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def run(*arguments: object) -> Result:
    return CliRunner().invoke(store_group, list(map(str, arguments)))


def fifo(folder: Path) -> Path:
    os.mkfifo(folder / "fifo")
    return folder / "fifo"


@pytest.mark.parametrize("what", ["config", "diagnosis", "store", "a FIFO as store"])
def test_a_device_is_no_file_to_read_and_a_pipe_is_no_store_to_write(path: Path, what: str) -> None:
    odd = fifo(path.parent) if what == "a FIFO as store" else Path("/dev/zero")
    arguments = {
        "config": ["run", "--config", odd],
        "diagnosis": ["store", "adopt-terms", path, odd],
        "store": ["run", "--port", "none", "--store", odd],
    }
    ran = limited(*arguments[what.rsplit(maxsplit=1)[-1]])
    assert ran.returncode == 2
    assert "not a regular file" in ran.stderr and len(ran.stderr.splitlines()) == 1


def test_a_file_that_is_not_there_is_named_with_what_to_do(path: Path) -> None:
    ran = limited("store", "adopt-terms", path, "none.json")
    assert (ran.returncode, ran.stderr) == (
        2,
        "stillcal: none.json: No such file or directory; check the path\n",
    )


def test_a_file_that_has_nothing_to_read_now_is_no_file_to_read(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """/proc/kmsg says that it is a regular file, and a read of it that does not wait gives nothing."""
    monkeypatch.setattr("stillcal.daemon.system.files.os.fdopen", lambda *_, **__: NothingNow())
    with pytest.raises(NotRegularError):
        read_regular(path, MEMORY)


class NothingNow(io.BytesIO):
    def read(self, size: int | None = -1) -> bytes:
        return None  # type: ignore[return-value]


@pytest.mark.parametrize("text", ["[" * 100_000, "limit=" + "[" * 100_000])
def test_a_question_of_brackets_is_no_question(text: str) -> None:
    assert CliRunner().invoke(query_command, ["GetHistory", text, "--socket", "none"]).exit_code in (2, 4)


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_are_no_numbers_for_files(path: Path, closed: str) -> None:
    """With standard error closed, what is said at Ctrl-C had gone into the first file that was opened."""
    script = (
        "from stillcal.daemon.cli import entry; entry.open_standard_streams()\n"
        f"import os, sys; file = open({str(path)!r}, 'rb')\n"
        "print('out'); print('err', file=sys.stderr); sys.exit(file.fileno() < 3)"
    )
    command = f'{sys.executable} -c "$0" {closed}'
    assert subprocess.run(["sh", "-c", command, script], check=False, timeout=60).returncode == 0
    shown = subprocess.run(
        ["sh", "-c", f'"$0" store show "$1" {closed}', STILLCAL, path], check=False, timeout=60
    )
    assert shown.returncode == 0


def test_a_replay_replaces_no_file_that_is_no_store(tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("# mine\n")
    table = tmp_path / "table.csv"
    rows = [[9.81, 0, 0], [-9.81, 0, 0], [0, 9.81, 0], [0, -9.81, 0], [0, 0, 9.81], [0, 0, -9.81]]
    table.write_text("ax,ay,az\n" + "".join(",".join(map(str, row)) + "\n" for row in rows * 3))
    ran = limited("replay", table, "--format", "rest", "--store", notes)
    assert ran.returncode == 2, ran.stdout
    assert "is not a stillcal store" in ran.stderr
    assert notes.read_text() == "# mine\n" and {p.name for p in tmp_path.glob("notes*")} <= {
        "notes.txt",
        "notes.txt.lock",
    }


def test_an_empty_id_goes_back_to_nothing(path: Path) -> None:
    before = path.read_bytes()
    result = run("rollback", path, "--to", "")
    assert result.exit_code == 2 and path.read_bytes() == before
    with pytest.raises(ValueError, match="id"):
        Store(path).rollback("")


def test_a_rollback_that_cannot_be_moves_no_damaged_store_away(path: Path) -> None:
    path.write_text(path.read_text().replace("number 2", "by hand"))
    before = contents(path.parent)
    assert run("rollback", path, "--steps", 9).exit_code == 2
    path.with_name("store.json.last-good").unlink()
    path.write_text("")
    assert run("rollback", path).exit_code == 2 and path.exists()
    assert contents(path.parent).keys() == before.keys() - {"store.json.last-good"}


# Running


@pytest.mark.parametrize(
    ("odd", "message"),
    [
        ({"store": "/"}, "is a folder"),
        ({"port": "\udcff"}, "is no UTF-8 text"),
        ({"socket": "s" * 120}, "path too long"),
        ({"publish": ("store.mcap",), "store": "store.mcap"}, "are the same"),
    ],
)
def test_a_name_that_cannot_be_is_refused_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, odd: dict[str, Any], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    options = replace(given_in(tmp_path), **odd)

    async def start() -> None:
        service = Service(options.settings(), options, Notifier({}))
        service.open()
        await service.run()

    with pytest.raises(UserError, match=message):
        asyncio.run(start())


def test_a_group_for_the_socket_that_is_not_there_is_refused(tmp_path: Path) -> None:
    more = ["--store", tmp_path / "store.json", "--socket", tmp_path / "socket", "--socket-group", "no-such"]
    ran = limited("run", "--port", "none", *more)
    assert ran.returncode == 2 and "no such group" in ran.stderr


def test_what_answers_but_is_no_daemon_and_a_socket_that_is_forbidden_are_said(folder: Path) -> None:
    path = folder / "socket"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        for answer in (b"HTTP/1.1 400\0", b"[]\0", b""):
            asking = threading.Thread(target=lambda text=answer: _answer(listener, text))
            asking.start()
            with pytest.raises(NoDaemonError, match="no daemon answers"):
                list(replies(path, {"method": "x"}))
            asking.join()
    forbidden = NoDaemonError(path, PermissionError(errno.EACCES, "Permission denied"))
    assert "you may not connect" in str(forbidden) and "start one" not in str(forbidden)


def _answer(listener: socket.socket, text: bytes) -> None:
    line, _ = listener.accept()
    with line:
        line.recv(100)
        line.sendall(text)


def test_a_terminal_without_a_letter_shows_its_number(path: Path) -> None:
    command = [sys.executable, "-c", "from stillcal.daemon.cli.entry import main; main()"]
    environ = {**os.environ, "PYTHONIOENCODING": "ascii"}
    words = [*command, "store", "history", str(path)]
    ran = subprocess.run(words, capture_output=True, text=True, env=environ, check=False)
    assert ran.returncode == 0 and "m/s\\xb2" in ran.stdout


# Repairing


def test_a_store_edited_by_hand_is_shown_and_then_taken(path: Path) -> None:
    text = path.read_text()
    edited = text.replace('"reason": "number 2"', '"reason": "by hand"', 1)
    assert edited != text
    path.write_text(edited)
    assert "store repair" in run("verify", path).output
    shown = run("repair", path)
    assert shown.exit_code == 0
    assert 'acceptance.reason: "number 2" -> "by hand"' in shown.output
    assert path.read_text() == edited
    taken = run("repair", path, "--yes")
    assert taken.exit_code == 0 and Store(path).verify().whole
    current = Store(path).load().current  # type: ignore[union-attr]
    assert current.acceptance.reason == "by hand"
    assert path.with_name("store.json.replaced-1.json").read_text() == edited
    assert "nothing differs" in run("repair", path).output


def test_a_store_that_was_set_aside_is_brought_back(path: Path, make_record: Any) -> None:
    good = path.read_bytes()
    aside = path.with_name("store.json.unreadable-1.json")
    aside.write_bytes(good)
    path.unlink()
    Store(path).publish(make_record(9))
    assert run("repair", path, "--from", aside, "--yes").exit_code == 0
    assert path.read_bytes() == good
    kept = path.with_name("store.json.replaced-1.json")
    assert run("repair", path, "--from", kept, "--yes").exit_code == 0
    assert Store(path).load().current.id == make_record(9).id  # type: ignore[union-attr]


@pytest.mark.parametrize("bad", [b"", b"{", b'{"schema": 1}', b"\xff"])
def test_what_no_edit_makes_a_store_is_refused(path: Path, bad: bytes) -> None:
    path.write_bytes(bad)
    result = run("repair", path, "--yes")
    assert result.exit_code == 2 and path.read_bytes() == bad
    (line,) = result.output.splitlines()
    assert f"{path} cannot be taken as a store" in line and "with --from, give" in line


@pytest.mark.parametrize("verb", ["show", "history", "rollback", "verify", "repair", "adopt-terms"])
@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo], ids=["folder", "fifo"])
def test_what_is_no_file_is_no_store_and_nothing_is_left_beside_it(
    tmp_path: Path, make: Callable[[Path], None], verb: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stillcal.daemon.system.files.FIRST_WRITER_S", 0.1)
    odd = tmp_path / "odd"
    make(odd)
    result = run(verb, odd, *(["x.json"] if verb == "adopt-terms" else []))
    (line,) = result.output.splitlines()
    assert result.exit_code == 2 and str(odd) in line
    assert "not a regular file" in line or (odd.is_fifo() and "nobody writes to this pipe" in line)
    assert list(tmp_path.iterdir()) == [odd]


def test_differences_name_every_value_once(make_record: Any) -> None:
    one, two = (StoreDocument(current=make_record(n)) for n in (1, 2))
    assert differences(one, one) == []
    places = [line.split(": ")[0] for line in differences(one, two)]
    assert len(places) == len(set(places))
    assert {"accelerometer.bias", "fitted_at", "acceptance.reason", "gyroscope.zeroed_at"} <= set(places)


# Installing


@pytest.mark.parametrize("port", ["/dev/tty\"A'", "/dev/serial/by-id/*", "C:\\x", "/dev/ü\x7f"])
def test_any_port_stands_in_the_settings_as_it_was_given(port: str) -> None:
    *_, (_, text) = files(port, Access())
    assert tomllib.loads(text)["source"]["port"] == port


def test_a_command_in_an_odd_folder_is_one_word_of_the_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/opt/still cal 50%/bin/stillcal"])
    (_, unit), *_ = files("/dev/ttyACM0", Access())
    (line,) = (line for line in unit.splitlines() if line.startswith("ExecStart="))
    assert line == 'ExecStart="/opt/still cal 50%%/bin/stillcal" run --config /etc/stillcal/stillcal.toml'


@pytest.mark.parametrize(
    ("port", "why"), [("/dev/\udcff", "is no UTF-8 text"), ("", "--port is empty: name")]
)
def test_a_port_that_is_none_is_refused(tmp_path: Path, port: str, why: str) -> None:
    result = CliRunner().invoke(install_command, ["--root", str(tmp_path), "--port", port])
    assert result.exit_code == 2 and why in result.output
    assert not list(tmp_path.iterdir())


def test_the_machines_own_sensors_can_be_installed() -> None:
    *_, (_, text) = files("unused", Access(), iio=True)
    assert tomllib.loads(text)["source"] == {"kind": "iio"}
    assert CliRunner().invoke(install_command, ["--iio", "--port", "x", "--print"]).exit_code == 2


@pytest.mark.parametrize(("folder", "setting"), [("/tmp/x", "PrivateTmp"), ("/home/me", "ProtectHome")])
def test_what_the_service_cannot_see_is_warned_of(tmp_path: Path, folder: str, setting: str) -> None:
    result = CliRunner().invoke(install_command, ["--port", f"{folder}/tty", "--root", str(tmp_path)])
    assert (
        result.exit_code == 0 and f"{folder}/tty is out of the service's reach ({setting}=)" in result.output
    )


# Interrupting


IMPORTED = (
    "class Interrupting:\n"
    "    def find_spec(self, name, *more):\n"
    "        if name == 'stillcal.daemon.{}': signal.raise_signal(signal.SIGINT)\n"
    "sys.meta_path.insert(0, Interrupting())\n"
)
CALLED = (
    "from {0} import {1} as owner\n"
    "def interrupted(*args, call=owner.{2}):\n"
    "    signal.raise_signal(signal.SIGINT)\n"
    "    return call(*args)\n"
    "owner.{2} = interrupted\n"
)


@pytest.mark.parametrize(
    "moment",
    [
        IMPORTED.format("cli.main"),
        IMPORTED.format("app"),
        CALLED.format("stillcal.daemon.store.store", "Store", "recover"),
        CALLED.format("asyncio", "events", "new_event_loop"),
        CALLED.format("stillcal.daemon.app", "Service", "_listen_to_signals"),
    ],
    ids=["entry", "commands", "store", "asyncio", "listening"],
)
def test_an_interruption_at_any_moment_of_the_start_is_one_line_and_130(tmp_path: Path, moment: str) -> None:
    script = f"import sys, signal\n{moment}from stillcal.daemon.cli.entry import main; main()\n"
    more = ["--port", "none", "--store", tmp_path / "store.json", "--socket", tmp_path / "socket"]
    command = [sys.executable, "-c", script, "run", *map(str, more)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert ran.returncode == 130, ran.stderr
    said = [line for line in ran.stderr.splitlines() if " INFO " not in line]
    assert said == ["stillcal: interrupted; nothing half-written"] and not (tmp_path / "socket").exists()


def test_a_reload_asked_for_while_it_starts_does_not_end_it(tmp_path: Path) -> None:
    moment = CALLED.format("stillcal.daemon.store.store", "Store", "recover").replace("SIGINT", "SIGHUP")
    script = f"import sys, signal\n{moment}from stillcal.daemon.cli.entry import main; main()\n"
    more = ["--port", "none", "--store", tmp_path / "store.json", "--socket", tmp_path / "socket"]
    command = [sys.executable, "-c", script, "run", *map(str, more)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as daemon:
        heard(daemon, "ready")
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(30) == 0


def test_the_console_script_is_that_entry() -> None:
    project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
    assert project["scripts"]["stillcal"] == "stillcal.daemon.cli.entry:main"


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (
            ["store", "rollback", "store.json", "5"],
            "argument (5): see `stillcal store rollback --help`",
        ),
        (["store", "export", "store.json"], "Choose from: kalibr, px4, "),
        (["faces", "--bogus"], "No such option '--bogus': see `stillcal faces --help`"),
        (["record", "r.csv", "--hours", "x"], "'x' is not a number: see `stillcal record --help`"),
    ],
)
def test_a_mistyped_command_is_one_line_that_names_its_help(words: list[str], why: str) -> None:
    said = limited(*words)
    (line,) = said.stderr.splitlines()
    assert said.returncode == 2 and line.startswith("stillcal: ") and why in line
