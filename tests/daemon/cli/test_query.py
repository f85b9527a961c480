"""`stillcal query`: arguments as NAME=VALUE, answers as tables."""

from __future__ import annotations

import asyncio
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from stillcal.daemon.cli.answer_text import MOST_ROWS, lines
from stillcal.daemon.cli.query import NoDaemonError
from tests.support.asking import STILLCAL, stored
from tests.support.living import answering, within_reason


def test_arguments_are_names_with_values_json_or_standard_input(folder: Path, make_record: Any) -> None:
    stored(folder, *(make_record(n) for n in range(1, 5)))

    async def query(*words: str, given: str = "") -> subprocess.CompletedProcess[str]:
        command = [STILLCAL, "query", *words, "--socket", str(folder / "socket")]
        return await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, input=given)

    async def test() -> None:
        async with answering(folder):
            three = [
                await query("GetHistory", "limit=1", "--json"),
                await query("GetHistory", '{"limit": 1}', "--json"),
                await query("GetHistory", "-", "--json", given='{"limit": 1}'),
            ]
            answers = [json.loads(said.stdout)["entries"] for said in three]
            assert len(answers[0]) == 2  # the current one and one earlier
            assert answers[0] == answers[1] == answers[2]
            table = (await query("GetHistory")).stdout.splitlines()
            assert len(table) == 1 + 4
            assert table[0].split()[:2] == ["id", "what"]
            assert (await query("Reload")).stdout == "done\n"
            refused = await query("Rollback", "to=123456")  # a text, although it reads as a number
            assert "no earlier calibrations with an id beginning with '123456'" in refused.stderr
            for wrong in ("limit", "[1]", "=3"):
                said = await query("GetHistory", wrong)
                assert (said.returncode, len(said.stderr.splitlines())) == (2, 1), said.stderr
            for wrong, why in (
                ("limit=many", 'limit cannot be "many"; give a whole number from 0 on, such as 5'),
                ("limit=-1", "limit cannot be -1; give a whole number from 0 on, such as 5"),
                ("limt=1", "no parameter is called limt"),
            ):
                said = await query("GetHistory", wrong)
                expected = f"{why}; expected: GetHistory(limit: ?int) (? may be left out)\n"
                assert (said.returncode, expected in said.stderr) == (2, True), said.stderr
            for words, why in (
                ((), "is missing"),
                (("samples=[[1,2]]",), "cannot be [[1, 2]]; give rows of"),
            ):
                said = await query("Correct", "sensor=gyroscope", *words)
                assert f"samples {why}" in said.stderr
                assert "; expected: Correct(sensor: (accelerometer, gyr" in said.stderr
                assert "[][] a list of rows [x, y, z]" in said.stderr

    within_reason(test())


@pytest.mark.parametrize(
    "method",
    ["", ".", "a.b.c", "a.b.C", "getStatus", "GetStatu", "Get Status", "io.stillcal.Calibration.X", "ä"],
)
def test_a_method_that_is_not_there_is_bad_input_and_those_that_are_are_named(
    folder: Path, method: str
) -> None:
    async def test() -> None:
        async with answering(folder):
            command = [STILLCAL, "query", method, "--socket", str(folder / "socket")]
            said = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True)
        shown = method.removeprefix("io.stillcal.Calibration.")
        assert said.returncode == 2 and said.stdout == ""
        (line,) = said.stderr.splitlines()
        assert f"no method {shown!r}: give one of Calibrate, Correct, " in line and "Reload" in line

    within_reason(test())


@pytest.mark.parametrize("words", [["\udcff"], ["GetHistory", "limit=\udcff"], ["Rollback", "to=\udcff"]])
def test_a_word_that_is_no_text_is_refused_before_anybody_is_asked(folder: Path, words: list[str]) -> None:
    command = [STILLCAL, "query", *words, "--socket", str(folder / "none")]
    said = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (said.returncode, len(said.stderr.splitlines())) == (2, 1) and "is no UTF-8 text" in said.stderr


@pytest.mark.parametrize("verb", [["query"], ["watch", "--once"], ["record", "r.csv"]])
def test_a_socket_path_that_can_be_none_is_bad_input(tmp_path: Path, verb: list[str]) -> None:
    (tmp_path / "store.json").write_text("{}")
    for path, why in (
        (tmp_path / ("a" * 108), "107 bytes at most: give a shorter one"),
        (tmp_path / "store.json", "is no socket: give the path of the daemon's"),
        (tmp_path, "is no socket: give the path of the daemon's"),
    ):
        command = [STILLCAL, *verb, "--socket", str(path)]
        said = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
        assert said.returncode == 2 and said.stdout == ""
        (line,) = said.stderr.splitlines()
        assert line.startswith(f"stillcal: {path}: ") and why in line


def test_a_table_is_aligned_and_says_what_it_leaves_out() -> None:
    rows = [{"why": "x" * 40, "n": n, "on": None} for n in range(MOST_ROWS + 1)]
    text = list(lines({"rows": rows}))
    assert text[1].split() == ["n", "on", "why"]  # the widest column is the last
    assert text[2].index("x") == text[-2].index("x")
    assert len(text) == 1 + 1 + MOST_ROWS + 1
    assert text[-1].strip() == "(1 more: --json prints all)"
    assert "more" not in "\n".join(lines({"rows": rows[:MOST_ROWS]}))


def test_a_table_with_several_long_texts_gives_them_lines_of_their_own_below_their_row() -> None:
    rows = [
        {"effect": f"e{n}", "size": "x " * 40, "json": "{}", "probability": 0.97, "outcome": f"{n} y " * 30}
        for n in range(2)
    ]
    text = list(lines({"findings": rows}))
    assert text[1].split() == ["effect", "probability"] and "json" not in "\n".join(text)
    assert text[2].split() == ["e0", "0.97"]
    assert text[3].strip().startswith("size: x x") and max(map(len, text)) <= 110
    (first,) = [i for i, line in enumerate(text) if line.strip().startswith("e1")]
    assert any("outcome: 0 y" in line for line in text[:first])
    assert any("outcome: 1 y" in line for line in text[first:])


def test_several_sentences_have_a_line_each_and_short_words_share_one() -> None:
    lay = ["lay it on its right edge (x axis down)", "lay it on its left edge (x axis up)"]
    assert list(lines({"missing": lay, "axes": ["x", "y"]}))[:3] == ["missing", *(f"  {w}" for w in lay)]
    assert next(lines({"axes": ["x", "y"]})).split() == ["axes", "x", "y"]


def test_who_may_not_connect_is_told_the_group_and_the_other_way(tmp_path: Path) -> None:
    (tmp_path / "socket").touch()
    said = str(NoDaemonError(tmp_path / "socket", PermissionError(13, "Permission denied")))
    assert f"member of its group {(tmp_path / 'socket').group()}, or" in said and "--all-users" in said
    assert "ls -ld" in str(NoDaemonError(tmp_path / "none", PermissionError(13, "Permission denied")))
