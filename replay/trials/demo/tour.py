"""What `make run` shows: a daemon that lives through a simulated phone's day, beside the truth.

Then the three phones of ESGI'95 (Georgieva et al.), whose published rests the package carries. The day is
lived over a pseudo-terminal (live.py); what was found is asked over the daemon's socket.
"""

from __future__ import annotations

import importlib.resources
import importlib.util
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.events import Charging
from stillcal.daemon.cli.main import cli
from stillcal.replay import palette
from stillcal.replay.commands.simulate import truth_of
from stillcal.replay.phone import Phone, Simulation, load_phone, load_scenario, simulate
from stillcal.replay.plots import style
from stillcal.replay.trials.demo.live import DaemonDiedError, Files, Lived, live
from stillcal.replay.trials.week.__main__ import at_rate

DEG = 180 / np.pi
RATE_HZ = 50.0
"""Hz of both sensors of the phone shown: what fits a day into some 20 s."""

ESGI_GRAVITY = 9.81
"""m/s^2; the report's own round value (3.3)."""

CONSTANT_PART = "True biases are constant parts: 1/f noise wanders beside them, and zeroing follows it."

TOLD = ("gravity", "charging", "calibrated", "rejected", "refused", "check")
"""Events of the daemon's log that are shown; the log has them all."""


@click.command()
@click.option(
    "--out", default="out", show_default=True, type=click.Path(path_type=Path), help="Where files go."
)
@click.option("--seed", default=1, show_default=True, help="Of the simulated phone.")
@click.option("--scenario", default="day", show_default=True, help="What the phone lives through.")
def demo(out: Path, seed: int, scenario: str) -> None:
    """Let a daemon live with a simulated phone, and compare what it found with the truth."""
    console = Console()
    try:
        simulation = simulate(load_scenario(scenario), phone_at(RATE_HZ), seed)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    name, files = Path(scenario).stem, Files.in_folder(out)
    _say(console, f"A simulated phone lives a {name} on a serial line; `stillcal run` keeps it true.")
    lived = _live(simulation, files, console)
    _found(lived, simulation, console)
    console.print(_drawn(lived, simulation, out / f"{name}.png"), soft_wrap=True)
    store = out / files.store.name
    console.print(f"Kept: {store} (stillcal store show {store}), {out / files.log.name}", soft_wrap=True)
    _print_esgi(console)


def _print_esgi(console: Console) -> None:
    _say(console, "Three real phones at rest (ESGI'95, Tables 1 to 3).")
    for dataset in ("dataset1", "dataset2", "dataset3"):
        packaged = importlib.resources.files("stillcal.config") / "esgi" / f"{dataset}.csv"
        with importlib.resources.as_file(packaged) as table:
            cli.main(
                ["replay", str(table), "--format", "rest", "--gravity", str(ESGI_GRAVITY)],
                standalone_mode=False,
            )


def phone_at(rate_hz: float) -> Phone:
    """Return the phone `typical` with both its sensors at another rate, Hz."""
    return at_rate(load_phone("typical"), rate_hz)


# While it lives


def _live(simulation: Simulation, files: Files, console: Console) -> Lived:
    def show_event(event: str) -> None:
        if event.partition(":")[0] in TOLD:
            console.print(_told(event), markup=False, highlight=False, no_wrap=True, overflow="ellipsis")

    with _progress(simulation.duration, console) as progressed:
        try:
            return live(simulation, files, show_event, progressed)
        except DaemonDiedError as error:
            raise click.ClickException(str(error)) from error


@contextmanager
def _progress(duration: float, console: Console) -> Iterator[Callable[[float], None]]:
    """Show how far the phone's time has come: a bar on a terminal, else nothing but what is told."""
    columns = (TextColumn("{task.fields[clock]}"), BarColumn(None), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=duration, clock=_clock(0.0))
        yield lambda t: bar.update(task, completed=t, clock=_clock(t))


def _told(event: str) -> str:
    """Shorten an event of the log: its time of day first, of its figures none.

    >>> _told("charging: plugged in t=4596.97 occasion=charging")
    ' 1:16  charging: plugged in'
    """
    found = re.search(r" t=(\S+)", event)
    return f"{_clock(float(found[1]) if found else 0.0)}  {event[: found.start()] if found else event}"


def _clock(t: float) -> str:
    minutes = max(int(t), 0) // 60
    return f"{minutes // 60:2}:{minutes % 60:02}"


# What came of it


def _found(lived: Lived, simulation: Simulation, console: Console) -> None:
    """Print what the daemon answered on its socket."""
    counts = lived.status["counts"]
    _say(console, f"Lived in {lived.lived_s:.0f} s. Asked over its socket, the daemon answers:")
    if lived.calibration is None:
        console.print(f"No calibration: {lived.status['refusal']}")
    else:
        console.print(_beside_truth(lived.calibration, truth_of(simulation)))
        console.print(CONSTANT_PART, soft_wrap=True)
    counted = ("rests", "turns", "calibrations", "rejected", "checks", "zeroings")
    console.print(
        "\nCounted: " + ", ".join(f"{name} {counts[name]}" for name in counted) + ".", soft_wrap=True
    )
    console.print(_energy(lived.energy), soft_wrap=True)
    console.print(f"SIGTERM: stopped in {lived.stopping_s:.1f} s, its state saved.\n", soft_wrap=True)


def _energy(days: list[dict[str, Any]]) -> str:
    names = ("sensors_on_s", "observed_s", "wakeups", "samples", "cpu_s")
    on, observed, wakeups, samples, cpu = (sum(day[name] for day in days) for name in names)
    return (
        f"Energy: sensors on for {100 * on / max(observed, 1.0):.1f} % of the time ({wakeups} wake-ups), "
        f"{samples:,} samples read, {cpu:.1f} s of processor time."
    )


def _beside_truth(found: dict[str, Any], true: dict[str, Any]) -> Table:
    table = Table(title="Found, beside the truth", title_justify="left", title_style="bold", box=None)
    for column in ("", "found", "truth", "worst error"):
        table.add_column(column, no_wrap=True)
    for sensor, label, unit, gain, form in (
        ("accelerometer", "accel.", "mg", 1000 / STANDARD, ".1f"),
        ("gyroscope", "gyro.", "°/s", DEG, ".3f"),
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


def _say(console: Console, text: str) -> None:
    console.print(f"\n[bold]{text}[/bold]\n", soft_wrap=True)


# The figure


def force_error(found: dict[str, Any], true: dict[str, Any], size: float = STANDARD) -> float:
    """Return the rms error of corrected vectors of one size and any direction, in the size's unit.

    With raw = inv(S) @ x + b the error of scale @ (raw - bias) is D @ x + d, where D = scale @ inv(S) - 1
    and d = scale @ (b - bias); over the sphere its mean square is size^2 |D|^2 / 3 + |d|^2.
    """
    scale, bias = np.array(found["scale"]), np.array(found["bias"])
    matrix = scale @ np.linalg.inv(np.array(true["scale"])) - np.eye(3)
    offset = scale @ (np.array(true["bias"]) - bias)
    return float(np.sqrt(size**2 * np.sum(matrix**2) / 3 + np.sum(offset**2)))


def _drawn(lived: Lived, simulation: Simulation, path: Path) -> str:
    """Draw how wrong the published calibration was through the day, and say where."""
    if importlib.util.find_spec("matplotlib") is None:
        return "No figure: it takes matplotlib (pip install '.[report]')."
    figure = style.figure(1.8, 1.5)
    panels = style.within(figure, 1, 2, sharex=True)
    true = truth_of(simulation)
    for panel, (sensor, label, size, gain) in zip(panels, _PANELS, strict=True):
        t, errors = _errors_through(lived, true[sensor], sensor, size, simulation.duration)
        panel.step(t / 3600, gain * errors, where="post", color=palette.BLUE)
        panel.set(yscale="log", ylabel=label)
        for begin, end in _charging(simulation):
            panel.axvspan(begin / 3600, end / 3600, color="0.9")
    panels[0].set_title("Error of the published calibration (before the first: of the raw sensor)")
    panels[1].set_xlabel(f"h; grey: on the charger\n{CONSTANT_PART}")
    style.save(figure, path)
    return f"Figure: {path}"


_PANELS = (
    ("accelerometer", "force at rest,\nrms over attitudes, mg", STANDARD, 1000 / STANDARD),
    ("gyroscope", "rate at rest, °/s", 0.0, DEG),
)


def _errors_through(
    lived: Lived, true: dict[str, Any], sensor: str, size: float, duration: float
) -> tuple[Array, Array]:
    """Return times (n,), s, and the errors (n,) that hold from each on, in the sensor's unit."""
    raw = {"scale": np.eye(3), "bias": np.zeros(3)}
    steps = [(0.0, force_error(raw, true, size))]
    for event in lived.news:
        if event["what"] in ("calibrated", "zeroed") and event["calibration"][sensor]:
            steps.append((event["at_s"], force_error(event["calibration"][sensor], true, size)))
    t, errors = np.array([*steps, (duration, steps[-1][1])]).T
    return t, errors


def _charging(simulation: Simulation) -> Iterator[tuple[float, float]]:
    """Yield when the phone was on the charger, s."""
    since: float | None = None
    for event in simulation.events():
        if isinstance(event, Charging):
            if event.on:
                since = event.t
            elif since is not None:
                yield since, event.t
                since = None
    if since is not None:
        yield since, simulation.duration


if __name__ == "__main__":
    sys.exit(demo(standalone_mode=True))
