"""`stillcal convert`: a recording in another format."""

from __future__ import annotations

from pathlib import Path

import click

from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import quiet_option
from stillcal.daemon.cli.progress import progress
from stillcal.daemon.system.files import short_name
from stillcal.replay.commands.outputs import recording_files, refuse_collisions, say
from stillcal.replay.commands.reading import Reading, reading_options, show_notes
from stillcal.replay.formats.claims import beside, read_claims
from stillcal.replay.formats.conversion.convert import ENDINGS, writer_for
from stillcal.replay.formats.writer import STANDARD_OUTPUT


@click.command(
    "convert",
    short_help="Write a recording in another format.",
    epilog=examples(
        "stillcal convert flight.ulg --out flight.csv.gz",
        "stillcal convert export.zip --out walk.parquet",
        "stillcal convert walk.csv --out walk.mcap         # for Foxglove, PlotJuggler or ROS 2",
        "stillcal convert bag/ --sensor /imu0 --from 60 --to 90 --out part.csv",
    ),
)
@click.argument("trace", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="The new file: .csv, .csv.gz, .parquet or .mcap; '-': CSV on standard output.",
)
@reading_options()
@quiet_option
def convert_command(trace: Path, out: Path, reading: Reading, quiet: bool) -> None:
    """Write a recording in another format: its samples in SI units, its events and its maker's claims.

    Values are as the sensor gave them; `stillcal apply` corrects them. Time stamps stay as they are, in MCAP
    to the nanosecond.
    """
    if out != STANDARD_OUTPUT and not out.name.endswith(ENDINGS):
        raise click.UsageError(f"{out}: choose a name that ends in {', '.join(ENDINGS)}")
    side_files = out != STANDARD_OUTPUT and _has_own_side_files(trace, out, reading)
    written = [out, *([beside(out, ".events.jsonl"), beside(out, ".json")] if side_files else [])]
    refuse_collisions(written, [*recording_files(trace), *reading.files])
    opened = reading.open(trace)
    samples = 0
    with (
        progress(short_name(opened.path), opened.size_bytes, quiet) as step,
        writer_for(opened, out, side_files=side_files) as writer,
    ):
        for chunk in opened.chunks():
            writer.write(chunk.accelerometer, chunk.gyroscope, chunk.events)
            samples += len(chunk.accelerometer)
            step(opened.bytes_read)
    show_notes(opened.notes, quiet)
    if not quiet:
        say(out, f"{samples:,} samples of the accelerometer, from {opened.kind}")


def _has_own_side_files(trace: Path, out: Path, reading: Reading) -> bool:
    """Whether events and claims are to be written; not where both recordings share them by their name.

    A part has events of its own, and claims about raw counts do not hold for the new file: the names collide.
    """
    shared = beside(trace, ".json").resolve() == beside(out, ".json").resolve()
    claims = read_claims(trace)
    whole = reading.start is None and reading.stop is None and claims == claims.without_counts()
    return not (shared and whole)
