"""Bad input: every kind gives one line that names the file, the row and what to do."""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.replay.formats import sources
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import read_all

HEADER = "t,ax,ay,az,gx,gy,gz"


def lines(n: int = 100) -> list[str]:
    rng = np.random.default_rng(0)
    rows = np.column_stack([np.arange(n) / 100, rng.normal([0, 0, 9.8, 0, 0, 0], 0.02, (n, 6))])
    return [HEADER, *(",".join(map(repr, row)) for row in rows.tolist())]


def cell(row: int, column: int, value: str) -> Callable[[list[str]], list[str]]:
    """Return a change of one cell; row counted from 1 with the header."""

    def change(text: list[str]) -> list[str]:
        cells = text[row - 1].split(",")
        cells[column] = value
        return [*text[: row - 1], ",".join(cells), *text[row:]]

    return change


def later(row: int, seconds: float) -> Callable[[list[str]], list[str]]:
    """Return a change of clock: the rows from `row` on have stamps later by so much."""

    def change(text: list[str]) -> list[str]:
        moved = [line.split(",", 1) for line in text[row - 1 :]]
        return [*text[: row - 1], *(f"{float(t) + seconds!r},{rest}" for t, rest in moved)]

    return change


def refused(path: Path, format: str = "csv") -> TraceError:
    with pytest.raises(TraceError) as caught:
        read_all(path, format)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(path))
    assert caught.value.remedy and message.endswith(" ".join(caught.value.remedy.split()))
    return caught.value


@pytest.mark.parametrize(
    ("change", "row", "what"),
    [
        (cell(50, 2, "abc"), 50, "column 'ay' holds 'abc', which is not a number"),
        (cell(50, 2, "1_0"), 50, "holds '1_0', which is not a number"),
        (cell(50, 2, "9,8"), 50, "8 cells instead of 7"),
        (cell(50, 2, "nan"), 50, "column 'ay' holds nan"),
        (cell(50, 4, "inf"), 50, "column 'gx' holds inf"),
        (cell(50, 4, "1e999"), 50, "column 'gx' holds inf"),
        (cell(50, 0, "-Infinity"), 50, "column 't' holds -inf"),
        (cell(50, 0, ""), 50, "column 't' is empty"),
        (cell(50, 2, ""), 50, "column 'ay' is empty"),
        (cell(50, 0, "0.1"), 50, "time runs backwards by 0.37 s"),
        (later(60, 1.7e9), 60, "time jumps ahead by 1.7e+09 s, to 1700000000.58"),
        (lambda text: [*text[:60], text[60][:20]], 61, "cells instead of 7"),
        (lambda text: text[:1], 1, "header only"),
        (lambda text: text[:2], None, "one accelerometer sample"),
        (lambda text: text[1:], 1, "the first line is not a header"),
        (lambda text: ["t,ax,ay,gx,gy,gz", *text[1:]], 1, "no column 'az'"),
        (lambda text: ["t,ax,ay,az,gx,gy,g", *text[1:]], 1, "no column 'gz'"),
        (lambda text: [line.replace(",", ";") for line in text], 1, "no column"),
        (lambda text: [HEADER, *(f"{i},0,0,0,0,0,0" for i in range(50))], None, "reads zero"),
        (lambda text: [HEADER, *(f"5,{i},0,9.8,0,0,0" for i in range(50))], 3, "49 of 50 time stamps repeat"),
    ],
)
def test_each_is_one_line_naming_file_row_and_remedy(
    tmp_path: Path, change: Callable[[list[str]], list[str]], row: int | None, what: str
) -> None:
    path = tmp_path / "r.csv"
    path.write_text("\n".join(change(lines())) + ("" if row == 61 else "\n"))
    error = refused(path)
    assert what in error.what
    assert error.row == row


def test_a_pause_of_years_on_one_clock_is_a_gap(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("\n".join(later(60, 9 * 366 * 86400.0)(lines())))
    assert any("1 gaps in time" in note for note in read_all(path).notes)


def test_the_row_is_found_deep_in_a_file_after_blank_lines(tmp_path: Path) -> None:
    text = lines(30_000)
    text[20_000] = text[20_000].replace(",", ",x", 1)
    text.insert(10, "")
    path = tmp_path / "r.csv"
    path.write_text("\n".join(text) + "\n")
    assert refused(path).row == 20_002


def test_a_truncated_last_line_says_so(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("\n".join(lines())[:-30])
    assert "cut short" in refused(path).remedy


def test_another_delimiter_is_named(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("\n".join(lines()).replace(",", ";"))
    assert 'delimiter = ";"' in refused(path).remedy


def test_missing_file_folder_and_missing_gyroscope_file(tmp_path: Path) -> None:
    assert refused(tmp_path / "none.csv").what == "no such file"
    assert "holds no recording" in refused(tmp_path).what
    path = tmp_path / "r.csv"
    path.write_text("\n".join(lines()))
    with pytest.raises(TraceError, match=r"g\.csv: no such file"):
        read_all(path, gyro=tmp_path / "g.csv")


@pytest.mark.parametrize("content", [b"", b"\n\n \n"])
def test_empty_files(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(content)
    assert "empty" in refused(path).what


@pytest.mark.parametrize("content", [b"t,ax\xff,ay\n1,2,3\n", b"t,ax\n\0\0\0\n"])
def test_what_is_not_text_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(content)
    assert "UTF-8" in refused(path).remedy


def test_bytes_that_are_not_text_in_a_cell_are_named(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    text = "\n".join(lines(3000)).encode().split(b"\n")
    text[2000] = text[2000].replace(b",", b",\xe9", 1)
    path.write_bytes(b"\n".join(text) + b"\n")
    error = refused(path)
    assert error.row == 2001 and "\\xe9" in error.what


def test_a_line_without_end_is_refused_before_it_fills_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(b"t,ax,ay,az\n0,0,0,9.8\n" + b"1," * 10_000_000)
    assert refused(path).what == "a line does not end"


@pytest.mark.parametrize("keep", [5, 700])
def test_a_truncated_gzip_is_refused(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "r.csv.gz"
    path.write_bytes(gzip.compress("\n".join(lines()).encode())[:keep])
    assert "gzip data cut short" in refused(path).what


def test_a_damaged_gzip_is_refused(tmp_path: Path) -> None:
    data = bytearray(gzip.compress("\n".join(lines(5000)).encode()))
    data[len(data) // 2] ^= 0xFF
    path = tmp_path / "r.csv.gz"
    path.write_bytes(bytes(data))
    assert "gzip" in refused(path).what


def test_members_of_a_gzip_file_are_joined_and_some_zeros_after_them_left_out(tmp_path: Path) -> None:
    whole = "\n".join(lines(3000)).encode()
    packed = gzip.compress(whole[:70_000]) + gzip.compress(b"") + gzip.compress(whole[70_000:])
    path = tmp_path / "r.csv.gz"
    path.write_bytes(packed + bytes(10_000))
    assert len(read_all(path).accelerometer) == 3000
    path.write_bytes(packed + bytes(2 << 20))
    assert "more than 1 MiB of zeros after its end" in refused(path).what
    path.write_bytes(packed + b"\0\0more")
    assert "gzip data cut short or damaged" in refused(path).what


def test_a_small_gzip_file_that_unpacks_to_gigabytes_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "_SMALL", 1 << 20)
    path = tmp_path / "r.mat.gz"
    path.write_bytes(gzip.compress(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + bytes(1 << 24)))
    assert "GiB once unpacked, from" in refused(path, "auto").what


@pytest.mark.parametrize(
    "line",
    [
        "{",
        '{"t": 1}x',
        '{"t": "1", "event": "charging", "on": true}',
        "[]",
        '{"t": 1e11, "event": "charging", "on": true}',
        '{"t": 1, "event": "location", "latitude": 91, "longitude": 0}',
    ],
)
def test_a_bad_events_line_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "r.csv"
    path.write_text("\n".join(lines()))
    events = tmp_path / "r.events.jsonl"
    events.write_text('{"t": 1, "event": "charging", "on": true}\n' + line + "\n")
    with pytest.raises(TraceError, match=r"r\.events\.jsonl:2: not an event"):
        read_all(path)


def test_bad_claims_are_named(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("\n".join(lines()))
    (tmp_path / "r.json").write_text('{"gravity": "ten"}')
    with pytest.raises(TraceError, match=r"r\.json: .*gravity"):
        read_all(path)


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, 4000), junk=st.binary(max_size=20))
def test_any_damage_gives_samples_or_a_trace_error(
    tmp_path_factory: pytest.TempPathFactory, cut: int, junk: bytes
) -> None:
    data = "\n".join(lines(40)).encode()
    path = tmp_path_factory.getbasetemp() / "damaged.csv"
    path.write_bytes(data[:cut] + junk + data[cut + len(junk) :])
    try:
        recording = read_all(path)
    except TraceError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(recording.accelerometer.xyz).all()
        assert (np.diff(recording.accelerometer.t) > 0).all()


def test_a_pipe_is_read_to_its_end() -> None:
    reading, writing = os.pipe()
    os.write(writing, "\n".join(lines(200)).encode())
    os.close(writing)
    try:
        assert len(read_all(f"/dev/fd/{reading}").accelerometer) == 200
    finally:
        os.close(reading)
