"""The command line's entry: one command per verb. Every refusal is one line and an exit code.

The exit codes are in exits.py. Nothing is computed here, and only click is imported until a command is
called: the daemon starts in a third of a second and never holds what only a replay needs.
"""

from __future__ import annotations

import io
import os
import sys
from importlib.util import find_spec
from typing import Any

import click

from stillcal.calib_core.errors import TryAgainError, UserError
from stillcal.daemon.cli.exits import BAD_INPUT, INTERRUPTED, TRY_AGAIN
from stillcal.daemon.cli.interruption import INTERRUPTION
from stillcal.daemon.cli.lazy import LazyGroup, examples
from stillcal.daemon.system.files import naming

COMMANDS = {
    "run": "stillcal.daemon.cli.run:run_command",
    "query": "stillcal.daemon.cli.query:query_command",
    "watch": "stillcal.daemon.cli.watch.command:watch_command",
    "faces": "stillcal.daemon.cli.faces:faces_command",
    "install-service": "stillcal.daemon.cli.install:install_command",
}
"""The daemon's own commands, found without searching the installed packages, so that `run` starts at once."""

OWN_SECTION = "The daemon"

SECTIONS = {
    "Calibrate": "stillcal.calibrate",
    "Diagnose": "stillcal.diagnose",
    OWN_SECTION: None,
    "Many phones": "stillcal.fleet",
    "The project's own proofs": "stillcal.proofs",
}
"""Sections of the help and the entry point groups of their commands (pyproject.toml); None means COMMANDS."""


@click.group(
    cls=LazyGroup,
    own=COMMANDS,
    sections=SECTIONS,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=examples(
        "stillcal replay sample:lab --store store.json     # a recording that comes with stillcal",
        "stillcal apply sample:lab --store store.json --out lab-calibrated.csv",
        "stillcal diagnose sample:lab",
        "stillcal run --config stillcal.toml",
        "stillcal query GetCalibration",
        "stillcal watch",
        "stillcal store history store.json",
    ),
)
@click.version_option(package_name="stillcal")
def cli() -> None:
    """Calibrate a phone's accelerometer and gyroscope without anybody's help, live or from recordings."""


BY_CLICK = ("Got unexpected extra argument", "No such command")
"""How messages of click begin that have no class of their own."""


def main() -> None:
    """Run the command line; turn every expected error into one line on standard error."""
    _prepare_standard_output()
    if sys.argv[1:2] == ["run"]:
        _without_openssl()
    try:
        sys.exit(cli.main(prog_name="stillcal", standalone_mode=False))
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(error.exit_code)
    except click.ClickException as error:
        click.echo(f"stillcal: {_complaint(error)}", err=True)
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo(INTERRUPTION, err=True)
        sys.exit(INTERRUPTED)
    except TryAgainError as error:
        click.echo(f"stillcal: {error}", err=True)
        sys.exit(TRY_AGAIN)
    except UserError as error:
        click.echo(f"stillcal: {error}", err=True)
        sys.exit(BAD_INPUT)
    except BrokenPipeError:
        sys.exit(1)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        remedy = "; check the path" if isinstance(error, FileNotFoundError) else ""
        click.echo(f"stillcal: {where}{error.strerror or error}{remedy}", err=True)
        sys.exit(BAD_INPUT)


def _complaint(error: click.ClickException) -> str:
    """Return an error in one line; where click found it in the words typed, with where their help is.

    What the commands themselves refuse says what to do.
    """
    text = " ".join(error.format_message().split())
    by_click = isinstance(error, click.BadParameter | click.NoSuchOption | click.BadOptionUsage)
    if not isinstance(error, click.UsageError) or error.ctx is None:
        return text
    if not by_click and not text.startswith(BY_CLICK):
        return text
    return f"{text.rstrip('.')}: see `{error.ctx.command_path} --help`"


class _StandardOutput(io.FileIO):
    """Standard output. Its first error, such as that of a full disk, names it; the rest goes nowhere.

    What waits in buffers would fail once more when the process ends, and Python would report that too.
    """

    def write(self, data: Any, /) -> int:
        """Write bytes, and return how many were taken."""
        try:
            with naming("standard output"):
                return super().write(data)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            raise


def _prepare_standard_output() -> None:
    """Let standard output name itself in an error, and take letters that a terminal does not have."""
    stream = sys.stdout
    if not isinstance(stream, io.TextIOWrapper):
        return
    raw = getattr(stream.buffer, "raw", stream.buffer)
    if isinstance(raw, io.FileIO):  # a console of Windows is none
        named = _StandardOutput(raw.fileno(), "wb", closefd=False)
        stream = io.TextIOWrapper(
            named if stream.write_through else io.BufferedWriter(named),
            encoding=stream.encoding,
            line_buffering=stream.line_buffering,
            write_through=stream.write_through,
        )
    stream.reconfigure(errors="backslashreplace")
    sys.stdout = stream


def _without_openssl() -> None:
    """Keep OpenSSL, 4 MB for months, out of a process that speaks no TLS.

    asyncio and hashlib load it where they can and do without where they cannot; hashes are then Python's own,
    unless it was built without them.
    """
    if find_spec("_sha256") or find_spec("_sha2"):
        for name in ("ssl", "_hashlib"):
            sys.modules[name] = None  # type: ignore[assignment]  # importing it now fails
