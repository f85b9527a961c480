"""The score of a hypothesis: how rarely chance gains as much likelihood, among as many trials.

docs/diagnosis.md, 5, has the formula.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.maths.f_distribution import log_tail

LN10 = math.log(10.0)
LARGEST = 700.0
"""Fall of a log sum of squares beyond which no float holds their ratio."""


def score(gain: float, parameters: int, dof: float, trials: float) -> float:
    """Return S: minus log10 of the F tail of a gain in log likelihood, less log10 of the grid's size."""
    left = max(dof - parameters, 1.0)
    fall = min(2.0 * max(gain, 0.0) / dof, LARGEST)
    tail = log_tail(math.expm1(fall) * left / parameters, parameters, left)
    return -tail / LN10 - math.log10(trials)


def gain_of(reached: float, parameters: int, dof: float, trials: float) -> float:
    """Return the gain in log likelihood at which a score is reached.

    The tail of F is I_x(left/2, k/2), with -2 gain = dof ln x and `left` degrees of freedom beside k
    parameters (Abramowitz and Stegun, 26.6.2).
    """
    from scipy.special import betaincinv  # noqa: PLC0415 - the daemon stays light

    tail = np.exp(-(reached + np.log10(trials)) * LN10)
    x = float(betaincinv(max(dof - parameters, 1.0) / 2.0, parameters / 2.0, tail))
    return -0.5 * dof * math.log(max(x, 1e-300))


def degrees(reduced: Sequence[Reduced], h: int) -> float:
    """Return the degrees of freedom of the views that see hypothesis `h`."""
    return sum(v.dof for v in reduced if v.own(h)[0].trace() > 0.0)


def visible(reduced: Sequence[Reduced], h: int) -> int:
    """Return how many directions of hypothesis `h` would show above white noise at their physical size."""
    information = np.asarray(sum(v.blocks[h][0] for v in reduced))
    k = len(information) - reduced[0].shared
    across = information[:k, k:]
    hidden = across @ np.linalg.solve(information[k:, k:] + np.eye(len(information) - k), across.T)
    return int((np.linalg.eigvalsh(information[:k, :k] - hidden) > 1.0).sum())
