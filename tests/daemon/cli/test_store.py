"""`stillcal store …` as a person or a script would use it."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from stillcal.daemon.cli.store import store_group
from stillcal.daemon.store.store import Store


@pytest.fixture
def path(tmp_path, make_record):
    place = tmp_path / "store.json"
    store = Store(place)
    store.publish(make_record(1))
    store.publish(make_record(2), "charging [plugged in]", at=77.0)
    store.reject(make_record(3), "no better")
    return place


def run(*words):
    return CliRunner().invoke(store_group, [str(word) for word in words])


def test_show_prints_both_sensors_and_what_they_rest_on(path):
    result = run("show", path)
    assert result.exit_code == 0
    for said in ("0.020000", "gyroscope bias [rad/s]", "12 rests in 9 attitudes", "9.80665", "number 2"):
        assert said in result.output


def test_show_json_is_the_published_layout(path, make_record):
    value = json.loads(run("show", path, "--json").output)
    assert value["schema"] == 1
    assert value["id"] == make_record(2).id
    assert value["accelerometer"]["bias"] == [0.02, -0.2, 0.3]


def test_history_lists_newest_first_with_reasons_as_written(path, make_record):
    rows = json.loads(run("history", path, "--json").output)
    assert [(row["what"], row["back"]) for row in rows] == [
        ("current", None),
        ("rejected", None),
        ("replaced", 1),
    ]
    assert rows[2]["at"] == 77.0
    text = run("history", path).output
    assert "charging [plugged in]" in text
    assert "at [s]" in text


def test_rollback_by_steps_and_by_id(path, make_record):
    result = run("rollback", path)
    assert result.exit_code == 0
    assert make_record(1).id in result.output
    assert run("rollback", path, "--to", make_record(2).id[:8]).exit_code == 0
    assert Store(path).load().current.id == make_record(2).id


@pytest.mark.parametrize("words", [("--steps", "9"), ("--to", "zzz")])
def test_a_refused_rollback_is_one_line_and_exit_2(path, words):
    result = run("rollback", path, *words)
    assert result.exit_code == 2
    assert len(result.output.splitlines()) == 1


def test_rollback_while_the_daemon_holds_the_store_is_refused(path):
    with Store(path):
        result = run("rollback", path)
    assert result.exit_code == 2
    assert "is in use by process" in result.output


def test_verify_tells_whole_from_damaged(path):
    assert run("verify", path).exit_code == 0
    path.write_bytes(path.read_bytes()[:-40])
    result = run("verify", path)
    assert result.exit_code == 1
    assert "unreadable" in result.output
    report = json.loads(run("verify", path, "--json").output)
    assert report["whole"] is False
    assert report["last_good"]["problem"] is None


def test_a_damaged_store_is_shown_from_its_last_good_copy_and_left_alone(path):
    path.write_bytes(b"bad")
    result = run("show", path)
    assert result.exit_code == 0
    assert "last-good" in result.output
    assert path.read_bytes() == b"bad"


@pytest.mark.parametrize("verb", ["show", "history", "rollback", "verify"])
def test_a_missing_store_is_one_line_and_exit_2_and_nothing_written(tmp_path, verb):
    result = run(verb, tmp_path / "none.json")
    assert result.exit_code == 2
    assert len(result.output.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("verb", ["show", "history", "rollback", "verify"])
def test_help_has_examples(verb):
    assert f"stillcal store {verb} store.json" in run(verb, "--help").output


def test_a_store_without_a_calibration_says_so(tmp_path, make_record):
    Store(tmp_path / "s.json").reject(make_record(1), "too few rests")
    assert run("show", tmp_path / "s.json").output.strip() == "no calibration yet"
