"""A disk, a process or a system that fails for a moment: nothing is taken for damage, nothing is lost."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import stat
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.errors import TryAgainError
from stillcal.daemon.cli.query import NoDaemonError, replies
from stillcal.daemon.service import saved_state
from stillcal.daemon.service.storage import Storage
from stillcal.daemon.settings import SocketSettings
from stillcal.daemon.store.files import StoreError, StoreLockedError
from stillcal.daemon.store.store import Store
from stillcal.daemon.system.files import make_folder
from stillcal.daemon.varlink.address import NAME
from stillcal.daemon.varlink.socket import opened
from stillcal.replay.trials.faults.calls import CALLS, PASSING, failing_call, surviving
from tests.support.asking import STILLCAL


@pytest.fixture
def path(tmp_path: Path, make_record: Any) -> Path:
    """A store with a calibration and a history, and a state beside it."""
    path = tmp_path / "store.json"
    for number in range(3):
        Store(path).publish(make_record(number))
    data = saved_state.encode(saved_state.SavedState(EngineState()))
    saved_state.save(saved_state.state_path(path), data)
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.suffix != ".lock"}


@pytest.mark.parametrize("error", PASSING, ids=errno.errorcode.get)
def test_every_call_of_opening_may_fail_once_and_nothing_is_lost(path: Path, error: int) -> None:
    """At each system call of opening in turn: the daemon is told to try again, then all is there."""
    before = contents(path.parent)
    failed = 0
    for number in range(1, 200):
        storage = Storage(Store(path), lambda note: None)
        with failing_call(number, error) as calls:
            try:
                storage.open()
            except TryAgainError:
                failed += 1
            finally:
                storage.close()
        assert contents(path.parent) == before, f"call {number}: {calls.name}"
        if not calls.failed:
            break
    assert failed > 5 and number < 200
    loaded = Storage(Store(path), lambda note: None).open()
    assert loaded.state is not None and not loaded.note


@pytest.mark.slow
@pytest.mark.parametrize("error", [errno.EIO, errno.EMFILE], ids=errno.errorcode.get)
def test_every_call_of_saving_may_fail_once_and_nothing_is_lost(tmp_path: Path, error: int) -> None:
    found = surviving(error, tmp_path)
    assert found.holds, found
    assert found.counts["calls that failed"] > 20


def test_whatever_keeps_the_state_from_the_disk_its_file_is_named(path: Path) -> None:
    storage = Storage(Store(path), lambda note: None)
    storage.open()
    troubles = []
    for number in range(1, 200):
        with failing_call(number, errno.ENOSPC) as calls:
            saved = asyncio.run(storage.save(b"state"))
        if not calls.failed:
            break
        if not saved:
            troubles.append(storage.trouble)
    storage.close()
    assert not [trouble for trouble in troubles if str(path.parent) not in trouble]
    state = saved_state.state_path(path)
    assert f"cannot write {state}: the disk is full: free some space" in troubles
    assert f"cannot make durable {state}: the disk is full: free some space" in troubles


def test_the_faults_are_really_played(tmp_path: Path) -> None:
    with failing_call(1, errno.EIO) as calls, pytest.raises(OSError, match="Input/output error"):
        os.open(tmp_path / "x", os.O_CREAT | os.O_WRONLY)
    assert calls.failed and calls.name == "open"
    assert {"open", "read", "write", "fsync", "replace"} <= set(CALLS)


@pytest.mark.parametrize("damage", [b"{", b"", b'{"schema": 1, "accelerometer": nul'])
def test_damage_is_still_damage(path: Path, damage: bytes) -> None:
    good = path.read_bytes()
    path.write_bytes(damage)
    outcome = Store(path).recover()
    assert "set aside" in outcome.notes[0] and path.read_bytes() == good


@pytest.mark.parametrize(
    "other", [b"# my notes\n", b'{"schema": 1, "recording": "r07.csv"}', b"t,ax,ay,az\n0,0,0,9.8\n"]
)
def test_somebody_elses_file_is_refused_and_left_as_it_is(tmp_path: Path, other: bytes) -> None:
    path = tmp_path / "notes.txt"
    path.write_bytes(other)
    with pytest.raises(StoreError, match="is not a stillcal store"):
        Store(path).recover()
    assert path.read_bytes() == other
    assert {p.name for p in tmp_path.iterdir()} <= {"notes.txt", "notes.txt.lock"}


def test_a_loop_of_links_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.json").symlink_to("b.json")
    (tmp_path / "b.json").symlink_to("a.json")
    ran = subprocess.run(
        [STILLCAL, "run", "--port", "none", "--store", str(tmp_path / "a.json")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 2
    assert len(ran.stderr.splitlines()) == 1 and "circle" in ran.stderr


def loop(path: Path) -> None:
    """Make a name a link to a link to itself."""
    path.symlink_to(f"{path.name}.other")
    path.with_name(f"{path.name}.other").symlink_to(path.name)


@pytest.mark.parametrize(
    "make",
    [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("/dev/zero"), loop],
    ids=["folder", "fifo", "zero", "loop"],
)
def test_what_is_no_file_in_the_place_of_the_last_good_copy_is_set_aside(
    path: Path, make_record: Any, make: Callable[[Path], None]
) -> None:
    store = Store(path)
    store.last_good_path.unlink()
    make(store.last_good_path)
    kind = stat.S_IFMT(store.last_good_path.lstat().st_mode)
    for number in (9, 10):
        store.publish(make_record(number))
    assert store.verify().last_good.document is not None
    (aside,) = path.parent.glob("*unreadable*")
    assert stat.S_IFMT(aside.lstat().st_mode) == kind


def test_who_removes_the_lock_lets_nobody_write_beside_the_first(path: Path, make_record: Any) -> None:
    first, second = Store(path), Store(path)
    with first:
        path.with_name("store.json.lock").unlink()
        first.publish(make_record(5))
        with pytest.raises(StoreLockedError):
            second.publish(make_record(6))
    with first:
        path.with_name("store.json.lock").unlink()
        with second, pytest.raises(StoreLockedError):
            first.publish(make_record(7))
    assert second.load().current.fitted_at == 5.0


def test_a_store_removed_while_it_is_in_use_is_written_again(path: Path) -> None:
    """Also where its folder was away for a while: what the daemon knows is not lost when it ends."""
    before, notes = path.read_bytes(), list[str]()
    storage = Storage(Store(path), notes.append)
    storage.open()
    for removed in (path, *path.parent.iterdir()):
        removed.unlink(missing_ok=True)
    assert asyncio.run(storage.check())
    assert path.read_bytes() == before and "written again" in notes[-1]
    away = path.parent.with_name("away")
    path.parent.rename(away)
    assert not asyncio.run(storage.check()) and "no such folder" in storage.trouble
    path.parent.mkdir()
    assert asyncio.run(storage.save(b"state"))
    assert path.read_bytes() == before and storage.trouble == ""
    assert notes[-1] == f"{path} and its state are written again"
    assert asyncio.run(storage.save(b"state")) and notes.count(notes[-1]) == 1
    storage.close()


@pytest.mark.parametrize("garbage", [b"", b"\0\0\0", b"{", b"# somebody's notes\n"])
def test_a_store_damaged_with_its_copy_while_it_is_in_use_is_written_again(
    path: Path, garbage: bytes
) -> None:
    before, notes = path.read_bytes(), list[str]()
    storage = Storage(Store(path), notes.append)
    storage.open()
    copy = path.with_name("store.json.last-good")
    for damaged in (path, copy):
        damaged.write_bytes(garbage)
    assert asyncio.run(storage.check())
    assert path.read_bytes() == copy.read_bytes() == before
    assert len(notes) == 1 and notes[0].endswith(": it is written again as it was")
    aside = list(path.parent.glob("store.json.unreadable-*"))
    assert len(aside) == 2 and {p.read_bytes() for p in aside} == {garbage}
    assert asyncio.run(storage.check()) and len(notes) == 1
    storage.close()


@contextmanager
def umask(value: int) -> Iterator[None]:
    before = os.umask(value)
    try:
        yield
    finally:
        os.umask(before)


@pytest.mark.parametrize(("mask", "mode"), [(0o000, 0o750), (0o077, 0o700)])
def test_folders_are_made_for_nobody_else_to_write_whatever_the_umask(
    tmp_path: Path, mask: int, mode: int
) -> None:
    with umask(mask):
        make_folder(tmp_path / "a" / "b", 0o750)
    assert [p.stat().st_mode & 0o777 for p in (tmp_path / "a", tmp_path / "a" / "b")] == [mode, mode]


def test_the_folders_of_store_and_socket_are_for_nobody_else_to_write(tmp_path: Path) -> None:
    store, socket = tmp_path / "kept" / "here" / "store.json", tmp_path / "run" / "here" / "socket"
    with umask(0o000):
        Storage(Store(store), lambda note: None).open()
        with opened(SocketSettings(str(socket)), ()):
            modes = [p.stat().st_mode & 0o777 for p in (*store.parents[:2], *socket.parents[:2])]
    assert modes == [0o750, 0o750, 0o755, 0o755]


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (os.mkfifo, "not a regular file"),
        (lambda path: path.symlink_to("/dev/zero"), "not a regular file"),
        (loop, "its links lead in a circle"),
    ],
    ids=["fifo", "zero", "loop"],
)
def test_a_state_that_is_no_file_is_set_aside(path: Path, make: Callable[[Path], None], what: str) -> None:
    state = saved_state.state_path(path)
    for number in (1, 2):
        state.unlink(missing_ok=True)
        for link in state.parent.glob("*.other"):
            link.unlink()
        make(state)
        storage = Storage(Store(path), lambda note: None)
        loaded = storage.open()
        storage.close()
        assert loaded.state is None and loaded.note.startswith(f"{state}: {what}; moved to ")
        assert not os.path.lexists(state) and os.path.lexists(state.with_name(f"store.state.bad-{number}"))


@pytest.mark.parametrize("name", ["store.json.last-good", "store.state"])
def test_a_daemon_starts_beside_a_loop_of_links(path: Path, name: str, tmp_path: Path) -> None:
    """It serves what the store holds, writes the name anew as it ends, and says in its log what was there."""
    path.with_name(name).unlink()
    loop(path.with_name(name))
    (tmp_path / "stillcal.toml").write_text("")
    where = ("--config", tmp_path / "stillcal.toml", "--store", path, "--socket", tmp_path / "socket")
    command = [STILLCAL, "run", "--port", "none", *map(str, where)]
    daemon = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        while daemon.poll() is None and not asks(tmp_path / "socket"):
            time.sleep(0.05)
    finally:
        daemon.terminate()
        said = daemon.communicate(timeout=60)[1]
    assert daemon.returncode == 0, said
    assert "its links lead in a circle" in said
    assert path.with_name(name).is_file() and not path.with_name(name).is_symlink()


def asks(socket: Path) -> bool:
    with contextlib.suppress(NoDaemonError):
        (reply,) = replies(socket, {"method": f"{NAME}.GetCalibration"})
        return reply["parameters"]["calibration"]["fitted_at_s"] == 2.0
    return False
