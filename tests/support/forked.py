"""`stillcal` in a process of its own, forked from this one: what it imports at its start is there already.

For tests of what a command says and of what signals do to it; that it starts, and with what, is tested with
processes that are started anew.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, NoReturn

from stillcal.daemon.cli import main as cli


class Forked:
    """A child that runs `main` with arguments; what it writes is read from `stdout` and `stderr`.

    folder: where it runs; more: of its environment; together: write both to `stdout`.
    """

    def __init__(
        self,
        arguments: Sequence[object],
        main: Callable[[], object] = cli.main,
        *,
        folder: Path | None = None,
        more: Mapping[str, str] | None = None,
        together: bool = False,
    ) -> None:
        out, err = os.pipe(), os.pipe()
        self.returncode: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            _become(main, arguments, (out[1], out[1] if together else err[1]), folder, more or {})
        os.close(out[1])
        os.close(err[1])
        self.stdout, self.stderr = _text(out[0]), _text(err[0])

    def __enter__(self) -> Forked:
        return self

    def __exit__(self, *_: object) -> None:
        if self.returncode is None:
            self.kill()
        self.stdout.close()
        self.stderr.close()

    def send_signal(self, number: signal.Signals) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        if self.returncode is None:
            os.kill(self.pid, signal.SIGKILL)
            self.wait()

    def wait(self, patience_s: float = 60.0) -> int:
        """Wait for its end; return its exit code, or less than 0 the signal that ended it."""
        until = time.monotonic() + patience_s
        while self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > until:
                raise TimeoutError(f"process {self.pid} has not ended")
            else:
                time.sleep(0.002)
        return self.returncode

    def said(self) -> tuple[str, str]:
        """Read what it writes until its end; the second only after the first, so it must be short."""
        out, err = self.stdout.read(), self.stderr.read()
        self.wait()
        return out, err


def _text(descriptor: int) -> IO[str]:
    return os.fdopen(descriptor, encoding="utf-8")


def _become(
    main: Callable[[], object],
    arguments: Sequence[object],
    to: tuple[int, int],
    folder: Path | None,
    more: Mapping[str, str],
) -> NoReturn:
    """Run `main` with standard output and error of its own, and end without this process' cleaning up."""
    code = 1
    try:
        for descriptor, number in zip(to, (1, 2), strict=True):
            os.dup2(descriptor, number)
        os.closerange(3, 1024)
        sys.stdout, sys.stderr = (open(n, "w", encoding="utf-8", closefd=False) for n in (1, 2))  # noqa: SIM115 - open as long as the process
        sys.argv = ["stillcal", *map(str, arguments)]
        os.environ |= more
        if folder is not None:
            os.chdir(folder)
        main()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError):  # nobody reads it any more
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)
