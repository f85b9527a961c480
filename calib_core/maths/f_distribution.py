"""The F distribution's tail, which a test of extra columns needs, without scipy (see student_t.py)."""

from __future__ import annotations

import math

from stillcal.calib_core.maths.student_t import log_beta_share


def tail(ratio: float, more: float, free: float) -> float:
    """Return the probability of more than `ratio` with (more, free) degrees of freedom.

    Abramowitz and Stegun 26.6.2: I_x(free/2, more/2) with x = free / (free + more ratio).

    >>> round(tail(4.26, 3, 9), 3)
    0.039
    """
    return math.exp(log_tail(ratio, more, free))


def log_tail(ratio: float, more: float, free: float) -> float:
    """Return the logarithm of `tail`, also where `tail` itself is less than a float holds.

    Twice the tail of Student's t beyond |t| is that of (1, free) beyond t^2.
    """
    if ratio <= 0.0:
        return 0.0
    x = free / (free + more * ratio)
    if x == 0.0:
        return -math.inf
    a, b = 0.5 * free, 0.5 * more
    if x < (a + 1.0) / (a + b + 2.0):
        return log_beta_share(a, b, x)
    rest = more * ratio / (free + more * ratio)
    return math.log(-math.expm1(log_beta_share(b, a, rest))) if rest else 0.0
