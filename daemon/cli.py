"""The command line: one command a verb, mounted here; every refusal is one line and an exit code.

Exit codes: 0 done, 1 a bar not met, 2 bad input, 3 the recording cannot support a calibration, 4 no
daemon answers, 130 interrupted. Nothing is computed here, and nothing is imported but click until a
command is called: the daemon starts in a third of a second and never holds what only a replay needs.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec

import click

from stillcal.daemon.cli_lazy import LazyGroup, examples
from stillcal.daemon.exits import BAD_INPUT, INTERRUPTED

COMMANDS = {
    "run": "stillcal.daemon.cli_run:run_command",
    "query": "stillcal.daemon.cli_query:query_command",
    "watch": "stillcal.daemon.cli_watch:watch_command",
    "replay": "stillcal.daemon.cli_replay:replay_command",
    "apply": "stillcal.daemon.cli_replay:apply_command",
    "plot": "stillcal.daemon.cli_plot:plot_command",
    "diagnose": "stillcal.daemon.cli_diagnose:diagnose_command",
    "simulate": "stillcal.daemon.cli_simulate:simulate_command",
    "store": "stillcal.daemon.cli_store:store_group",
    "install-service": "stillcal.daemon.cli_install:install_command",
    "challenge": "stillcal.daemon.cli_challenge:challenge_group",
    "prove": "stillcal.daemon.cli_challenge:prove_command",
    "evaluate": "stillcal.daemon.cli_evaluate:evaluate_command",
    "fleet": "stillcal.daemon.cli_fleet:fleet_command",
    "fleet-report": "stillcal.daemon.cli_fleet:report_command",
    "fleet-first": "stillcal.daemon.cli_fleet:first_command",
}


@click.group(
    cls=LazyGroup,
    places=COMMANDS,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=examples(
        "stillcal run --config stillcal.toml",
        "stillcal query GetCalibration",
        "stillcal watch",
        "stillcal replay walk.csv --store store.json",
        "stillcal apply walk.csv --store store.json --out walk-true.csv",
        "stillcal store history store.json",
        "stillcal diagnose walk.csv --report walk.html",
    ),
)
@click.version_option(package_name="stillcal")
def cli() -> None:
    """Keep a phone's accelerometer and gyroscope true, with nobody helping."""


def main() -> None:
    """Run the command line; turn every expected error into one line on standard error."""
    if sys.argv[1:2] == ["run"]:
        _without_openssl()
    try:
        sys.exit(cli.main(standalone_mode=False))
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(error.exit_code)
    except click.ClickException as error:
        click.echo(f"stillcal: {error.format_message()}", err=True)
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("stillcal: interrupted; nothing half-written", err=True)
        sys.exit(INTERRUPTED)
    except ValueError as error:
        if not isinstance(error, _refusals()):
            raise
        click.echo(f"stillcal: {error}", err=True)
        sys.exit(BAD_INPUT)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        click.echo(f"stillcal: {where}{error.strerror or error}", err=True)
        sys.exit(BAD_INPUT)


def _without_openssl() -> None:
    """Keep OpenSSL, 4 MB for months, out of a process that speaks no TLS.

    asyncio and hashlib load it where they can and do without where they cannot; hashes are then Python's own,
    unless it was built without them.
    """
    if find_spec("_sha256") or find_spec("_sha2"):
        for name in ("ssl", "_hashlib"):
            sys.modules[name] = None  # type: ignore[assignment]  # importing it now fails


def _refusals() -> tuple[type[Exception], ...]:
    """Return the errors that are a user's to mend; imported only when one may have happened."""
    from stillcal.calib_core.gravity import LocationError  # noqa: PLC0415
    from stillcal.calib_core.refusals import NotSupported  # noqa: PLC0415
    from stillcal.calib_core.samples import SampleError  # noqa: PLC0415
    from stillcal.daemon.settings import SettingsError  # noqa: PLC0415
    from stillcal.daemon.store import StoreError  # noqa: PLC0415
    from stillcal.replay.formats.errors import TraceError  # noqa: PLC0415

    return LocationError, NotSupported, SampleError, SettingsError, StoreError, TraceError
