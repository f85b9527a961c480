"""What the command `stillcal` calls: nothing is imported before an interruption would be met.

Importing the command line takes a tenth of a second, in which Ctrl-C is as likely as in any other.
"""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line."""
    try:
        from stillcal.daemon.cli.main import main as command  # noqa: PLC0415 - within the try is the point

        command()
    except KeyboardInterrupt:
        sys.stderr.write("stillcal: interrupted; nothing half-written\n")
        sys.exit(130)
