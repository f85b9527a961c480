"""Whether a delay between the sensors, or an arm, is the same at every frequency and along every direction.

It is, if there is one; a hand or a hip whose acceleration goes with its rate of turn looks like another at
every frequency. The estimate is as uncertain as its parts disagree (a random-effects mean: DerSimonian and
Laird, Control. Clin. Trials 7, 1986).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.motion.block_regression import TAPERED

Spectrum = NDArray[np.complex128]

LOWEST, OCTAVES = 0.12, 7
"""Hz, lower end of the first of so many bands; slower motion is a band of its own."""


def disagreement(term: Spectrum, left: Spectrum, frequency: Array) -> float:
    """Return the standard error of a term's size that its scatter over bands and directions makes.

    term: (K, f, 3), what it does to K windows' spectra at a size of one, and left: (K, f, 3), what the fit
    leaves of them, both weighed so that noise is one; frequency: (f,) Hz. A term that is nothing scatters by
    nothing.
    """
    band = np.digitize(frequency, LOWEST * 2.0 ** np.arange(OCTAVES))
    cell = (band[:, None] * 3 + np.arange(3)).ravel()
    information = np.bincount(cell, (np.abs(term) ** 2).sum(axis=0).ravel())
    pull = np.bincount(cell, (np.conj(term) * left).real.sum(axis=0).ravel())
    seen = information > 0.0
    if not seen.any():
        return 0.0
    away, weight = pull[seen] / information[seen], 2.0 * information[seen] / TAPERED
    total = weight.sum()
    excess = float(weight @ away**2) - (away.size - 1)
    between = max(excess, 0.0) / max(float(total - (weight**2).sum() / total), 1e-300)
    return float(np.sqrt(between * (weight**2).sum()) / total)
