"""`stillcal plot`: figures of a recording or of a store."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import click

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.errors import NotSupported
from stillcal.daemon.cli.exits import TOO_LITTLE
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import config_option, quiet_option
from stillcal.daemon.cli.progress import progress
from stillcal.daemon.settings import load_settings
from stillcal.daemon.store.document import FORMAT, StoreDocument
from stillcal.daemon.store.files import MAX_BYTES, StoreError, parsed, usable
from stillcal.daemon.store.store import Store
from stillcal.daemon.system.files import input_name, is_read_once, short_name
from stillcal.replay.commands.outputs import files, refuse_collisions, say, write_output
from stillcal.replay.commands.reading import Reading, reading_options, show_notes
from stillcal.replay.formats.sources import Source, source_of
from stillcal.replay.formats.trace import Trace
from stillcal.replay.formats.writer import STANDARD_OUTPUT
from stillcal.replay.plots import style
from stillcal.replay.plots.drawing import ALL, FIGURES, draw_figure
from stillcal.replay.plots.inputs import Material, Moment, of_record, of_trace
from stillcal.replay.runner import with_choices

ENDINGS = (".png", ".svg", ".pdf")
NOISE = ("allan", ALL)
"""Figures that need the samples of a long rest: the recording is then read three times, else once."""


@click.command(
    "plot",
    short_help="Draw figures of a recording or of a store.",
    epilog=examples(
        "stillcal plot walk.csv --out walk.png",
        "stillcal plot store.json --out history.svg --what history",
        "stillcal plot still.csv --out noise.pdf --what allan",
        "stillcal plot imu0.log --out imu0.png --what attitudes",
    ),
)
@click.argument("source", metavar="TRACE|STORE", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="The figure's file: .png, .svg or .pdf ('-': print PNG).",
)
@click.option(
    "--what",
    type=click.Choice([*FIGURES, ALL]),
    default=ALL,
    show_default=True,
    help="Attitudes covered, residuals before and after, history of parameters, Allan curves, or all.",
)
@reading_options("a recording")
@config_option
@quiet_option
def plot_command(  # noqa: PLR0917 - click hands every option over by name
    source: Path, out: Path, what: str, reading: Reading, config: Path | None, quiet: bool
) -> None:
    """Draw figures of a recording, calibrated with the daemon's own engine, or of a store.

    A store has no samples, so it has no Allan curves. Exit code 3: there is nothing to draw.
    """
    if out != STANDARD_OUTPUT and out.suffix not in ENDINGS:
        raise click.UsageError(f"{out}: choose a name that ends in {', '.join(ENDINGS)} for a figure")
    if importlib.util.find_spec("matplotlib") is None:
        remedy = "pip install '.[report]' in the source folder, or pip install matplotlib"
        raise click.UsageError(f"matplotlib is not installed: {remedy}")
    refuse_collisions([out], [source, *reading.files, *files(config)])
    try:
        if (document := _store(source, reading)) is not None:
            material = _stored(document, source)
        else:
            settings = load_settings(config).engine
            opened = reading.open(source)
            material = _replayed(opened, settings, what in NOISE, quiet)
            show_notes(opened.notes, quiet)
        figure, omitted = draw_figure(what, material)
    except NotSupported as refusal:
        click.echo(f"stillcal: {input_name(source)}: {refusal}", err=True)
        sys.exit(TOO_LITTLE)
    if out == STANDARD_OUTPUT:
        write_output(out, style.png(figure))
    else:
        style.save(figure, out)
    if not quiet:
        for line in omitted:
            click.echo(f"stillcal: {input_name(source)}: {line}", err=True)
        say(out, "drawn")


def _store(path: Path, reading: Reading) -> StoreDocument | None:
    """Return the store in a file or a pipe; None where it does not call itself one."""
    if not is_read_once(path) and (path.suffix != ".json" or not path.is_file()):
        return None
    kept = reading.kept(path)
    with (kept if isinstance(kept, Source) else source_of(kept)).open() as file:
        data = file.read(1)
        data += file.read(MAX_BYTES) if data == b"{" else b""
    try:
        content = json.loads(data)
    except ValueError:
        return None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        return None
    if isinstance(kept, Source):
        return usable(parsed(kept.path, data))
    return Store(path).load() or StoreDocument()


def _stored(document: StoreDocument, path: Path) -> Material:
    if document.current is None:
        raise StoreError(f"{input_name(path)}: has no calibration; run stillcal replay or the daemon first")
    return of_record(document.current, short_name(path), tuple(_moments(document)))


def _moments(document: StoreDocument) -> list[Moment]:
    moments = [Moment(e.what, _since(e.calibration), e.calibration) for e in document.history]
    current = document.current
    return moments if current is None else [*moments, Moment("current", _since(current), current)]


def _since(record: CalibrationRecord) -> float | None:
    """Return when a calibration last changed, s: its fit, or a later update of the gyroscope's bias."""
    zeroed = None if record.gyroscope is None else record.gyroscope.zeroed_at
    times = [t for t in (record.fitted_at, zeroed) if t is not None]
    return max(times, default=None)


def _replayed(opened: Trace, settings: EngineSettings, noise: bool, quiet: bool) -> Material:
    with progress(short_name(opened.path), (3 if noise else 1) * opened.size_bytes, quiet) as step:
        passes, last = 0, 0

        def show_progress() -> None:
            nonlocal passes, last
            passes, last = passes + (opened.bytes_read < last), opened.bytes_read
            step(passes * opened.size_bytes + last)

        return of_trace(
            opened, Engine(with_choices(settings, claimed=opened.claimed_gravity)), show_progress, noise
        )
