"""The rest that is being gathered: still windows one after another that agree with each other.

A window whose mean steps off the running mean by more than noise explains ends the rest, so that a phone
turned gently over between two windows does not join two attitudes. Running sums are strictly sequential
(cumulative), hence the same however many windows come at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.settings import DetectorSettings, Label
from stillcal.calib_core.static.windows import (
    COLUMNS,
    D2,
    K_END,
    M2,
    MEAN,
    K,
    N,
    correlation_inflation,
    no_rows,
)

Flags = NDArray[np.bool_]

_SUMS = 11  # per sensor: samples, degrees of freedom, samples x mean (3), squares (3), squared steps (3)
_MOTION = (Label.ACCEL_MOVING, Label.GYRO_MOVING, Label.STEPPED, Label.IMPLAUSIBLE)
_INFLATION = 10.0  # of a window mean's variance by correlated noise; more would be motion


_NO_ROWS, _NO_SUMS = no_rows(2 * COLUMNS), frozen(np.zeros(2 * _SUMS))


@dataclass(slots=True)
class Run:
    """Windows gathered so far. rows: joint rows; sums: over them; after: what parted it from the last."""

    rows: Array = field(default_factory=lambda: _NO_ROWS)
    sums: Array = field(default_factory=lambda: _NO_SUMS)
    after: Label = Label.STILL

    @property
    def cells(self) -> int:
        """Length so far in cells of the grid."""
        return int((self.rows[:, K_END] - self.rows[:, K]).sum()) if self.rows.shape[0] else 0


def contributions(rows: Array) -> Array:
    """Return what joint rows (n, 2 COLUMNS) add to a run's sums, (2 _SUMS, n)."""
    own = np.zeros((2 * _SUMS, rows.shape[0]))
    for i in range(2):
        half, out = rows[:, i * COLUMNS : (i + 1) * COLUMNS], own[i * _SUMS : (i + 1) * _SUMS]
        n = half[:, N]
        if i and not n.any():
            break  # no gyroscope
        out[0] = n
        np.maximum(n - 1.0, 0.0, out=out[1])
        np.multiply(n, half[:, MEAN].T, out=out[2:5])
        out[5:11] = half[:, M2.start : D2.stop].T
    return own


def _steps_off(rows: Array, before: Array, own: Array, factor: float, allowance: float) -> Flags:
    """Whether each window's mean leaves the mean of all before it. before, own: sums, (_SUMS, n)."""
    n, n_own = before[0], own[0]
    pool = before + own
    squares, steps = pool[5] + pool[6] + pool[7], pool[8] + pool[9] + pool[10]
    variance = squares / np.maximum(pool[1], 1.0)
    variance *= correlation_inflation(squares, steps, _INFLATION)
    samples = np.maximum(n, 1.0)
    variance *= 1.0 / samples + 1.0 / np.maximum(n_own, 1.0)
    off = rows[:, MEAN].T - before[2:5] / samples
    off *= off
    distance = np.sqrt(off[0] + off[1] + off[2])
    return np.asarray((distance > factor * np.sqrt(variance) + allowance) & (n > 0) & (n_own > 0))


def absorb(
    run: Run, rows: Array, own: Array, coarse: tuple[float, float], settings: DetectorSettings
) -> tuple[Run, int]:
    """Add the leading rows that agree with the run; return it and how many were taken.

    own: their `contributions`. coarse: what a sensor's coarseness alone may move a mean by, both sensors,
    standard.
    """
    running = np.empty((2 * _SUMS, rows.shape[0] + 1))
    running[:, 0], running[:, 1:] = run.sums, own
    np.add.accumulate(running, axis=1, out=running)
    taken = rows.shape[0]
    allowances = (settings.force_step, settings.rate_step)
    for i, part in enumerate((slice(0, _SUMS), slice(_SUMS, 2 * _SUMS))):
        if i and not running[_SUMS, -1]:
            break  # no gyroscope, in the run or in these
        half = rows[:, i * COLUMNS : (i + 1) * COLUMNS]
        allowance = allowances[i] + settings.step_factor * coarse[i]
        off = _steps_off(half, running[part, :-1], own[part], settings.step_factor, allowance)
        taken = min(taken, int(off.argmax())) if off.any() else taken
    gathered = np.concatenate((run.rows, rows[:taken])) if run.rows.shape[0] else rows[:taken]
    return Run(gathered, frozen(running[:, taken].copy()), run.after), taken


def trimmed(run: Run, ended_by: Label) -> Array:
    """Return the rows without the windows that border on motion: its first samples may lie in them."""
    first = int(run.after in _MOTION)
    last = run.rows.shape[0] - int(ended_by in _MOTION)
    return run.rows[first : max(last, first)]


def drifted(run: Run, ended_by: Label) -> bool:
    """Whether the run's mean drifted off at either end, rather than motion parting it from its neighbours."""
    return Label.STEPPED in (run.after, ended_by)
