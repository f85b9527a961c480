"""Draw a snapshot of a running daemon as one frame in a terminal, with rich. Pure: nothing is asked here."""

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
from stillcal.daemon.cli.watch import sentences
from stillcal.daemon.cli.watch.snapshot import Answer, Snapshot
from stillcal.daemon.cli.watch.sphere import Glyphs, sphere_map
from stillcal.daemon.system.plain_words import duration

MAP_WIDTH, TEXT_WIDTH = 63, 56
"""Columns of the panel with the map, and of those with text where they stand beside it.

In a narrower terminal all stand one below the other, as wide as the map at most.
"""

SPACE = 1
"""Columns between the panels that stand beside each other."""

DEG = 180 / np.pi
MG = 1000 / STANDARD
CONFIDENCE = {"confirmed": "green", "unchecked": "yellow", "failing": "bold red"}
STILL = {"at rest": "bold green", "moving": "bold yellow", "no phone": "bold red"}
UNKNOWN = "-"


def frame(now: Snapshot, before: Snapshot | None, glyphs: Glyphs, width: int) -> RenderableType:
    """Return a frame for a terminal of `width` columns.

    before: the previous snapshot, to tell rest from motion; None for the first frame.
    """
    if now.absent:
        return absent(now, width)
    if now.calibration is None:
        calibration_text: RenderableType = Text(f"no calibration yet: {_reason(now)}", style="yellow")
    else:
        calibration_text = Group(*_calibration(now.calibration, _reason(now)))
    beside = width >= TEXT_WIDTH + SPACE + MAP_WIDTH
    map_width = min(width, MAP_WIDTH)
    text_width = TEXT_WIDTH if beside else map_width
    sphere = Panel(_map(now, glyphs, map_width < MAP_WIDTH), title="orientations recorded", width=map_width)
    panels = Group(
        Panel(_state(now, before), title="phone", width=text_width),
        Panel(calibration_text, title="calibration", width=text_width),
        Panel(_energy(now.days, text_width < TEXT_WIDTH), title="energy", width=text_width),
    )
    return Columns([panels, sphere], padding=(0, SPACE)) if beside else Group(panels, sphere)


def absent(now: Snapshot, width: int) -> RenderableType:
    """Return the frame that is shown while no daemon answers."""
    return Panel(Text(now.absent, style="bold red"), title="stillcal", width=min(width, MAP_WIDTH))


def _rows(rows: Iterable[tuple[str, RenderableType]]) -> Table:
    table = Table.grid(padding=(0, 1))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(name, value)
    return table


def _state(now: Snapshot, before: Snapshot | None) -> RenderableType:
    status, still = now.status, sentences.stillness(now, before)
    plugged = {True: ", on the charger", False: ", off the charger", None: ""}[status.get("charging")]
    line = status["device"] if status["connected"] else "not connected"
    return _rows(
        [
            ("phone", Text(f"{status['phone'] or 'unnamed'}{plugged}")),
            ("line", Text(f"{line}, {status['wire']['lost_samples']} samples lost")),
            ("stillness", Text.assemble((still, STILL.get(still, "")), f"; {sentences.last_rest(now)}")),
            ("watch", Text(f"{status['watch']}, running for {duration(status['uptime_s'])}")),
            ("diagnosis", Text(sentences.diagnosis(now))),
            ("status", Text(sentences.next_step(now), style="bold")),
        ]
    )


def _map(now: Snapshot, glyphs: Glyphs, narrow: bool) -> RenderableType:
    held, up, wanted = sentences.attitudes(now), sentences.up_directions(now), sentences.wanted_attitude(now)
    newest, next_up = up[0] if len(up) else None, None if wanted is None else wanted.up
    drawn = sphere_map(held, newest, next_up, glyphs, stacked=narrow)
    caption = (
        f"{now.stillness.get('rests_held', 0)} rests in {len(held)} orientations; {glyphs.newest} newest"
    )
    if wanted is None:
        return Group(drawn, Text(caption), Text("all orientations are covered", style="green"))
    advice = f"{glyphs.wanted} next orientation to record: {wanted.words}"
    return Group(drawn, Text(caption), Text(advice, style="bold yellow"))


def _reason(now: Snapshot) -> str:
    return now.status.get("refusal") or "too few rests so far"


def _calibration(calibration: Answer, reason: str) -> Iterable[RenderableType]:
    age, checked = (calibration.get(name) for name in ("age_s", "checked_age_s"))
    ago = "" if checked is None else f" {duration(checked)} ago"
    verified = {
        "unchecked": "not verified yet",
        "confirmed": f"verified{ago}",
        "failing": f"no longer fits{f' (checked{ago})' if ago else ''}",
    }
    if not calibration.get("accelerometer"):
        verified["unchecked"] = "provisional: a later rest must confirm it"
        verified["confirmed"] = "confirmed by a later rest"
    confidence = calibration["confidence"]
    old = "" if age is None else f"{duration(age)} old, "
    yield Text.assemble(f"{calibration['id']}, {old}", (verified[confidence], CONFIDENCE[confidence]))
    for sensor, name, gain, unit, digits in (
        ("accelerometer", "accel.", MG, "mg", 2),
        ("gyroscope", "gyro.", DEG, "°/s", 4),
    ):
        if calibration.get(sensor):
            yield _sensor(calibration[sensor], name, (gain, unit, digits))
    if not calibration.get("accelerometer"):
        yield Text(f"accelerometer: no calibration yet: {reason}", style="yellow")
    if calibration.get("gyroscope"):
        yield Text(_slow_rotation(calibration["gyroscope"]), style="dim")
    yield Text(_fit(calibration), style="dim")


def _numbers(first: str, *names: str) -> Table:
    """Return a table without rows, of numbers after a first column."""
    table = Table(box=None, padding=(0, 0, 0, 2), pad_edge=False, show_edge=False)
    table.add_column(first, no_wrap=True)
    for name in names:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _sensor(part: Answer, name: str, shown: tuple[float, str, int]) -> Table:
    """Return a sensor's numbers. shown: factor to the unit shown, that unit, and digits after the point."""
    gain, unit, digits = shown
    table = _numbers(name, "x", "y", "z")
    table.add_row(f"bias {unit}", *(f"{gain * b:.{digits}f}" for b in part["bias"]))
    sds = part.get("bias_uncertainty") or [None] * 3
    table.add_row("± (1 sd)", *(UNKNOWN if sd is None else f"{gain * sd:.{digits}f}" for sd in sds))
    table.add_row("scale", *(f"{part['scale'][k][k]:.5f}" for k in range(3)))
    return table


def _slow_rotation(gyroscope: Answer) -> str:
    bound = gyroscope.get("slow_rotation_deg_per_h")
    if bound is None:
        return "± without slow rotation at rest: not known yet"
    return f"± without slow rotation at rest: up to {_two_digits(max(bound))} °/h"


def _two_digits(value: float) -> str:
    """Return a number with two digits that count, never as a power of ten.

    >>> _two_digits(1437.0), _two_digits(0.0461)
    ('1400', '0.046')
    """
    return f"{float(f'{value:.2g}'):.12g}"


def _fit(calibration: Answer) -> str:
    part = calibration.get("accelerometer")
    if not part or part.get("rms_residual") is None:
        return str(calibration["reason"])
    low, high = calibration.get("temperature_min_c"), calibration.get("temperature_max_c")
    warm = "" if low is None or high is None else f", {low:.0f} to {high:.0f} °C"
    return (
        f"{part['parameters']} parameters from {part['n_rests']} rests in {part['n_states']} orientations\n"
        f"{_two_digits(MG * part['rms_residual'])} mg rms{warm}"
    )


def _energy(days: list[dict[str, Any]], narrow: bool) -> RenderableType:
    table = _numbers("day", "sensors on", "wake-ups", "CPU", *([] if narrow else ["samples"]))
    for day in reversed(days[-3:]):
        on = day["sensors_on_s"] or day["asked_s"]
        table.add_row(
            str(day["number"]),
            f"{100 * on / max(day['observed_s'], 1.0):.1f} %",
            str(day["wakeups"]),
            f"{day['cpu_s']:.1f} s",
            *([] if narrow else [f"{day['samples']:,}"]),
        )
    return table if days else Text("no day recorded yet")
