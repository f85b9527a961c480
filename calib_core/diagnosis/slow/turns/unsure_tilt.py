"""What turns show of the gyroscope, where what is not known of the accelerometer may be the cause.

A turn is compared with gravity before and after it. What the accelerometer does without a name is in the
direction of gravity. It cannot be taken off, as effects with a name are: its course is known too roughly. Of
effects with a name what is unsure in their sizes is left there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND
from stillcal.calib_core.diagnosis.slow.statement import Stated


def unsure_tilt(stated: Sequence[Stated], gravity: float) -> float:
    """Return by how much slow errors of the accelerometer may still turn gravity's direction, rad."""
    lengths = [
        _length(s) if s.finding.effect == "unknown" else _unsure(s)
        for s in stated
        if s.finding.sensor == "accel" and s.finding.where.band_hz == SLOW_BAND
    ]
    return float(np.linalg.norm(lengths)) / gravity if lengths else 0.0


def _length(stated: Stated) -> float:
    """Return the size of a nameless error, m/s^2; 0 where it has none."""
    amplitude = stated.finding.parameters.get("amplitude")
    return 0.0 if amplitude is None else float(np.linalg.norm(np.ravel(amplitude.value)))


def _unsure(stated: Stated) -> float:
    """Return how unsure a named error is, m/s^2, rms over the bins at rest; 0 where no rests tell it."""
    own, residuals = stated.hypothesis, stated.residuals
    if own is None or residuals is None:
        return 0.0
    intervals = [stated.finding.parameters[p.name].ci95 for p in own.effect.parameters]
    widths = np.concatenate([np.ptp(np.asarray(ci), axis=-1).ravel() for ci in intervals])
    response = own.effect.response(residuals.moments, own.grid) * (widths / (2.0 * NORMAL_95))
    return float(np.sqrt((response**2).sum(axis=(1, 2)).mean()))


def beyond(tilt: float, stated: Sequence[Stated]) -> list[Stated]:
    """Return the statements of turns whose effect moves gravity by more than `tilt` (rad), rms over turns."""
    return [s for s in stated if _moves(s) > tilt]


def _moves(stated: Stated) -> float:
    """Return by how much an effect as it was found misses gravity, rad, rms over turns."""
    assert stated.hypothesis is not None, "a statement of turns has one"
    return float(np.sqrt(2.0 * np.mean((stated.hypothesis.columns[0][0] @ stated.sizes) ** 2)))
