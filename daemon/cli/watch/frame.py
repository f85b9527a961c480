"""A snapshot of a running daemon as a frame in a terminal, with rich: pure, one in, one out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from stillcal.calib_core.gravity import STANDARD
from stillcal.daemon.cli.watch import sentences as words
from stillcal.daemon.cli.watch.snapshot import Answer, Snapshot
from stillcal.daemon.cli.watch.sphere import Glyphs, sphere_map

MAP_WIDTH, TEXT_WIDTH = 63, 56
DEG = 180 / np.pi
MG = 1000 / STANDARD
CONFIDENCE = {"confirmed": "green", "unchecked": "yellow", "failing": "bold red"}
STILL = {"lies still": "bold green", "moves": "bold yellow", "no phone": "bold red"}
UNKNOWN = "-"


def frame(now: Snapshot, before: Snapshot | None, glyphs: Glyphs) -> RenderableType:
    """Return a frame. before: the last snapshot, from which stillness shows; None for the first."""
    if now.absent:
        return absent(now)
    if now.calibration is None:
        calibration_text: RenderableType = Text(f"none yet: {_reason(now)}", style="yellow")
    else:
        calibration_text = Group(*_calibration(now.calibration))
    sphere = Panel(_map(now, glyphs), title="rests held, as the phone lay", width=MAP_WIDTH)
    panels = Group(
        Panel(_state(now, before), title="phone", width=TEXT_WIDTH),
        Panel(calibration_text, title="calibration", width=TEXT_WIDTH),
        Panel(_energy(now.days), title="energy", width=TEXT_WIDTH),
    )
    return Columns([panels, sphere], padding=(0, 1))


def absent(now: Snapshot) -> RenderableType:
    """Return what is shown while no daemon answers."""
    text = f"no daemon answers on {now.where} ({now.absent}); start one with `stillcal run`"
    return Panel(Text(text, style="bold red"), title="stillcal", width=MAP_WIDTH)


def _rows(rows: Iterable[tuple[str, RenderableType]]) -> Table:
    table = Table.grid(padding=(0, 1))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(name, value)
    return table


def _state(now: Snapshot, before: Snapshot | None) -> RenderableType:
    status, still = now.status, words.stillness(now, before)
    plugged = {True: ", on the charger", False: ", off the charger", None: ""}[status.get("charging")]
    line = status["device"] if status["connected"] else "not connected"
    return _rows(
        [
            ("phone", Text(f"{status['phone'] or 'unnamed'}{plugged}")),
            ("line", Text(f"{line}, {status['wire']['lost_samples']} samples lost")),
            ("stillness", Text.assemble((still, STILL.get(still, "")), f"; {words.last_rest(now)}")),
            ("watch", Text(f"{status['watch']}, up for {words.duration(status['uptime_s'])}")),
            ("waits for", Text(words.next_step(now), style="bold")),
        ]
    )


def _map(now: Snapshot, glyphs: Glyphs) -> RenderableType:
    held, up, wanted = words.attitudes(now), words.up_directions(now), words.wanted_attitude(now)
    drawn = sphere_map(held, up[0] if len(up) else None, None if wanted is None else wanted.up, glyphs)
    caption = (
        f"{now.stillness.get('rests_held', 0)} rests in {len(held)} attitudes; {glyphs.newest} the last one"
    )
    if wanted is None:
        return Group(drawn, Text(caption), Text("no attitude is missing", style="green"))
    return Group(
        drawn, Text(caption), Text(f"{glyphs.wanted} would help most: {wanted.words}", style="bold yellow")
    )


def _reason(now: Snapshot) -> str:
    return now.status.get("refusal") or "too few rests so far"


def _calibration(calibration: Answer) -> Iterable[RenderableType]:
    age, checked = words.duration(calibration.get("age_s")), words.duration(calibration.get("checked_age_s"))
    yield Text.assemble(
        f"{calibration['id']}, {age} old, checked {checked} ago: ",
        (calibration["confidence"], CONFIDENCE[calibration["confidence"]]),
    )
    table = Table(box=None, padding=(0, 1), show_edge=False)
    for name in ("", "x", "y", "z", ""):
        table.add_column(name, justify="left" if not name else "right", no_wrap=True)
    for sensor, name, gain, unit, digits in (
        ("accelerometer", "accel.", MG, "mg", 2),
        ("gyroscope", "gyro.", DEG, "°/s", 4),
    ):
        if calibration.get(sensor):
            _sensor(table, calibration[sensor], name, (gain, unit, digits))
    yield table
    yield Text(_fit(calibration), style="dim")


def _sensor(table: Table, part: Answer, name: str, shown: tuple[float, str, int]) -> None:
    """Add a sensor's rows. shown: factor to the unit shown, that unit, and digits after the point."""
    gain, unit, digits = shown
    table.add_row(f"{name} bias", *(f"{gain * b:.{digits}f}" for b in part["bias"]), unit)
    sds = part.get("bias_uncertainty") or [None] * 3
    table.add_row("  ± (1 sd)", *(UNKNOWN if sd is None else f"{gain * sd:.{digits}f}" for sd in sds), unit)
    table.add_row(f"{name} scale", *(f"{part['scale'][k][k]:.5f}" for k in range(3)), "")


def _fit(calibration: Answer) -> str:
    part = calibration.get("accelerometer")
    if not part or part.get("rms_residual") is None:
        return str(calibration["reason"])
    low, high = calibration.get("temperature_min_c"), calibration.get("temperature_max_c")
    warm = "" if low is None or high is None else f", {low:.0f} to {high:.0f} °C"
    return (
        f"{part['parameters']} parameters, {part['n_rests']} rests in {part['n_states']} attitudes, "
        f"{MG * part['rms_residual']:.2g} mg rms{warm}"
    )


def _energy(days: list[dict[str, Any]]) -> RenderableType:
    table = Table(box=None, padding=(0, 1), show_edge=False)
    for name in ("day", "sensors on", "wake-ups", "samples", "CPU"):
        table.add_column(name, justify="right", no_wrap=True)
    for day in reversed(days[-3:]):
        on = day["sensors_on_s"] or day["asked_s"]
        table.add_row(
            str(day["number"]),
            f"{100 * on / max(day['observed_s'], 1.0):.1f} %",
            str(day["wakeups"]),
            f"{day['samples']:,}",
            f"{day['cpu_s']:.1f} s",
        )
    return table if days else Text("nothing spent yet")
