"""Both sides of each limit that the store draws: sizes, history, line width, locks, refusals."""

from __future__ import annotations

import errno
import fcntl
import os

import pytest

from stillcal.daemon.store import store as store_module
from stillcal.daemon.store.atomic import write_atomically
from stillcal.daemon.store.files import MAX_BYTES, StoreError, StoreLockedError, read, store_error, take_lock
from stillcal.daemon.store.store import Store, StoreSettings


@pytest.fixture
def path(tmp_path):
    return tmp_path / "store.json"


# Settings


def test_as_shipped_a_store_is_its_owners_and_keeps_32():
    settings = StoreSettings()
    assert (settings.mode, settings.history, settings.path) == (0o600, 32, "")


@pytest.mark.parametrize("history", [2, 1000])
def test_the_shortest_and_the_longest_history_are_taken(path, make_record, history):
    with Store(path, StoreSettings(history=history)) as store:
        store.publish(make_record(1))
    assert Store(path).load().current is not None


@pytest.mark.parametrize("history", [1, 1001])
def test_a_history_beyond_its_limits_is_refused(history):
    with pytest.raises(ValueError, match=r"within 2\.\.1000"):
        StoreSettings(history=history)


@pytest.mark.parametrize("mode", [0o601, 0o577, 0o641, 0o637, 0o644])
def test_no_other_permissions_are_taken(mode):
    with pytest.raises(ValueError, match="mode = 0o"):
        StoreSettings(mode=mode)


def test_each_change_keeps_as_many_as_the_settings_say(path, make_record):
    with Store(path, StoreSettings(history=2)) as store:
        for number in range(5):
            store.publish(make_record(number))
        assert [e.calibration.fitted_at for e in store.load().history] == [2.0, 3.0]
        store.reject(make_record(7), "worse")
        store.reject(make_record(8), "worse")
        assert [e.calibration.fitted_at for e in store.load().history] == [3.0, 8.0]
        store.rollback(1)
        assert [e.what for e in store.load().history] == ["rejected", "rolled_back"]
        store.retire("another phone")
        assert len(store.load().history) == 2


# Files

TORN = b'{"schema": 1, "format": "stillcal cal'
"""The beginning of a store: damaged, and still a store's."""


def test_64_megabytes_are_read_and_not_a_byte_more(path):
    for size, said in ((MAX_BYTES, "not JSON"), (MAX_BYTES + 1, "more than any store has")):
        with path.open("wb") as file:
            file.truncate(size)
        found = read(path)
        assert found.document is None and said in str(found.problem)
    assert MAX_BYTES == 64 * 1024 * 1024


def test_a_file_too_large_for_a_store_and_without_a_twin_is_somebody_elses(path):
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(StoreError, match="is not a stillcal store"):
        Store(path).recover()
    assert path.stat().st_size == MAX_BYTES + 1
    assert [p.name for p in path.parent.iterdir() if "unreadable" in p.name] == []


def test_a_lock_without_a_number_names_nobody(path):
    lock = path.with_name("lock")
    lock.write_text("somebody")
    with lock.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(StoreLockedError, match="another process") as refusal:
            take_lock(lock, path)
    assert refusal.value.pid is None


def test_a_lock_says_who_holds_it_and_is_its_owners_alone(path):
    lock = path.with_name("lock")
    lock.write_text("a longer line than a number\n" * 3)
    lock.unlink()
    os.close(take_lock(lock, path))
    assert lock.read_text() == f"{os.getpid()}\n"
    assert lock.stat().st_mode & 0o777 == 0o600
    lock.write_text("9" * 100)
    os.close(take_lock(lock, path))
    assert lock.read_text() == f"{os.getpid()}\n"


def test_a_lock_that_is_a_link_is_not_followed(path):
    other = path.with_name("other")
    other.write_text("mine")
    path.with_name("lock").symlink_to(other)
    with pytest.raises(StoreError, match="cannot lock"):
        take_lock(path.with_name("lock"), path)
    assert other.read_text() == "mine"


def test_locking_twice_is_locking_once_and_closing_twice_harms_nobody(path):
    store = Store(path)
    store.lock()
    store.lock()
    store.close()
    with Store(path):
        store.close()
        with pytest.raises(StoreLockedError):
            store.lock()


def test_a_change_within_a_lock_leaves_the_lock(path, make_record):
    with Store(path) as store:
        store.publish(make_record(1))
        with pytest.raises(StoreLockedError):
            Store(path).lock()
    unlocked = Store(path)
    unlocked.publish(make_record(2))
    Store(path).lock()


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOSPC, "the disk is full"),
        (errno.EDQUOT, "quota"),
        (errno.EFBIG, "ulimit"),
        (errno.EROFS, "read-only"),
        (errno.EACCES, "permission denied"),
        (errno.EPERM, "not permitted"),
        (errno.ENOENT, "no such folder"),
        (errno.EIO, "dmesg"),
        (errno.EMFILE, "raise the limit (ulimit -n)"),
    ],
)
def test_what_the_system_refuses_is_said_with_what_to_do(path, number, said):
    text = str(store_error(OSError(number, os.strerror(number)), path, "write"))
    assert text.startswith(f"cannot write {path}: ") and said in text


def test_an_error_without_a_number_keeps_its_own_words(path):
    assert str(store_error(OSError("strange"), path, "read")) == f"cannot read {path}: strange"


def test_names_set_aside_are_numbered_from_one_to_the_last(path, make_record, monkeypatch):
    taken = []

    def link(source, target, **how):
        taken.append(target.name)
        raise FileExistsError

    path.write_bytes(TORN)
    monkeypatch.setattr(store_module.os, "link", link)
    with pytest.raises(StoreError, match="9,999 files set aside"):
        Store(path).recover()
    assert taken[0] == "store.json.unreadable-1.json"
    assert taken[-1] == "store.json.unreadable-9999.json" and len(taken) == 9999


@pytest.mark.parametrize("number", [errno.EPERM, errno.ENOTSUP])
def test_a_file_system_without_links_renames(path, make_record, monkeypatch, number):
    def refuse(*args, **kwargs):
        raise OSError(number, "no links here")

    path.write_bytes(TORN)
    monkeypatch.setattr(store_module.os, "link", refuse)
    Store(path).recover()
    assert path.with_name("store.json.unreadable-1.json").read_bytes() == TORN


def test_a_link_that_fails_otherwise_changes_nothing(path, monkeypatch):
    def refuse(*args, **kwargs):
        raise OSError(errno.EIO, "I/O error")

    path.write_bytes(TORN)
    monkeypatch.setattr(store_module.os, "link", refuse)
    with pytest.raises(StoreError, match=r"cannot set aside .*dmesg"):
        Store(path).recover()
    assert path.read_bytes() == TORN


def test_a_link_in_the_stores_place_is_set_aside_itself(tmp_path):
    """A dangling name or a link to somebody's file: what it points to is not given a second name."""
    other = tmp_path / "other.json"
    other.write_bytes(TORN)
    path = tmp_path / "store.json"
    store = Store(path)
    path.symlink_to(other)
    store.recover()
    aside = tmp_path / "store.json.unreadable-1.json"
    assert aside.is_symlink() and other.read_bytes() == TORN


def test_starting_anew_removes_the_damaged_names(path):
    path.write_bytes(TORN)
    outcome = Store(path).recover()
    assert outcome.document.current is None and len(outcome.notes) == 1
    assert not path.exists() and not Store(path).last_good_path.exists()


def test_a_file_is_made_for_its_owner_and_open_to_readers_where_asked(tmp_path):
    for mode in (0o644, 0o600):
        write_atomically(tmp_path / "file", b"data", mode)
        assert (tmp_path / "file").stat().st_mode & 0o777 == mode
    write_atomically(tmp_path / "as_shipped", b"data")
    assert (tmp_path / "as_shipped").stat().st_mode & 0o777 == 0o644


def test_a_temporary_is_removed_where_the_rename_fails(tmp_path):
    (tmp_path / "file").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_atomically(tmp_path / "file", b"data")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
