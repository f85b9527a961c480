"""The command line run in this process, with pipes as its standard streams: a new one takes half a second."""

from __future__ import annotations

import io
import os
import sys
import threading
from subprocess import CompletedProcess
from unittest.mock import patch

from stillcal.daemon.cli.main import main


def ran(*words: object, given: bytes = b"") -> CompletedProcess[bytes]:
    """Return what a command writes and its exit code; given: to its standard input, through a pipe."""
    command = ["stillcal", *map(str, words)]
    reading, writing = os.pipe()
    writer = threading.Thread(target=_write, args=(writing, given))
    out, err = io.BytesIO(), io.BytesIO()
    code: int | None = 0
    with (
        os.fdopen(reading) as stdin,
        patch.object(sys, "argv", command),
        patch.object(sys, "stdin", stdin),
        patch.object(sys, "stdout", io.TextIOWrapper(out, write_through=True)),
        patch.object(sys, "stderr", io.TextIOWrapper(err, write_through=True)),
    ):
        writer.start()
        try:
            main()
        except SystemExit as end:
            code = end.code  # type: ignore[assignment]  # no command ends with a text
        stdout, stderr = out.getvalue(), err.getvalue()
    writer.join()
    return CompletedProcess(command, code or 0, stdout, stderr)


def _write(descriptor: int, data: bytes) -> None:
    try:
        with os.fdopen(descriptor, "wb") as pipe:
            pipe.write(data)
    except BrokenPipeError:  # a command that reads none of it
        pass
