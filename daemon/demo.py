"""What `make run` shows: a simulated phone calibrated by the daemon's engine, beside the truth.

Then the three phones of ESGI'95 (Georgieva et al.), whose published rests the package carries.
Everything goes through the commands that a user would type; the figures are read back from what they
wrote.
"""

from __future__ import annotations

import importlib.resources
import json
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from stillcal.daemon.cli import cli

G = 9.80665
ESGI_GRAVITY = 9.81
"""m/s^2; the report's own round value (3.3)."""


@click.command()
@click.option(
    "--out", default="out", show_default=True, type=click.Path(path_type=Path), help="Where files go."
)
@click.option("--seed", default=1, show_default=True, help="Of the simulated phone.")
def demo(out: Path, seed: int) -> None:
    """Simulate a phone, calibrate it from the recording alone, and compare with the truth."""
    out.mkdir(parents=True, exist_ok=True)
    console = Console()
    recording, store, truth = out / "phone.csv", out / "store.json", out / "phone.truth.json"
    store.unlink(missing_ok=True)
    _say(console, "A phone is laid by hand in 24 attitudes; nobody tells stillcal which.")
    _run("simulate", "lab", "--out", str(recording), "--truth", str(truth), "--seed", str(seed))
    _run("replay", str(recording), "--store", str(store))
    console.print(_beside_truth(json.loads(store.read_text()), json.loads(truth.read_text())))
    _say(console, "Three real phones at rest (ESGI'95, Tables 1 to 3).")
    for name in ("dataset1", "dataset2", "dataset3"):
        packaged = importlib.resources.files("stillcal.config") / "esgi" / f"{name}.csv"
        with importlib.resources.as_file(packaged) as table:
            _run("replay", str(table), "--format", "rest", "--gravity", str(ESGI_GRAVITY))
    console.print(f"\nKept: {recording}, {store} (stillcal store show {store})")


def _run(*arguments: str) -> None:
    cli.main(list(arguments), standalone_mode=False)


def _say(console: Console, text: str) -> None:
    console.print(f"\n[bold]{text}[/bold]\n")


def _beside_truth(found: dict[str, Any], true: dict[str, Any]) -> Table:
    table = Table(title="Found, beside the truth", title_justify="left", title_style="bold", box=None)
    for column in ("", "found", "truth", "worst error"):
        table.add_column(column, no_wrap=True)
    for sensor, label, unit, gain, form in (
        ("accelerometer", "accel.", "mg", 1000 / G, ".1f"),
        ("gyroscope", "gyro.", "°/s", 180 / np.pi, ".3f"),
    ):
        bias, scale = (_pair(found, true, sensor, name) for name in ("bias", "scale"))
        biases = (_vector(gain * v, form) for v in bias)
        table.add_row(f"{label} bias", *biases, _errors(bias, gain, unit))
        diagonals = (_vector(np.diag(v), ".4f") for v in scale)
        table.add_row(f"{label} scale", *diagonals, _errors(scale, 100, "%"))
    return table


def _pair(found: dict[str, Any], true: dict[str, Any], sensor: str, name: str) -> tuple[Any, Any]:
    return np.array(found[sensor][name]), np.array(true[sensor][name])


def _errors(pair: tuple[Any, Any], gain: float, unit: str) -> str:
    """Return the largest error of the uncorrected sensor (bias 0, scale 1), and of the found figures."""
    found, true = pair
    nominal = np.eye(3) if true.ndim == 2 else np.zeros(3)
    before, after = np.abs(nominal - true).max(), np.abs(found - true).max()
    return f"{gain * before:.2g} -> {gain * after:.2g} {unit}"


def _vector(values: Any, form: str) -> str:
    return " ".join(f"{v:{form}}" for v in values)


if __name__ == "__main__":
    sys.exit(demo(standalone_mode=True))
