"""Ctrl-C on the command line: it ends the process at once until a command says that it cleans up itself."""

from __future__ import annotations

import os
import signal

from stillcal.daemon.cli.exits import INTERRUPTED

INTERRUPTION = "stillcal: interrupted; nothing half-written"


def quit_when_interrupted() -> None:
    """Let Ctrl-C end the process at once, in one line, while nothing has been begun that must be ended.

    A KeyboardInterrupt instead would be lost wherever Python ignores exceptions, as in callbacks of imports.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored (nohup)
        signal.signal(signal.SIGINT, _quit)


def raise_when_interrupted() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again, for commands that clean up after themselves."""
    if signal.getsignal(signal.SIGINT) is _quit:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _quit(*_: object) -> None:
    try:
        os.write(2, f"{INTERRUPTION}\n".encode())
    finally:
        os._exit(INTERRUPTED)
