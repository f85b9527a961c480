"""The command line: one command a verb, mounted here; every refusal is one line and an exit code.

Exit codes: 0 done, 1 a bar not met, 2 bad input, 3 the recording cannot support a calibration,
130 interrupted. Nothing is computed here.
"""

from __future__ import annotations

import sys

import click

from stillcal.calib_core.refusals import NotSupported
from stillcal.calib_core.samples import SampleError
from stillcal.daemon.cli_replay import apply_command, replay_command
from stillcal.daemon.cli_simulate import simulate_command
from stillcal.daemon.cli_store import examples, store_group
from stillcal.daemon.settings import SettingsError
from stillcal.daemon.store import StoreError
from stillcal.replay.formats.errors import TraceError

BAD_INPUT, INTERRUPTED = 2, 130


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=examples(
        "stillcal replay walk.csv --store store.json",
        "stillcal apply walk.csv --store store.json --out walk-true.csv",
        "stillcal store history store.json",
    ),
)
@click.version_option(package_name="stillcal")
def cli() -> None:
    """Keep a phone's accelerometer and gyroscope true, with nobody helping."""


for command in (replay_command, apply_command, simulate_command, store_group):
    cli.add_command(command)


def main() -> None:
    """Run the command line; turn every expected error into one line on standard error."""
    try:
        sys.exit(cli.main(standalone_mode=False))
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("stillcal: interrupted; nothing half-written", err=True)
        sys.exit(INTERRUPTED)
    except (TraceError, SettingsError, StoreError, SampleError, NotSupported) as error:
        click.echo(f"stillcal: {error}", err=True)
        sys.exit(BAD_INPUT)
