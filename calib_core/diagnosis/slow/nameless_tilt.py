"""What turns show of the gyroscope, where a nameless error of the accelerometer may be the cause.

A turn is compared with gravity before and after it. What the accelerometer does without a name is in the
direction of gravity. It cannot be taken off, as effects with a name are: its course is known too roughly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Finding
from stillcal.calib_core.diagnosis.slow.findings import Stated


def nameless_tilt(findings: Sequence[Finding], gravity: float) -> float:
    """Return by how much the accelerometer's nameless slow errors may turn gravity's direction, rad."""
    lengths = [
        np.linalg.norm(np.ravel(f.parameters["amplitude"].value))
        for f in findings
        if f.effect == "unknown" and f.sensor == "accel" and f.where.band_hz == SLOW_BAND
        if "amplitude" in f.parameters
    ]
    return float(np.linalg.norm(lengths)) / gravity if lengths else 0.0


def beyond(tilt: float, stated: Sequence[Stated]) -> list[Stated]:
    """Return the statements of turns whose effect moves gravity by more than `tilt` (rad), rms over turns."""
    return [s for s in stated if _moves(s) > tilt]


def _moves(stated: Stated) -> float:
    """Return by how much an effect as it was found misses gravity, rad, rms over turns."""
    assert stated.hypothesis is not None, "a statement of turns has one"
    return float(np.sqrt(2.0 * np.mean((stated.hypothesis.columns[0][0] @ stated.sizes) ** 2)))
