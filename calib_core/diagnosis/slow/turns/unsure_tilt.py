"""What turns show of the gyroscope, where what is not known of the accelerometer may be the cause.

A turn is compared with gravity before and after it. What the accelerometer does without a name is in the
direction of gravity. It cannot be taken off, as effects with a name are: its course is known too roughly. Of
effects with a name what is unsure in their sizes is left there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND
from stillcal.calib_core.diagnosis.slow.statement import Stated

OF_TWO = float(np.sqrt(2.0))
"""What two errors that are alike and independent are together: gravity's at both ends of a turn; of what has
no name the one that the rests show, along gravity for the most part, and the one that they do not."""


def unsure_tilt(stated: Sequence[Stated], gravity: float) -> float:
    """Return by how much slow errors of the accelerometer may make turns miss gravity, rad."""
    lengths = [
        OF_TWO * _length(s) if s.finding.effect == "unknown" else _unsure(s)
        for s in stated
        if s.finding.sensor == "accel" and s.finding.where.band_hz == SLOW_BAND
    ]
    return OF_TWO * float(np.linalg.norm(lengths)) / gravity if lengths else 0.0


def _length(stated: Stated) -> float:
    """Return the size of a nameless error, m/s^2; of a gain it is rms over the bins. 0 where it has none."""
    amplitude = stated.finding.parameters.get("amplitude")
    if amplitude is not None:
        return float(np.linalg.norm(np.ravel(amplitude.value)))
    return _rms(stated, stated.sizes) if stated.hypothesis is not None else 0.0


def _unsure(stated: Stated) -> float:
    """Return how unsure a named error is, m/s^2, rms over the bins at rest; 0 where no rests tell it."""
    if stated.hypothesis is None:
        return 0.0
    names = [p.name for p in stated.hypothesis.effect.parameters]
    intervals = [stated.finding.parameters[name].ci95 for name in names]
    widths = np.concatenate([np.ptp(np.asarray(ci), axis=-1).ravel() for ci in intervals])
    return _rms(stated, widths / (2.0 * NORMAL_95))


def _rms(stated: Stated, sizes: Array) -> float:
    """Return what an effect of independent sizes (k,) adds to the force, m/s^2; 0 where no rests tell it."""
    own, residuals = stated.hypothesis, stated.residuals
    if own is None or residuals is None:
        return 0.0
    response = own.effect.response(residuals.moments, own.grid) * sizes
    return float(np.sqrt((response**2).sum(axis=(1, 2)).mean()))


def beyond(tilt: float, stated: Sequence[Stated]) -> list[Stated]:
    """Return the statements of turns whose effect moves gravity by more than `tilt` (rad), rms over turns."""
    return [s for s in stated if _moves(s) > tilt]


def _moves(stated: Stated) -> float:
    """Return by how much an effect as it was found misses gravity, rad, rms over turns."""
    assert stated.hypothesis is not None, "a statement of turns has one"
    return float(np.sqrt(2.0 * np.mean((stated.hypothesis.columns[0][0] @ stated.sizes) ** 2)))
