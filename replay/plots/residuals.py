"""The residual of gravity's norm in each rest, before and after calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.rms import rms
from stillcal.replay.palette import BLUE, RED
from stillcal.replay.plots.inputs import Material
from stillcal.replay.plots.style import GREY, MILLI_G, NORMAL_95, within

if TYPE_CHECKING:
    from matplotlib.figure import FigureBase


def draw(part: FigureBase, material: Material) -> None:
    """Draw residuals into a figure or a part of one. Raises NotSupported where nothing is calibrated."""
    rests = material.rests
    if not rests.calibrated:
        raise NotSupported("there is no calibration to compare the rests with", ["more attitudes"])
    before, after = within(part, 2, 1)
    number = np.arange(1, len(rests.t) + 1)
    for axis, values, colour, title in (
        (before, rests.before, RED, "before"),
        (after, rests.after, BLUE, "after"),
    ):
        bars = NORMAL_95 * MILLI_G * rests.uncertainty
        axis.errorbar(
            number, MILLI_G * values, bars, fmt="o", ms=4, color=colour, ecolor=GREY, elinewidth=1, zorder=3
        )
        axis.axhline(0, color=GREY, lw=1)
        axis.set_title(f"{title}: {MILLI_G * rms(values):.3g} mg rms", fontsize="medium")
        axis.set_xlabel("rest")
    before.set_ylabel("|force| - g at rest, mg")
    part.suptitle("bars: 95 % of the rest's own mean", fontsize="small", color=GREY)
