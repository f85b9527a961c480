"""The README's picture: the sample recording before and after, and what its diagnosis finds.

`python -m stillcal.replay.trials.pages.picture docs/images/sample.png` draws it (extra `report`).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import stillcal
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.maths.rms import rms
from stillcal.replay import palette
from stillcal.replay.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MILLI_G = 1000.0 / STANDARD
DEGREES = 180.0 / np.pi


def picture(path: Path) -> None:
    """Draw the picture from the sample recording through the public interface."""
    calibration = stillcal.calibrate("sample:lab")
    diagnosis = stillcal.diagnose("sample:lab")
    figure, (rests, warmth) = style.panels(2, 1)
    _draw_rests(rests, calibration)
    _draw_warmth(warmth, calibration, diagnosis)
    style.save(figure, path)


def _draw_rests(axis: Axes, calibration: stillcal.Calibration) -> None:
    """Draw how far the norm of the force at each rest is from gravity, raw and calibrated."""
    part, states = calibration.accelerometer, calibration.record.states
    assert part is not None
    minutes = [0.5 * (s.t_start + s.t_end) / 60.0 for s in states]
    force = np.array([s.specific_force for s in states])
    for values, colour, label in (
        (force, palette.RED, "raw"),
        (part.model.apply(force), palette.BLUE, "calibrated"),
    ):
        error = MILLI_G * (np.linalg.norm(values, axis=1) - part.gravity)
        axis.plot(minutes, error, "o", color=colour, markersize=4, label=f"{label}: {rms(error):.3g} mg rms")
    axis.set(title="Accelerometer: |force| - g at rest", xlabel="time, min", ylabel="mg")
    axis.legend(frameon=False, loc="upper center", ncols=2, fontsize=8)
    axis.set_ylim(top=85)


def _draw_warmth(axis: Axes, calibration: stillcal.Calibration, diagnosis: stillcal.Diagnosis) -> None:
    """Draw the gyroscope's rate at rest against temperature, with the slopes that the diagnosis fitted."""
    states = calibration.record.states
    warm = np.array([s.temperature for s in states], dtype=np.float64)
    rate = DEGREES * np.array([s.rate for s in states])
    (finding,) = (f for f in diagnosis.findings if f["effect"] == "gyro_bias_temperature")
    slope = DEGREES * np.array(finding["parameters"]["slope"]["value"])
    ends = np.array([warm.min(), warm.max()])
    for i, (name, colour, mark) in enumerate(style.AXES):
        label = f"{name}: {slope[i]:+.3f} °/s per °C"
        axis.plot(warm, rate[:, i], mark, color=colour, markersize=4, label=label)
        axis.plot(ends, rate[:, i].mean() + slope[i] * (ends - warm.mean()), color=colour, linewidth=1)
    axis.set(title="Gyroscope: bias and temperature", xlabel="temperature, °C", ylabel="rate at rest, °/s")
    axis.legend(frameon=False, loc="center", fontsize=8, bbox_to_anchor=(0.5, 0.45))


if __name__ == "__main__":
    picture(Path(sys.argv[1]))
