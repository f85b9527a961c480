"""What the command `stillcal` calls: Ctrl-C is met before anything else is imported.

Importing the command line takes a tenth of a second, in which Ctrl-C is as likely as in any other.
"""

from __future__ import annotations

import os
import sys

from stillcal.daemon.cli.interruption import quit_when_interrupted
from stillcal.daemon.system.imports import without_collection


def main() -> None:
    """Run the command line."""
    open_standard_streams()
    quit_when_interrupted()
    with without_collection():
        from stillcal.daemon.cli.main import main as command  # noqa: PLC0415 - interrupted before as well

    command()


def open_standard_streams() -> None:
    """Open those of standard input, output and error that were closed (`>&-`), on nothing.

    Otherwise the first file that is opened, a store perhaps, gets the number of one, and messages go into it.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest number that is free
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115 - for the whole process
