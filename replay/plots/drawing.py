"""The figures by name, one alone or all that can be drawn on one sheet."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from stillcal.calib_core.errors import NotSupported
from stillcal.replay.plots import allan, attitudes, history, residuals, style
from stillcal.replay.plots.inputs import Material

if TYPE_CHECKING:
    from matplotlib.figure import Figure, FigureBase

FIGURES: dict[str, tuple[Callable[[FigureBase, Material], None], float, float]] = {
    "attitudes": (attitudes.draw, 2.0, 1.35),
    "residuals": (residuals.draw, 2.0, 1.0),
    "history": (history.draw, 2.0, 1.6),
    "allan": (allan.draw, 2.0, 1.1),
}
"""What draws it, and its width and height in panels."""

ALL = "all"


def draw_figure(what: str, material: Material) -> tuple[Figure, list[str]]:
    """Return the figure called `what`, and why parts of `all` are not in it.

    Raises NotSupported where there is nothing to draw it from.
    """
    if what != ALL:
        draw, columns, rows = FIGURES[what]
        sheet = style.figure(columns, rows)
        draw(sheet, material)
        return sheet, []
    names, omitted = _possible(material)
    if not names:
        raise NotSupported("; ".join(omitted), ["a recording with rests"])
    heights = [FIGURES[name][2] for name in names]
    sheet = style.figure(2.0, sum(heights))
    parts = sheet.subfigures(len(names), 1, height_ratios=heights, squeeze=False)[:, 0]
    for name, part in zip(names, parts, strict=True):
        FIGURES[name][0](part, material)
    return sheet, omitted


def _possible(material: Material) -> tuple[list[str], list[str]]:
    """Return the names of the figures that there is material for, and a line on each of the others."""
    omitted: list[str] = []
    names: list[str] = []
    for name, (draw, columns, rows) in FIGURES.items():
        try:
            draw(style.figure(columns, rows), material)
        except NotSupported as refusal:
            omitted.append(f"figure {name} left out: {refusal}")
        else:
            names.append(name)
    return names, omitted
