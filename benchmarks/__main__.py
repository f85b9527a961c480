"""`python benchmarks [ITEM ...]`: everything that is claimed of speed, measured here and now.

Writes out/benchmarks/results.json after every item and the page docs/performance.md after the last; prints
each row as it comes. Ratios are taken within one run, on one machine. A failed item is reported.
"""

# ruff: noqa: PLC0415 - numpy reads the number of threads when it is first imported; items come in turn

from __future__ import annotations

import os
import sys
import time
import warnings
from pathlib import Path
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # one thread for all alike; before numpy is imported

import click  # noqa: E402 - after the threads are set

ITEMS = {
    "calibrating": "1",
    "daemon_live": "2",
    "applying": "3",
    "fitting": "4",
    "allan": "5",
    "diagnosing": "6",
    "truth": "7",
}
PAGE, TRIED = Path("docs/performance.md"), Path("out/benchmarks/performance.md")


def machine() -> dict[str, object]:
    """Say what this is measured on."""
    import platform

    import numpy as np
    import scipy

    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    model = next((line.split(":", 1)[1].strip() for line in lines if "model name" in line), "")
    return {
        "processor": model or platform.processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "system": f"{platform.system()} {platform.machine()}",
    }


def measured(name: str, quick: bool, document: dict[str, Any]) -> None:
    """Measure one item; rows, time taken and what went wrong go into the document."""
    import importlib

    from page import line

    from stillcal.calib_core.codec import jsonable

    began = time.monotonic()
    try:
        for row in importlib.import_module(name).run(quick):
            document["rows"].append(jsonable(row))
            click.echo(line(document["rows"][-1]))
            sys.stdout.flush()
    except Exception as error:  # the others are still worth measuring
        document["failed"][ITEMS[name]] = f"{type(error).__name__}: {error}"
        click.echo(f"item {ITEMS[name]} failed: {type(error).__name__}: {error}", err=True)
    document["taken_s"][name] = time.monotonic() - began
    document["load"].append(os.getloadavg()[0])


@click.command()
@click.argument("items", nargs=-1, type=click.Choice(list(ITEMS)))
@click.option("--json", "out", default="out/benchmarks/results.json", type=click.Path(path_type=Path))
@click.option(
    "--page", "page_path", type=click.Path(path_type=Path), help=f"[default: {PAGE}; of a part: {TRIED}]"
)
@click.option("--quick", is_flag=True, help="Fewer rounds, shorter inputs: to see that it works.")
def main(items: tuple[str, ...], out: Path, page_path: Path | None, quick: bool) -> None:
    """Measure ITEMS, or all of them."""
    from page import HEAD, page
    from peers import versions

    from stillcal.daemon.store.atomic import write_atomically
    from stillcal.daemon.store.document import pretty

    warnings.simplefilter("ignore", RuntimeWarning)
    names = items or tuple(ITEMS)
    document: dict[str, Any] = {"schema": 2, "machine": machine(), "peers": versions(), "quick": quick}
    document |= {"load": [os.getloadavg()[0]], "rows": [], "taken_s": {}, "failed": {}}
    click.echo(HEAD)
    out.parent.mkdir(parents=True, exist_ok=True)
    for name in names:
        click.echo(f"{ITEMS[name]}: {name} ...", err=True)
        measured(name, quick, document)
        write_atomically(out, (pretty(document) + "\n").encode())
    whole = len(names) == len(ITEMS) and not quick
    target = page_path or (PAGE if whole else TRIED)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target, page(document).encode())
    click.echo(
        f"\n{out}, {target}: {len(document['rows'])} rows in {sum(document['taken_s'].values()):.0f} s"
    )
    sys.exit(bool(document["failed"]))


if __name__ == "__main__":
    main()
