"""What turns show of the gyroscope, where what is not known of either sensor's bias may be the cause.

A turn is compared with gravity before and after it. What the accelerometer does without a name is in the
direction of gravity; what the gyroscope's bias does, in the angle that it adds up to over the turn. Neither
can be taken off, as effects with a name are: their course is known too roughly. Of effects with a name what
is unsure in their sizes is left there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Finding
from stillcal.calib_core.diagnosis.slow.statement import Stated

OF_TWO = float(np.sqrt(2.0))
"""What two errors that are alike and independent are together: gravity's at both ends of a turn; of what has
no name the one that the rests show, of the force along gravity for the most part, and the one that they do
not: across it, or while the phone turns."""


def unsure_tilt(stated: Sequence[Stated], gravity: float, lasts: float) -> float:
    """Return by how much slow errors of both sensors may make turns miss gravity, rad.

    lasts: s, how long the turns last, rms.
    """
    slow = [s for s in stated if s.finding.where.band_hz == SLOW_BAND]
    force, rate = (
        float(np.sqrt(sum(_length(s) ** 2 for s in slow if s.finding.sensor == sensor)))
        for sensor in ("accel", "gyro")
    )
    return float(np.hypot(OF_TWO * force / gravity, rate * lasts))


def _length(stated: Stated) -> float:
    """Return how large an error is that is not taken off, SI: a nameless one, or what is unsure of one.

    It is rms over the bins where it has no amplitude, and 0 where no rests tell it.
    """
    nameless, amplitude = stated.finding.effect == "unknown", stated.finding.parameters.get("amplitude")
    if nameless and amplitude is not None:
        return OF_TWO * float(np.linalg.norm(np.ravel(amplitude.value)))
    own, residuals = stated.hypothesis, stated.residuals
    if own is None or residuals is None:
        return 0.0
    sizes = OF_TWO * stated.sizes if nameless else _errors(stated.finding, own)
    response = own.effect.response(residuals.moments, own.grid) * sizes
    return float(np.sqrt((response**2).sum(axis=(1, 2)).mean()))


def _errors(finding: Finding, own: Hypothesis) -> Array:
    """Return the standard errors (k,) that a finding states of an effect's sizes."""
    intervals = [finding.parameters[p.name].ci95 for p in own.effect.parameters]
    widths = np.concatenate([np.ptp(np.asarray(ci), axis=-1).ravel() for ci in intervals])
    return np.asarray(widths / (2.0 * NORMAL_95))


def beyond(tilt: float, stated: Sequence[Stated]) -> list[Stated]:
    """Return the statements of turns whose effect moves gravity by more than `tilt` (rad), rms over turns."""
    return [s for s in stated if _moves(s) > tilt]


def _moves(stated: Stated) -> float:
    """Return by how much an effect as it was found misses gravity, rad, rms over turns."""
    assert stated.hypothesis is not None, "a statement of turns has one"
    return float(np.sqrt(2.0 * np.mean((stated.hypothesis.columns[0][0] @ stated.sizes) ** 2)))
