"""Allan deviation of the longest rest, each axis with its band, and the noise that explains it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.noise.allan import allan_curve, fit_allan
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.plots.inputs import LEAST_S, LEAST_SAMPLES, Material, Stretch
from stillcal.replay.plots.style import AXES, within

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase

CONFIDENCE = 0.95
"""Of the bands, as of all intervals in the figures."""

SHOWN = {
    Sensor.ACCELEROMETER: (1e6 / STANDARD, "µg", "µg/√Hz"),
    Sensor.GYROSCOPE: (3600 * 180 / np.pi, "°/h", "°/h/√Hz"),
}
"""Factor from SI, and the units shown."""


def draw(part: FigureBase, material: Material) -> None:
    """Draw the curves into a figure or a part of one. Raises NotSupported where no rest is long enough."""
    if not material.stretches:
        raise NotSupported(
            f"no evenly sampled rest lasts {LEAST_S:g} s and {LEAST_SAMPLES} samples",
            ["a recording with a longer rest"],
        )
    for axis, stretch in zip(within(part, len(material.stretches)), material.stretches, strict=True):
        _panel(axis, stretch)


def _panel(axis: Axes, stretch: Stretch) -> None:
    gain, unit, density = SHOWN[stretch.sensor]
    for k, (name, colour, mark) in enumerate(AXES):
        values = gain * stretch.xyz[:, k]
        if np.ptp(values) == 0:
            continue
        curve = allan_curve(values, stretch.rate, CONFIDENCE)
        noise = fit_allan(curve)
        axis.fill_between(curve.tau, curve.low, curve.high, color=colour, alpha=0.2, lw=0)
        label = f"{name}: {noise.N:.3g} {density}"
        axis.loglog(curve.tau, curve.deviation, mark, ms=3.5, color=colour, label=label)
        axis.loglog(curve.tau, noise.deviation(curve.tau), color=colour, lw=1)
    axis.grid(which="both", color="0.94")
    axis.set(xlabel="averaging time, s", ylabel=f"Allan deviation, {unit}")
    length = len(stretch.xyz) / stretch.rate
    axis.set_title(f"{stretch.sensor}: {length:.0f} s at rest, {stretch.rate:.0f} Hz", fontsize="medium")
    axis.legend(fontsize="small", title="white noise; band: 95 %", title_fontsize="small")
