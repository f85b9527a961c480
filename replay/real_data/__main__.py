"""`python -m stillcal.replay.real_data FOLDER [--out docs/reality.md]`: the three tables, as a page."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

import click
from rich.console import Console
from rich.progress import Progress

from stillcal.replay.diagnosis.rest_table import diagnose_rests
from stillcal.replay.formats.hhar_still import recordings as recordings_of
from stillcal.replay.formats.rest_table import read_rest_table
from stillcal.replay.real_data import sound_phones
from stillcal.replay.real_data.injection import DIRECT, SLOW
from stillcal.replay.real_data.page import Shown, page
from stillcal.replay.real_data.sources import Source, sources
from stillcal.replay.real_data.tables import Finding, inject_all, row
from stillcal.replay.real_data.withheld_thermometer import Withheld, withheld

HOSTS = ("imu_tk/xsens_acc.mat.gz", "mikoff/imu0.log", "sunsided/still_10min.csv.gz", "broad/14")
"""Recordings that effects are injected into: one of each maker, the longest."""

PARTS = 5
"""Parts that the devices on a table are dealt into; each is judged by the devices of the others."""


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), default=Path("docs/reality.md"), show_default=True)
def main(folder: Path, out: Path) -> None:
    """Diagnose every real recording in FOLDER, withhold thermometers, inject effects; write a page."""
    with Progress(console=Console(stderr=True)) as progress:
        recordings = list(progress.track(sources(folder), description="reading"))
        rows = [row(s) for s in progress.track(recordings, description="diagnosing")]
        hidden = _withheld(recordings)
        table = folder / "hhar_still"
        phones = recordings_of(table) if table.exists() else []
        still, unlike = sound_phones.held_out(phones, PARTS), sound_phones.unlike(phones)
        hosts = [s for s in recordings if s.name in HOSTS]
        task = progress.add_task("injecting", total=len(hosts) * len(SLOW + DIRECT) * 3)
        results = inject_all(hosts, SLOW + DIRECT, lambda: progress.advance(task))
        progress.update(task, completed=len(hosts) * len(SLOW + DIRECT) * 3)
    out.write_text(page(Shown(recordings, rows, _tables_of_rests(), hidden, results, still, unlike)))
    click.echo(f"{out}: {len(rows)} recordings, {len(results)} injections")


def _tables_of_rests() -> list[tuple[str, str, list[Finding]]]:
    """Diagnose the three published tables, which ship with stillcal."""
    answers = []
    for number in (1, 2, 3):
        with as_file(files("stillcal.config") / "esgi" / f"dataset{number}.csv") as path:
            answer = diagnose_rests(read_rest_table(path), path.name)
        answers.append((f"dataset {number}", answer["verdict"], answer["findings"]))
    return answers


def _withheld(recordings: list[Source]) -> list[tuple[Source, Withheld | None]]:
    warm = [s for s in recordings if s.recording.accelerometer.temperature is not None]
    return [(s, withheld(s, [o for o in warm if o is not s])) for s in warm]


if __name__ == "__main__":
    main()
