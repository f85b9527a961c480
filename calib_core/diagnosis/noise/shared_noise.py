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
    DirectEvidence,
    Measured,
    direct_finding,
    mean_of,
    of_measured,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.noise.low_pass import LEAST_PIECES, Quiet, Spectra, spectra
from stillcal.calib_core.diagnosis.noise.noise_level import level_part

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


def sums_of_pairs(still: Quiet) -> Array:
    """Return the densities (pieces, F, 3) of the sums of two axes, in the order of `PAIRS`."""
    return spectra(still, np.array([[a in pair for pair in PAIRS] for a in range(3)], dtype=np.float64))[1]


def shared_noise(still: Quiet, spectrum: Spectra) -> Shared | None:
    """Return the two axes whose noise at rest is most correlated; None in too few rests.

    spectrum: that of the rests, of three pieces at least. Frequencies count where the noise is level, as for
    the level itself: what stands out is a vibration, and alike on all axes. They weigh as in successive
    differences, which know little of what shakes the phone slowly. Errors are from how pieces scatter.
    """
    _, used, _ = level_part(spectrum)
    weight = np.sin(np.pi * spectrum.f[used] / spectrum.rate) ** 2

    def power(density: Array) -> Array:
        return np.asarray(np.einsum("pfa,f->pa", density[:, used], weight))

    own = power(spectrum.power)
    alive = (own > 0.0).all(axis=1)
    if alive.sum() < LEAST_PIECES:
        return None
    own, both = own[alive], power(sums_of_pairs(still))[alive]
    first, second = (own[:, list(axes)] for axes in zip(*PAIRS, strict=True))
    # A sum of two has the power of both and twice what they share.
    by_piece = (both - first - second) / (2.0 * np.sqrt(first * second))
    found = [mean_of(of_pair) for of_pair in by_piece.T]
    best = int(np.argmax([abs(m.value) for m in found]))
    sign = 1.0 if found[best].value >= 0.0 else -1.0
    most = Measured(sign * found[best].value, found[best].error)
    return Shared(PAIRS[best], most, sign * by_piece[:, best])


def shared_noise_finding(found: Shared, sensor: str, sound: Usual, where: Where) -> Finding | None:
    """State a correlation that no sound phone has; it has no name, for many a cause may have it."""
    usual = 10.0**sound.middle - FLOOR
    seen = of_measured(found.size(), sound, of_means(found.pieces, np.array([usual])))
    one_pair = DirectEvidence(seen.log_bayes_factor - float(np.log(len(PAIRS))), seen.held_out, seen.unusual)
    a, b = (AXES[i] for i in found.axes)
    say = (
        f"The {NAME[sensor]}'s axes share noise: that of {a} and {b} has a correlation of"
        f" {found.coefficient.value:.2f}."
    )
    parameters = {"correlation": found.coefficient.parameter("1")}
    own = Where(where.t_start, where.t_end, where.band_hz, DRIVER)
    return direct_finding("unknown", sensor, found.axes, own, parameters, statement=say, seen=one_pair)
