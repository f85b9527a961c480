"""Noise that the axes of a sensor share: what comes in by one supply, one reference or one converter.

Sound sensors have an element an axis, and these know nothing of each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import of_means
from stillcal.calib_core.diagnosis.model.measurement import (
    Measured,
    Seen,
    direct_finding,
    mean_of,
    of_measured,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.noise.low_pass import LEAST_PIECES, Quiet

FLOOR = 1e-2
"""Added to correlations before their logarithm is taken."""

PAIRS = tuple(combinations(range(3), 2))
DRIVER = "noise of the other axes"


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """The two axes whose noise is most alike. coefficient: its correlation, not negative, with its error.

    pieces: (P,) the same piece by piece, of either sign.
    """

    axes: tuple[int, int]
    coefficient: Measured
    pieces: Array

    def size(self) -> Measured:
        """Return the coefficient on the scale of the population of sound phones."""
        return self.coefficient.log(FLOOR)


def shared_noise(still: Quiet) -> Shared | None:
    """Return the two axes whose successive differences at rest are most correlated; None in too few rests.

    Differences know little of what shakes the phone slowly. Errors are from how pieces scatter.
    """
    steps = [d for p in still.pieces if (d := np.diff(p, axis=0)).std(axis=0).min() > 0.0]
    if len(steps) < LEAST_PIECES:
        return None
    by_piece = np.array([np.corrcoef(d.T) for d in steps])
    found = [(pair, mean_of(by_piece[:, pair[0], pair[1]])) for pair in PAIRS]
    axes, most = max(found, key=lambda x: abs(x[1].value))
    sign = 1.0 if most.value >= 0.0 else -1.0
    return Shared(axes, Measured(sign * most.value, most.error), sign * by_piece[:, axes[0], axes[1]])


def shared_noise_finding(found: Shared, sensor: str, sound: Usual, where: Where) -> Finding | None:
    """State a correlation that no sound phone has; it has no name, for many a cause may have it."""
    usual = 10.0**sound.middle - FLOOR
    seen = of_measured(found.size(), sound, of_means(found.pieces, np.array([usual])))
    one_pair = Seen(seen.log_bayes_factor - float(np.log(len(PAIRS))), seen.held_out, seen.unusual)
    a, b = (AXES[i] for i in found.axes)
    say = (
        f"The {NAME[sensor]}'s axes share noise: that of {a} and {b} has a correlation of"
        f" {found.coefficient.value:.2f}."
    )
    parameters = {"correlation": found.coefficient.parameter("1")}
    own = Where(where.t_start, where.t_end, where.band_hz, DRIVER)
    return direct_finding("unknown", sensor, found.axes, own, parameters, statement=say, seen=one_pair)
