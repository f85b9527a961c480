"""The store on a real file system: one writer, nothing overwritten, the last good copy, migration."""

from __future__ import annotations

import errno
import multiprocessing
import os
import shutil
import stat
from pathlib import Path

import pytest

from stillcal.daemon.store.document import SCHEMA, StoreDocument, parse, render
from stillcal.daemon.store.files import StoreError, StoreLockedError
from stillcal.daemon.store.store import Store, StoreSettings

GOLDEN = Path(__file__).parents[2] / "golden"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "store.json"


@pytest.fixture
def store(path):
    with Store(path) as opened:
        yield opened


def names(folder):
    return {p.name for p in folder.iterdir()}


def test_an_absent_store_is_none(path):
    assert Store(path).load() is None
    assert names(path.parent) == set()


def test_publish_reject_history_rollback(store, make_record):
    store.publish(make_record(1))
    store.publish(make_record(2))
    store.reject(make_record(3), "worse")
    assert store.load().current.id == make_record(2).id
    assert [e.what for e in store.load().history] == ["replaced", "rejected"]
    outcome = store.rollback()
    assert outcome.notes == ()
    assert store.load().current.id == make_record(1).id == outcome.document.current.id


def test_a_refused_rollback_changes_nothing(store, make_record, path):
    store.publish(make_record(1))
    before = path.read_bytes()
    with pytest.raises(ValueError, match="cannot roll back"):
        store.rollback(5)
    assert path.read_bytes() == before


@pytest.mark.parametrize("mode", [0o600, 0o640])
def test_permissions_are_those_set_whatever_the_umask(path, make_record, mode):
    old = os.umask(0o077)
    try:
        with Store(path, StoreSettings(mode=mode)) as store:
            store.publish(make_record(1))
            kept = store.last_good_path
    finally:
        os.umask(old)
    assert stat.S_IMODE(path.stat().st_mode) == mode
    assert stat.S_IMODE(kept.stat().st_mode) == mode


@pytest.mark.parametrize("bad", [{"mode": 0o666}, {"history": 1}, {"history": 100_000}])
def test_settings_out_of_range_are_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        StoreSettings(**bad)


def test_a_second_writer_is_told_who_holds_it(store, path, make_record):
    second = Store(path)
    with pytest.raises(StoreLockedError, match=f"process {os.getpid()}") as refusal:
        second.publish(make_record(1))
    assert refusal.value.pid == os.getpid()
    assert second.load() is None


def test_a_second_process_is_told_too_and_may_read(store, path, make_record):
    store.publish(make_record(1))
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply(_try_to_write, (path,)) == (os.getpid(), make_record(1).id)


def _try_to_write(path):
    other = Store(path)
    try:
        other.lock()
    except StoreLockedError as error:
        return error.pid, other.load().current.id


def test_closing_lets_the_next_writer_in(path, make_record):
    with Store(path) as first:
        first.publish(make_record(1))
    with Store(path) as second:
        second.publish(make_record(2))
    assert len(Store(path).load().history) == 1


def test_a_link_to_a_store_is_the_store(path, make_record, tmp_path):
    link = tmp_path / "link.json"
    link.symlink_to(path)
    with Store(link) as store, pytest.raises(StoreLockedError):
        store.publish(make_record(1))
        Store(path).lock()
    assert link.is_symlink()
    assert Store(path).load().current.id == make_record(1).id


BAD_STORES = {
    "garbage": b"\x00\xff garbage",
    "empty": b"",
    "foreign": b'{"name": "somebody else\'s"}',
    "newer": b'{"schema": 99, "accelerometer": null}',
}


@pytest.mark.parametrize("bad", BAD_STORES.values(), ids=BAD_STORES)
def test_a_bad_store_is_set_aside_and_its_last_good_copy_used(store, path, make_record, bad):
    store.publish(make_record(1))
    store.publish(make_record(2))
    path.write_bytes(bad)
    assert store.load().current.id == make_record(2).id
    assert path.read_bytes() == bad
    outcome = store.recover()
    assert outcome.document.current.id == make_record(2).id
    assert len(outcome.notes) == 1
    assert "set aside as" in outcome.notes[0]
    assert path.with_name("store.json.unreadable-1.json").read_bytes() == bad
    assert parse(path.read_bytes())[0].current.id == make_record(2).id
    assert store.recover().notes == ()


def test_a_file_that_never_was_a_store_is_called_that(store, path):
    path.write_bytes(b"t,ax,ay,az\n0,0,0,9.8\n")
    with pytest.raises(StoreError, match="is no store of calibrations: give the JSON file of one"):
        store.load()


@pytest.mark.parametrize("bad", BAD_STORES.values(), ids=BAD_STORES)
def test_a_bad_store_with_no_good_copy_is_set_aside_and_one_starts_anew(store, path, make_record, bad):
    path.write_bytes(bad)
    store.last_good_path.write_bytes(b"no better")
    with pytest.raises(StoreError, match="holds no good copy: give"):
        store.load()
    outcome = store.publish(make_record(1))
    (note,) = outcome.notes
    assert note.count("set aside as") == 2
    kept = {path.with_name(f"store.json.unreadable-{n}.json").read_bytes() for n in (1, 2)}
    assert kept == {bad, b"no better"}
    assert store.load().current.id == make_record(1).id


@pytest.mark.parametrize("damage", [b"no better", None], ids=["damaged", "missing"])
def test_an_intact_store_without_a_good_copy_gets_one_at_once(store, path, make_record, damage):
    store.publish(make_record(1))
    store.last_good_path.unlink()
    if damage is not None:
        store.last_good_path.write_bytes(damage)
    assert store.verify().whole
    (note,) = store.recover().notes
    assert "written anew from the store" in note
    assert store.last_good_path.read_bytes() == path.read_bytes()
    assert store.recover().notes == ()


def test_what_is_set_aside_never_overwrites_what_was(store, path, make_record):
    for n in range(3):
        store.publish(make_record(n))
        path.write_bytes(b"bad %d" % n)
    store.recover()
    kept = sorted(path.parent.glob("*.unreadable-*"))
    assert [p.read_bytes() for p in kept] == [b"bad 0", b"bad 1", b"bad 2"]


def test_a_flipped_bit_loses_nothing(store, path, make_record):
    store.publish(make_record(1))
    store.publish(make_record(2))
    whole = path.read_bytes()
    at = whole.index(b"0.02") + 3
    path.write_bytes(whole[:at] + b"7" + whole[at + 1 :])
    store.recover()
    assert path.read_bytes() == whole


def test_without_hard_links_the_store_is_renamed_aside(store, path, make_record, monkeypatch):
    def refuse(*args, **kwargs):
        raise OSError(errno.EPERM, "Operation not permitted")

    store.publish(make_record(1))
    path.write_bytes(b"bad")
    monkeypatch.setattr(os, "link", refuse)
    assert store.recover().document.current.id == make_record(1).id
    assert path.with_name("store.json.unreadable-1.json").read_bytes() == b"bad"


def test_removing_the_store_is_a_fresh_start(store, path, make_record):
    store.publish(make_record(1))
    path.unlink()
    assert store.load() is None
    store.publish(make_record(2))
    assert store.load().history == ()


def test_reading_changes_nothing_on_disk(path, make_record):
    path.write_bytes(b"bad")
    path.with_name("store.json.last-good").write_bytes(render(StoreDocument(current=make_record(1))))
    before = {p: (p.read_bytes(), p.stat().st_mtime_ns) for p in path.parent.iterdir()}
    reader = Store(path)
    assert reader.load().current.id == make_record(1).id
    assert not reader.verify().whole
    assert {p: (p.read_bytes(), p.stat().st_mtime_ns) for p in path.parent.iterdir()} == before


@pytest.mark.parametrize("schema", range(SCHEMA))
def test_an_earlier_schema_is_migrated_and_its_original_kept(path, schema):
    golden = GOLDEN / f"store-schema-{schema}.json"
    shutil.copy(golden, path)
    bias = Store(path).load().current.accelerometer.bias.tolist()
    with Store(path) as store:
        outcome = store.recover()
    assert outcome.document.current.accelerometer.bias.tolist() == bias
    assert f"migrated from schema {schema}" in outcome.notes[0]
    assert path.with_name(f"store.json.schema-{schema}-1.json").read_bytes() == golden.read_bytes()
    assert Store(path).verify().store.schema == SCHEMA


def test_the_migrated_can_be_published_over_and_rolled_back_to(path, make_record):
    shutil.copy(GOLDEN / "store-schema-0.json", path)
    with Store(path) as store:
        old = store.load().current.id
        store.publish(make_record(1))
        assert store.rollback().document.current.id == old


def test_a_fifo_is_refused_without_waiting_for_it(path):
    os.mkfifo(path)
    with pytest.raises(StoreError, match="not a regular file"):
        Store(path).load()


def test_a_folder_is_refused(path):
    path.mkdir()
    with pytest.raises(StoreError, match="not a regular file"):
        Store(path).load()


def test_a_monstrous_file_is_not_read_into_memory(path, make_record):
    Store(path).publish(make_record(1))
    with path.open("wb") as file:
        file.truncate(2**36)
    with Store(path) as store:
        outcome = store.publish(make_record(2))
    assert "more than any store has" in outcome.notes[0]


def test_a_missing_folder_is_named(tmp_path, make_record):
    with pytest.raises(StoreError, match=r"nowhere/store\.json: there is no such folder"):
        Store(tmp_path / "nowhere" / "store.json").publish(make_record(1))
