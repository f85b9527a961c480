"""The figures of the studies: the style that all figures have, and where a study's are kept."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stillcal.replay.palette import BLUE, GREEN, ORANGE, PURPLE, RED
from stillcal.replay.plots import style
from stillcal.replay.plots.style import AXES, COLOURS, GREY, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["AXES", "BLUE", "COLOURS", "GREEN", "GREY", "ORANGE", "PURPLE", "RED", "panels", "save"]


def save(figure: Figure, folder: Path, name: str) -> str:
    """Write a figure as NAME.png into `folder` and return the file's name."""
    file = f"{name}.png"
    style.save(figure, folder / file)
    return file
