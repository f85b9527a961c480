"""Draw orientations as a map of characters: a disc for screen up and one for screen down, seen from outside.

Each half of the sphere is laid flat by Lambert's azimuthal equal-area projection (Snyder, Map Projections,
USGS 1395, Eq. 24-3 and 24-4), so that equal areas of the sphere are equal numbers of characters. In both
discs +x (the left edge lies below) is to the right and +y (upright) at the top.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from stillcal.calib_core.arrays import Array

ROWS, COLUMNS = 13, 27
"""Characters of one disc; a character is about twice as high as wide."""

GAP = 5
"""Columns between the discs."""

TITLES = ("screen up", "screen down")
"""Of the discs."""


@dataclass(frozen=True, slots=True)
class Glyphs:
    """Characters of the map. newest: the last rest; wanted: the next orientation to record."""

    inside: str = "·"
    centre: str = "+"
    newest: str = "●"
    wanted: str = "◎"


ASCII = Glyphs(".", "+", "@", "O")
STYLES = {"inside": "bright_black", "centre": "bright_black", "held": "bold green", "wanted": "bold yellow"}

Place = tuple[int, int, int]
"""Disc (0: screen up), row and column."""


def place(up: Array) -> Place:
    """Return the place on the map of a unit vector (3,), body axes, that points up."""
    x, y, z = (float(v) for v in up)
    k = np.sqrt(1.0 / (1.0 + abs(z)))  # Eq. 24-3 with 2 taken off: the rim is at 1
    row = round((1.0 - k * y) / 2.0 * (ROWS - 1))
    column = round((1.0 + k * x) / 2.0 * (COLUMNS - 1))
    return (0 if z >= 0 else 1), row, column


def inside() -> NDArray[np.bool_]:
    """Return a mask (ROWS, COLUMNS) of the characters within a disc."""
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    middle = np.array([(ROWS - 1) / 2, (COLUMNS - 1) / 2])
    return np.asarray(
        ((y - middle[0]) / (middle[0] + 0.3)) ** 2 + ((x - middle[1]) / (middle[1] + 0.3)) ** 2 <= 1.0
    )


def sphere_map(
    counts: list[tuple[Array, int]],
    newest: Array | None,
    wanted: Array | None,
    glyphs: Glyphs,
    *,
    stacked: bool = False,
) -> Text:
    """Draw orientations (unit vector and number of rests, up to 9 as a digit) as ROWS + 2 lines of text.

    stacked: one disc below the other, for a narrow terminal: twice as many lines, half as wide.
    """
    marks: dict[Place, tuple[str, str]] = {
        (disc, ROWS // 2, COLUMNS // 2): (glyphs.centre, "centre") for disc in (0, 1)
    }
    held: dict[Place, int] = {}
    for up, count in counts:
        held[place(up)] = held.get(place(up), 0) + count
    marks |= {where: (str(min(count, 9)), "held") for where, count in held.items()}
    if newest is not None:
        marks[place(newest)] = (glyphs.newest, "held")
    if wanted is not None:
        marks[place(wanted)] = (glyphs.wanted, "wanted")
    text, gap = Text(style="bold"), " " * GAP
    for discs in ((0,), (1,)) if stacked else ((0, 1),):
        text.append(gap.join(f"{TITLES[disc]:^{COLUMNS}}" for disc in discs) + "\n")
        for row in range(ROWS):
            text.append_text(Text(gap).join(_line(disc, row, marks, glyphs) for disc in discs))
            text.append("\n")
    return text.append("right of a disc: left edge down; top: upright", style="dim not bold")


def _line(disc: int, row: int, marks: dict[Place, tuple[str, str]], glyphs: Glyphs) -> Text:
    line = Text()
    for column, within in enumerate(inside()[row]):
        glyph, kind = marks.get((disc, row, column), (glyphs.inside if within else " ", "inside"))
        line.append(glyph, style=f"not bold {STYLES[kind]}" if kind != "held" else STYLES[kind])
    return line
