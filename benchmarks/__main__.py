"""`python benchmarks [ITEM ...]`: everything that is claimed of speed, measured here and now.

Writes out/benchmarks/results.json and prints the table. Ratios are taken within one run, on one machine.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import warnings
from dataclasses import asdict
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # one thread for all alike; before numpy is imported

import click  # noqa: E402

ITEMS = {
    "calibrating": "1",
    "daemon_live": "2",
    "applying": "3",
    "fitting": "4",
    "allan": "5",
    "diagnosing": "6",
}


def machine() -> dict[str, object]:
    """Say what this is measured on, and how busy it is."""
    import numpy as np  # noqa: PLC0415 - after the threads are set

    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    model = next((line.split(":", 1)[1].strip() for line in lines if "model name" in line), "")
    return {
        "processor": model or platform.processor(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
        "numpy": np.__version__,
        "system": platform.platform(),
    }


def line(row: dict[str, object]) -> str:
    """Return one row of the table in Markdown."""
    ratio = row["ratio"]
    versus = "" if not isinstance(ratio, list | tuple) else "{:.2f} ({:.2f} to {:.2f})".format(*ratio)
    met = {True: "yes", False: "no", None: ""}[row["met"]]  # type: ignore[index]
    value = f"{row['value']:.3g} {row['unit']}"
    cells = (row["item"], row["what"], value, row["peer"], versus, row["accuracy"], row["goal"], met)
    return "| " + " | ".join(map(str, cells)) + " |"


@click.command()
@click.argument("items", nargs=-1, type=click.Choice(list(ITEMS)))
@click.option("--json", "out", default="out/benchmarks/results.json", type=click.Path(path_type=Path))
@click.option("--quick", is_flag=True, help="Fewer rounds, shorter inputs: to see that it works.")
def main(items: tuple[str, ...], out: Path, quick: bool) -> None:
    """Measure ITEMS, or all of them."""
    import importlib  # noqa: PLC0415 - each item when its turn comes

    from peers import versions  # noqa: PLC0415

    warnings.simplefilter("ignore", RuntimeWarning)
    rows: list[dict[str, object]] = []
    click.echo("| item | what | ours | peer | times as fast | accuracy | goal | met |\n|" + "---|" * 8)
    for name in items or ITEMS:
        for row in importlib.import_module(name).run(quick):
            rows.append(asdict(row))
            click.echo(line(rows[-1]))
            sys.stdout.flush()
    out.parent.mkdir(parents=True, exist_ok=True)
    document = {"schema": 1, "machine": machine(), "peers": versions(), "quick": quick, "rows": rows}
    out.write_text(json.dumps(document, indent=2) + "\n")
    click.echo(f"\n{out}: {len(rows)} rows; load {machine()['load']:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
