"""How figures look: one size, one set of colours (Okabe and Ito's, told apart by anybody), no frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, RED, GREEN, ORANGE, PURPLE, GREY = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7", "0.45"
COLOURS = (BLUE, RED, GREEN, ORANGE, PURPLE, GREY)


def panels(columns: int = 1, rows: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, row by row; options as for matplotlib's `subplots`."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    figure = Figure(figsize=(4.2 * columns + 0.6, 3.2 * rows + 0.2), layout="constrained")
    found = figure.subplots(rows, columns, squeeze=False, **options)
    axes = [axis for row in found for axis in row]
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color="0.92", zorder=0)
        axis.set_axisbelow(True)
        axis.set_prop_cycle(color=COLOURS)
    return figure, axes


def save(figure: Figure, folder: Path, name: str) -> str:
    """Write a figure as NAME.png into `folder` and return the file's name."""
    file = f"{name}.png"
    figure.savefig(folder / file, dpi=130, metadata={"Software": None})
    return file
