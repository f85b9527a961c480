"""The style of all figures: sizes, colours (palette.py), light grids.

matplotlib is imported only where a figure is made. An axis of a sensor has the same colour and mark
everywhere.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.palette import BLUE, GREEN, ORANGE, PURPLE, RED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

GREY = "0.45"
COLOURS = (BLUE, RED, GREEN, ORANGE, PURPLE, GREY)
AXES = (("x", RED, "o"), ("y", GREEN, "s"), ("z", BLUE, "^"))
"""Name, colour and mark of a sensor's three axes."""

GRID = "0.92"
PANEL = (4.2, 3.2)
"""Inches of one panel."""

DPI = 130
"""Dots per inch of PNG files: about 550 to a panel."""

MILLI_G = 1000 / STANDARD
"""Milli-g per m/s^2."""

DEGREES = 180 / np.pi
"""Degrees per radian."""

NORMAL_95 = 1.96
"""Half width of a normal distribution's 95 % interval, in standard deviations."""


def figure(columns: float = 1, rows: float = 1) -> Figure:
    """Return an empty figure with room for so many panels."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    return Figure(figsize=(PANEL[0] * columns + 0.6, PANEL[1] * rows + 0.2), layout="constrained")


def dressed(axes: Iterable[Axes]) -> list[Axes]:
    """Return panels with their grid and colours, and without two sides of their frame."""
    styled = list(axes)
    for axis in styled:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color=GRID, zorder=0)
        axis.set_axisbelow(True)
        axis.set_prop_cycle(color=COLOURS)
    return styled


def within(part: FigureBase, columns: int = 1, rows: int = 1, **options: Any) -> list[Axes]:
    """Return panels in a figure or a part of one, row by row; options as for matplotlib's `subplots`."""
    grid = part.subplots(rows, columns, squeeze=False, **options)
    return dressed(axis for row in grid for axis in row)


def panels(columns: int = 1, rows: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, row by row; options as for matplotlib's `subplots`."""
    picture = figure(columns, rows)
    return picture, within(picture, columns, rows, **options)


def png(picture: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    made = io.BytesIO()
    picture.savefig(made, format="png", dpi=DPI, metadata={"Software": None})
    return made.getvalue()


def save(picture: Figure, path: Path) -> None:
    """Write a figure in the format that the name ends in; two runs write the same bytes."""
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix, {"Software": None})
    from matplotlib import rc_context  # noqa: PLC0415 - an extra

    with rc_context({"svg.hashsalt": "stillcal"}):
        picture.savefig(path, dpi=DPI, metadata=metadata)
