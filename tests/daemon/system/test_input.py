"""What a person names as a file may be a pipe or standard input: read whole, within a bound."""

from __future__ import annotations

import io
import os
import threading
from contextlib import nullcontext
from pathlib import Path

import pytest

from stillcal.daemon.system.files import (
    EmptyPipeError,
    NotRegularError,
    TooLargeError,
    input_name,
    read_input,
    short_name,
)

LIMIT = 100_000
"""More than a pipe holds at once (65,536 bytes), so that its writer waits meanwhile."""


def piped(data: bytes) -> str:
    """Return the path of a pipe that a thread writes `data` into, until nobody reads any more."""
    reading, writing = os.pipe()

    def write() -> None:
        try:
            with os.fdopen(writing, "wb") as file:
                file.write(data)
        except BrokenPipeError:
            pass

    threading.Thread(target=write).start()
    return f"/dev/fd/{reading}"


class StandardInput:
    def __init__(self, data: bytes) -> None:
        self.buffer = io.BytesIO(data)


@pytest.mark.parametrize("size", [1, 3, LIMIT])
def test_a_file_a_pipe_and_standard_input_give_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    data = os.urandom(size)
    (tmp_path / "file").write_bytes(data)
    monkeypatch.setattr("sys.stdin", StandardInput(data))
    assert read_input(tmp_path / "file", LIMIT) == data
    assert read_input("-", LIMIT) == data
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    late = threading.Timer(0.05, lambda: pipe.write_bytes(data))
    late.start()
    assert read_input(pipe, LIMIT) == data


def test_an_empty_file_is_a_file_and_an_empty_pipe_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command that failed before the pipe wrote nothing: its empty output passed for a phone's defaults."""
    (tmp_path / "file").touch()
    assert read_input(tmp_path / "file", LIMIT) == b""
    monkeypatch.setattr("sys.stdin", StandardInput(b""))
    with pytest.raises(EmptyPipeError, match="empty: nothing was written to it"):
        read_input("-", LIMIT)


def test_a_pipe_whose_writer_has_ended_already_is_read_at_once() -> None:
    """Opened anew by its name, it looked like one that nobody had written yet, and was waited for."""
    for data, outcome in ((b"all of it", nullcontext()), (b"", pytest.raises(EmptyPipeError))):
        reading, writing = os.pipe()
        os.write(writing, data)
        os.close(writing)
        with outcome:
            assert read_input(f"/dev/fd/{reading}", LIMIT) == data
        os.close(reading)


def test_what_is_too_long_is_refused_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = bytes(LIMIT + 1)
    (tmp_path / "file").write_bytes(data)
    monkeypatch.setattr("sys.stdin", StandardInput(data))
    pipe = piped(data * 100)
    for path in (tmp_path / "file", pipe, "-"):
        with pytest.raises(TooLargeError, match=f"larger than {LIMIT} bytes") as refused:
            read_input(path, LIMIT)
        assert refused.value.filename == input_name(path)
    os.close(int(Path(pipe).name))
    with pytest.raises(NotRegularError):
        read_input("/dev/zero", LIMIT)


def test_a_pipe_is_called_by_its_path_and_a_file_by_its_name() -> None:
    names = {"-": "standard input", "/dev/fd/63": "/dev/fd/63", "logs/walk.csv": "walk.csv"}
    assert {path: short_name(path) for path in names} == names
