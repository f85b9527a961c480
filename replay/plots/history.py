"""The parameters from calibration to calibration, with 95 % intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stillcal.calib_core.accelerometer.parameters import AXES as LETTERS
from stillcal.calib_core.accelerometer.parameters import BIAS, DIAGONAL
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import CalibrationRecord, SensorRecord
from stillcal.calib_core.errors import NotSupported
from stillcal.replay.plots.inputs import Material, Moment
from stillcal.replay.plots.style import AXES, DEGREES, MILLI_G, NORMAL_95, within

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase

BESIDE = 0.012
"""How far the marks of one moment's axes stand beside each other, as a share of the whole time."""

Part = Callable[[CalibrationRecord], SensorRecord | None]


def _accelerometer(record: CalibrationRecord) -> SensorRecord | None:
    return record.accelerometer


def _gyroscope(record: CalibrationRecord) -> SensorRecord | None:
    return record.gyroscope


PANELS: tuple[tuple[Part, tuple[str, ...], float, str], ...] = (
    (_accelerometer, BIAS, MILLI_G, "accelerometer bias, mg"),
    (_accelerometer, DIAGONAL, 100.0, "accelerometer scale - 1, %"),
    (_gyroscope, BIAS, DEGREES, "gyroscope bias, °/s"),
    (_gyroscope, DIAGONAL, 100.0, "gyroscope scale - 1, %"),
)


def draw(part: FigureBase, material: Material) -> None:
    """Draw the history into a figure or a part of one. Raises NotSupported where there is none."""
    moments = [m for m in material.history if m.at is not None]
    if not moments:
        raise NotSupported("there is no history", ["a calibration"])
    moments.sort(key=lambda m: m.at or 0.0)
    unit, length = ("h", 3600.0) if (moments[-1].at or 0.0) > 7200 else ("min", 60.0)
    panels = within(part, 2, 2, sharex=True)
    for axis, (sensor, names, gain, label) in zip(panels, PANELS, strict=True):
        _panel(axis, moments, sensor, names, (gain, length))
        axis.set_ylabel(label, fontsize="small")
        if axis.has_data():
            above: dict[str, Any] = {
                "loc": "lower left",
                "bbox_to_anchor": (0.0, 1.0),
                "ncols": 3,
                "frameon": False,
            }
            axis.legend(fontsize="small", handletextpad=0.1, columnspacing=1.0, **above)
    for axis in panels[2:]:
        axis.set_xlabel(unit)
    part.suptitle(
        "change from the last value (above each panel); bars: 95 %; hollow: fitted and rejected",
        fontsize="small",
    )


def _panel(
    axis: Axes, moments: Sequence[Moment], sensor: Part, names: Sequence[str], units: tuple[float, float]
) -> None:
    """Draw one kind of parameter minus its last value. units: factor to the unit shown; s per time unit."""
    gain, length = units
    span = np.ptp([m.at or 0.0 for m in moments]) / length
    if span == 0.0:  # a single moment stands in the middle of the panel
        only = (moments[0].at or 0.0) / length
        axis.set_xlim(only - 0.5, only + 0.5)
        span = 1.0
    last = [sensor(m.record) for m in moments if m.what != "rejected" and sensor(m.record) is not None]
    zero = _values(last[-1], names)[0] if last else np.zeros(3)
    for accepted in (True, False):
        chosen = [m for m in moments if (m.what != "rejected") == accepted and sensor(m.record) is not None]
        if not chosen:
            continue
        when = np.array([m.at or 0.0 for m in chosen]) / length
        values = np.array([_values(sensor(m.record), names) for m in chosen])
        for k, (name, colour, mark) in enumerate(AXES):
            axis.errorbar(
                when + (k - 1) * BESIDE * span,
                gain * (values[:, 0, k] - zero[k]),
                gain * NORMAL_95 * values[:, 1, k],
                fmt=mark,
                ms=4,
                color=colour,
                elinewidth=1,
                label=f"{name}: {gain * zero[k]:.5g}" if accepted else None,
                mfc=colour if accepted else "none",
                alpha=1.0 if accepted else 0.5,
            )


def _values(part: SensorRecord | None, names: Sequence[str]) -> Array:
    """Return values and standard uncertainties (2, 3); a scale is counted from 1."""
    assert part is not None
    value = part.bias if tuple(names) == BIAS else np.diag(part.scale) - 1.0
    sd = np.full(len(LETTERS), np.nan)
    if part.covariance is not None and set(names) <= set(part.names):
        rows = [part.names.index(name) for name in names]
        sd = np.sqrt(np.diag(part.covariance)[rows])
    return np.array([value, np.where(np.isfinite(sd), sd, 0.0)])
