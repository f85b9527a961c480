"""The attitudes of the rests, on the two halves of the sphere."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from stillcal.calib_core.accelerometer.observability import most_helpful_attitude
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.static.rest import ATTITUDE_ANGLE, attitude_labels
from stillcal.replay.palette import BLUE, ORANGE
from stillcal.replay.plots.inputs import Material
from stillcal.replay.plots.style import GREY, GRID, MILLI_G

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase

_LINE = 90
"""Characters of a line of the title: the figure's width."""


def flat(up: Array) -> Array:
    """Lay unit vectors (n, 3) flat, (n, 2) within 1: Lambert's equal-area projection of either half.

    Snyder, Map Projections (USGS 1395, 1987), Eq. 24-2 to 24-4 about the pole, with radius 1 / sqrt 2.
    """
    return np.asarray(up[:, :2] / np.sqrt(1.0 + np.abs(up[:, 2:])))


def draw(part: FigureBase, material: Material) -> None:
    """Draw the attitudes into a figure or a part of one, coloured by what the calibration leaves there."""
    rests = material.rests
    labels = attitude_labels(rests.up, ATTITUDE_ANGLE)
    groups = [labels == k for k in range(int(labels.max(initial=-1)) + 1)]
    up = np.array([rests.up[g][0] for g in groups]).reshape(-1, 3)
    counts = np.array([np.count_nonzero(g) for g in groups])
    wanted = most_helpful_attitude(up)
    left, right = part.subplots(1, 2)
    for axis, upper in ((left, True), (right, False)):
        _disc(axis, upper)
        side = (up[:, 2] >= 0) == upper
        xy = flat(up[side])
        if rests.calibrated:
            sizes = np.array([rms(rests.after[g]) for g in groups])[side]
            top = MILLI_G * rms(rests.after)
            drawn = axis.scatter(
                *xy.T,
                s=40 + 12 * counts[side],
                c=MILLI_G * sizes,
                cmap="viridis",
                vmin=0,
                vmax=2 * top,
                zorder=3,
            )
        else:
            axis.scatter(*xy.T, s=40 + 12 * counts[side], color=BLUE, zorder=3)
        if (wanted.up[2] >= 0) == upper:
            axis.plot(*flat(wanted.up[None]).T, "o", mfc="none", mec=ORANGE, ms=14, mew=2.5, zorder=4)
    if rests.calibrated:
        part.colorbar(drawn, ax=[left, right], shrink=0.7, label="|force| - g after, rms, mg")
    part.suptitle(
        f"{len(rests.t)} rests in {len(up)} attitudes (larger: more rests)\n"
        + fill(f"ring: the attitude that would help most: {wanted.words}", _LINE),
        fontsize="medium",
    )


def _disc(axis: Axes, upper: bool) -> None:
    from matplotlib.patches import Circle  # noqa: PLC0415 - an extra

    axis.set_aspect("equal")
    axis.set_axis_off()
    axis.set(xlim=(-1.12, 1.12), ylim=(-1.25, 1.25))
    axis.add_patch(Circle((0, 0), 1.0, fc="none", ec=GREY))
    for tilt in (30, 60):
        axis.add_patch(Circle((0, 0), np.sqrt(2) * np.sin(np.radians(tilt) / 2), fc="none", ec=GRID))
    axis.plot([-1, 1], [0, 0], [0, 0], [-1, 1], color=GRID, zorder=0)
    words: dict[str, Any] = {"va": "center", "ha": "center", "fontsize": "small", "color": GREY}
    axis.text(0, 1.12, "upright (+y up)", **words)
    axis.text(0, -1.12, "upside down (-y up)", **words)
    axis.text(1.08, 0, "left edge (+x up)", rotation=-90, **words)
    axis.text(-1.08, 0, "right edge (-x up)", rotation=90, **words)
    axis.text(0, 1.3, "screen up" if upper else "screen down", ha="center", weight="bold")
