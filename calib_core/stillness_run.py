"""The rest that is being gathered: still windows one after another that agree with each other.

A window whose mean steps off the running mean by more than noise explains ends the rest, so that a phone
turned gently over between two windows does not join two attitudes. Running sums are strictly sequential
(cumulative), hence the same however many windows come at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stillcal.calib_core.samples import Array, frozen
from stillcal.calib_core.stillness_settings import DetectorSettings, Fate
from stillcal.calib_core.stillness_windows import (
    COLUMNS,
    D2,
    K_END,
    M2,
    MEAN,
    K,
    N,
    across,
    correlation_inflation,
    no_rows,
)

_SUMS = 11  # per sensor: samples, degrees of freedom, samples x mean (3), squares (3), squared steps (3)
_MOTION = (Fate.ACCEL_MOVING, Fate.GYRO_MOVING, Fate.STEPPED, Fate.IMPLAUSIBLE)
_INFLATION = 10.0  # of a window mean's variance by correlated noise; more would be motion


@dataclass(slots=True)
class Run:
    """Windows gathered so far. rows: joint rows; sums: over them; after: what parted it from the last."""

    rows: Array = field(default_factory=lambda: no_rows(2 * COLUMNS))
    sums: Array = field(default_factory=lambda: frozen(np.zeros(2 * _SUMS)))
    after: Fate = Fate.STILL

    @property
    def cells(self) -> int:
        """Length so far in cells of the grid."""
        return int((self.rows[:, K_END] - self.rows[:, K]).sum())


def _contributions(rows: Array) -> Array:
    n, mean = rows[:, N : N + 1], rows[:, MEAN]
    return np.hstack((n, np.maximum(n - 1.0, 0.0), n * mean, rows[:, M2], rows[:, D2]))


def _steps_off(rows: Array, before: Array, own: Array, factor: float, allowance: float) -> Array:
    """Whether each window's mean leaves the mean of all before it. before, own: sums, (n, _SUMS)."""
    n, n_own = before[:, 0], own[:, 0]
    tested = (n > 0) & (n_own > 0)
    pool = before + own
    squares, steps = across(pool[:, 5:8]), across(pool[:, 8:11])
    variance = squares / np.maximum(pool[:, 1], 1.0)
    variance *= correlation_inflation(squares, steps, _INFLATION)
    variance *= 1.0 / np.maximum(n, 1.0) + 1.0 / np.maximum(n_own, 1.0)
    off = rows[:, MEAN] - before[:, 2:5] / np.maximum(n, 1.0)[:, None]
    distance = np.sqrt(across(off * off))
    return np.asarray(tested & (distance > factor * np.sqrt(variance) + allowance))


def absorb(run: Run, rows: Array, coarse: tuple[float, float], settings: DetectorSettings) -> tuple[Run, int]:
    """Add the leading rows that agree with the run; return it and how many were taken.

    coarse: what a sensor's coarseness alone may move a mean by, both sensors, standard.
    """
    own = np.hstack((_contributions(rows[:, :COLUMNS]), _contributions(rows[:, COLUMNS:])))
    running = np.cumsum(np.vstack((run.sums, own)), axis=0)
    off = np.zeros(rows.shape[0], dtype=bool)
    allowances = (settings.force_step, settings.rate_step)
    for i, part in enumerate((slice(0, _SUMS), slice(_SUMS, 2 * _SUMS))):
        if i and not running[-1, _SUMS]:
            break  # no gyroscope, in the run or in these
        half = rows[:, i * COLUMNS : (i + 1) * COLUMNS]
        allowance = allowances[i] + settings.step_factor * coarse[i]
        off |= _steps_off(half, running[:-1, part], own[:, part], settings.step_factor, allowance)
    taken = int(off.argmax()) if off.any() else rows.shape[0]
    grown = Run(np.concatenate((run.rows, rows[:taken])), frozen(running[taken]), run.after)
    return grown, taken


def trimmed(run: Run, ended_by: Fate) -> Array:
    """Return the rows without the windows that border on motion: its first samples may lie in them."""
    first = int(run.after in _MOTION)
    last = run.rows.shape[0] - int(ended_by in _MOTION)
    return run.rows[first : max(last, first)]


def drifted(run: Run, ended_by: Fate) -> bool:
    """Whether the run's mean drifted off at either end, rather than motion parting it from its neighbours."""
    return Fate.STEPPED in (run.after, ended_by)
