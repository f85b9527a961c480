"""The store under fire: killed anywhere in its write path, on full, read-only and failing disks."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from stillcal.daemon.store.atomic import NotDurableError, write_atomically
from stillcal.daemon.store.document import StoreDocument, render
from stillcal.daemon.store.files import StoreError
from stillcal.daemon.store.store import Store
from stillcal.replay.trials.faults.disk import fsync_failing_at

KILLS = 30
NAMES = {
    "store.json",
    "store.json.last-good",
    "store.json.lock",
    "store.json.tmp",
    "store.json.last-good.tmp",
}
CALLS = ("open", "write", "fsync", "fchmod", "replace", "close")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "store.json"


def in_child(action) -> tuple[int, int]:
    """Fork, run `action(report)` in the child, return (exit code or -signal, last number it reported)."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receive)
        try:
            action(lambda number: os.write(send, b"%d\n" % number))
        except BaseException:
            os._exit(1)
        os._exit(0)
    os.close(send)
    with os.fdopen(receive, "rb") as lines:
        reported = [int(line) for line in lines if line.endswith(b"\n")]
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status), (reported or [0])[-1]


@pytest.mark.slow
def test_killed_at_random_moments_it_is_whole_and_has_all_that_was_acknowledged(path, make_record):
    """Kill -9 while saves follow one another: nothing torn, nothing acknowledged lost."""
    chance = random.Random(20260101)
    records = [make_record(number, states=20) for number in range(400)]
    done = 0
    for _ in range(KILLS):
        done = _kill_after(path, records, done, chance.randint(1, 6), chance.random())
        found = Store(path).verify()
        assert found.whole, found
        assert found.last_good.document is not None
        kept = int(Store(path).load().current.fitted_at)
        assert done <= kept <= done + 1
        assert {p.name for p in path.parent.iterdir()} <= NAMES
        done = kept


def _kill_after(path: Path, records: list, done: int, saves: int, more: float) -> int:
    """Let a child save on from `done`; kill it some way into the save after the given number of them."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        store = Store(path)
        for number in range(done + 1, len(records)):
            store.publish(records[number])
            os.write(send, b"%d\n" % number)
        os._exit(0)
    os.close(send)
    with os.fdopen(receive, "rb") as lines:
        for _ in range(saves):
            done = int(lines.readline())
        for _ in range(int(more * 300_000)):
            pass
        os.kill(child, signal.SIGKILL)
        rest = [int(line) for line in lines if line.endswith(b"\n")]
    os.waitpid(child, 0)
    return rest[-1] if rest else done


def test_killed_at_every_system_call_of_a_save_it_is_whole(path, make_record):
    """Walk the crash through the write path, call by call, until a save gets through alive."""
    Store(path).publish(make_record(0))
    old, new = make_record(0).id, make_record(1).id
    seen = set()
    for crash_at in range(1, 200):
        died, _ = in_child(lambda report, at=crash_at: _save_and_die(path, make_record(1), at))
        found = Store(path).verify()
        assert found.whole, f"torn by a crash at call {crash_at}: {found}"
        assert found.last_good.document is not None
        seen.add(Store(path).load().current.id)
        if died != -signal.SIGKILL:
            break
        Store(path).save(StoreDocument(current=make_record(0)))
    assert died == 0
    assert crash_at > 12
    assert seen == {old, new}


def _save_and_die(path: Path, record, at: int) -> None:
    """Publish, but die by SIGKILL right before the at-th call into the system."""
    calls = 0

    def dying(call):
        def wrapped(*args, **kwargs):
            nonlocal calls
            calls += 1
            if calls == at:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*args, **kwargs)

        return wrapped

    store = Store(path)
    store.lock()
    for name in CALLS:
        setattr(os, name, dying(getattr(os, name)))
    store.publish(record)


def assert_intact(path: Path, before: bytes) -> None:
    assert path.read_bytes() == before
    assert Store(path).verify().whole
    assert not path.with_name(path.name + ".tmp").exists()
    assert not path.with_name(path.name + ".last-good.tmp").exists()


@pytest.mark.parametrize("failing", [1, 3], ids=["of the copy", "of the store"])
def test_a_failing_fsync_leaves_the_old_store(path, make_record, failing):
    """The only fault that is played rather than had: a disk that reports EIO."""
    with Store(path) as store:
        store.publish(make_record(1))
        before = path.read_bytes()
        with fsync_failing_at(failing), pytest.raises(StoreError, match="the disk reports an error"):
            store.publish(make_record(2))
        assert_intact(path, before)
        store.publish(make_record(3))
        assert [e.calibration.id for e in store.load().history] == [make_record(1).id]


def test_a_store_whose_folder_cannot_be_synced_is_in_place_and_says_so(path, make_record):
    with fsync_failing_at(4), pytest.raises(StoreError, match="cannot make durable"):
        Store(path).publish(make_record(1))
    assert Store(path).load().current.id == make_record(1).id


def test_a_folder_that_cannot_be_synced_is_told_apart(tmp_path):
    with fsync_failing_at(2), pytest.raises(NotDurableError):
        write_atomically(tmp_path / "file", b"new")
    assert (tmp_path / "file").read_bytes() == b"new"


def test_the_file_that_could_not_be_written_is_named(tmp_path):
    with fsync_failing_at(1), pytest.raises(OSError, match="Input/output error") as refused:
        write_atomically(tmp_path / "file", b"new")
    assert refused.value.filename == str(tmp_path / "file")


def test_a_file_that_may_not_grow_leaves_the_old_store(path, make_record):
    """A real limit (RLIMIT_FSIZE) in a child process: the kernel refuses the write half-way."""

    def limited(report):
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
        try:
            Store(path).publish(make_record(2))
        except StoreError as error:
            report(int("may write" in str(error)))

    Store(path).publish(make_record(1))
    before = path.read_bytes()
    assert len(before) > 2000
    assert in_child(limited) == (0, 1)
    assert_intact(path, before)


MOUNTED = textwrap.dedent("""
    import errno, os, subprocess, sys
    from pathlib import Path
    from stillcal.daemon.store.store import Store, StoreError
    from stillcal.daemon.store.document import parse
    folder, source, fault = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    document, _ = parse(source.read_bytes())
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", folder], check=True)
    path = folder / "store.json"
    store = Store(path)
    store.publish(document.current)
    before = path.read_bytes()
    if fault == "full":
        with open(folder / "ballast", "wb", buffering=0) as ballast:
            try:
                while True:
                    ballast.write(bytes(4096))
            except OSError as error:
                assert error.errno == errno.ENOSPC
    else:
        subprocess.run(["mount", "-o", "remount,ro", folder], check=True)
    try:
        store.reject(document.history[0].calibration, "worse")
    except StoreError as error:
        print(error)
    assert path.read_bytes() == before
    assert store.verify().whole
    assert not list(folder.glob("*.tmp"))
    if fault == "full":
        os.unlink(folder / "ballast")
        store.reject(document.history[0].calibration, "worse")
        assert len(store.load().history) == 1
""")


@pytest.mark.parametrize(("fault", "said"), [("full", "the disk is full"), ("read-only", "read-only")])
def test_a_full_or_read_only_disk_leaves_the_old_store(tmp_path, make_record, fault, said):
    """A real tmpfs in a mount namespace of its own, filled to the brim or remounted read-only."""
    script, source = tmp_path / "mounted.py", tmp_path / "source.json"
    script.write_text(MOUNTED)
    document = StoreDocument().after_publishing(make_record(1), 32).after_publishing(make_record(2), 32)
    source.write_bytes(render(document))
    (tmp_path / "disk").mkdir()
    inside = ["unshare", "--user", "--map-root-user", "--mount"]
    if subprocess.run([*inside, "true"], check=False, capture_output=True).returncode:
        pytest.skip("this machine gives no mount namespaces")
    command = [*inside, sys.executable, str(script), str(tmp_path / "disk"), str(source), fault]
    ran = subprocess.run(command, check=False, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert said in ran.stdout


@pytest.mark.parametrize("name", ["store.json.tmp", "store.json.last-good.tmp"])
@pytest.mark.parametrize("what", ["a crash's", "a link", "a FIFO"])
def test_whatever_lies_in_a_temporarys_place_goes_and_is_not_written_to(path, make_record, what, name):
    victim, temporary = path.with_name("victim"), path.with_name(name)
    victim.write_bytes(b"precious")
    {"a crash's": Path.touch, "a link": lambda p: p.symlink_to(victim), "a FIFO": os.mkfifo}[what](temporary)
    Store(path).publish(make_record(1))
    assert not os.path.lexists(temporary) and Store(path).verify().whole
    assert victim.read_bytes() == b"precious"
