"""How a phone moves: features of windows of force and rate, and Bayes' rule on them.

Collin et al. 2019, Inertial Sensors and Their Applications, 4.1 (Eq. 23-25) and 4.2: standard deviation and
peak frequency of the force's norm (Fig. 10), the list that follows, and the coning error of the rates. All
work on windows (n, m) at once.

    z = features(norms, rates, rate_hz)                  # (n, 12), named by NAMES
    learnt = Bayes.learnt(z, mode, classes=3)            # mode: (n,) 0, 1, 2 of windows whose mode is known
    learnt.posterior(features(others, their_rates, rate_hz)).argmax(axis=1)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.methods.coning import coning_errors

BANDS_HZ = ((0.5, 3.0), (3.0, 8.0), (8.0, 20.0))
NAMES = (
    "standard deviation (log)",
    "peak frequency",
    "skewness",
    "mean absolute deviation (log)",
    "zero-crossing rate",
    *(f"energy {low:g} to {high:g} Hz (log)" for low, high in BANDS_HZ),
    "ratio of lowest to highest band (log)",
    "change of peak frequency over 4 parts",
    "spectral entropy",
    "coning error (log)",
)
TWO = (0, 1)
"""The features of Fig. 10."""
_FLOOR = 1e-12


def features(norms: Array, rates: Array, rate_hz: float) -> Array:
    """Return NAMES of each window, (n, 12), from norms (n, m) m/s^2 and rates (n, m, 3) rad/s at rate_hz."""
    centred = norms - norms.mean(axis=1, keepdims=True)
    sd = centred.std(axis=1)
    f, power = spectrum(centred, rate_hz)
    share = power / np.maximum(power.sum(axis=1, keepdims=True), _FLOOR)
    energies = [power[:, (f >= low) & (f < high)].sum(axis=1) for low, high in BANDS_HZ]
    parts = [peak_frequency(part, rate_hz) for part in np.array_split(centred, 4, axis=1)]
    return np.column_stack(
        (
            _log(sd),
            peak_frequency(centred, rate_hz),
            (centred**3).mean(axis=1) / np.maximum(sd, _FLOOR) ** 3,
            _log(np.abs(centred).mean(axis=1)),
            (np.diff(np.signbit(centred), axis=1)).mean(axis=1) * rate_hz,
            *(_log(e) for e in energies),
            _log(energies[0]) - _log(energies[-1]),
            np.std(parts, axis=0),
            -(share * np.log(np.maximum(share, _FLOOR))).sum(axis=1) / np.log(f.size),
            _log(np.array([coning_errors(np.arange(len(w)) / rate_hz, w).max() for w in rates])),
        )
    )


def spectrum(centred: Array, rate_hz: float) -> tuple[Array, Array]:
    """Return frequencies (k,) Hz above zero and the power of windows (n, m) at them under a Hann window."""
    hann = np.hanning(centred.shape[1])
    power = np.abs(np.fft.rfft(centred * hann, axis=1)) ** 2
    f = np.fft.rfftfreq(centred.shape[1], 1.0 / rate_hz)
    return np.asarray(f[1:], dtype=np.float64), np.asarray(power[:, 1:] / centred.shape[1])


def peak_frequency(centred: Array, rate_hz: float) -> Array:
    """Return the frequency of most power of each window, (n,) Hz."""
    f, power = spectrum(centred, rate_hz)
    return np.asarray(f[power.argmax(axis=1)])


@dataclass(frozen=True, slots=True, eq=False)
class Bayes:
    """Normal classes (Eq. 23). mean: (r, q); covariance: (r, q, q); prior: (r,)."""

    mean: Array
    covariance: Array
    prior: Array

    @classmethod
    def learnt(cls, z: Array, label: NDArray[np.intp], classes: int) -> Bayes:
        """Learn from features (n, q); covariances are kept from being singular by a millionth."""
        own = [z[label == c] for c in range(classes)]
        ridge = 1e-6 * np.diag(z.var(axis=0) + 1e-9)
        return cls(
            np.array([o.mean(axis=0) for o in own]),
            np.array([np.cov(o.T) + ridge for o in own]),
            np.array([len(o) / len(z) for o in own]),
        )

    def posterior(self, z: Array) -> Array:
        """Return P(C = j | z), (n, r), by Eq. 24 and 25."""
        off = z[:, None, :] - self.mean
        distance = np.einsum("nri,rij,nrj->nr", off, np.linalg.inv(self.covariance), off)
        log = np.log(self.prior) - 0.5 * (distance + np.linalg.slogdet(self.covariance)[1])
        weight = np.exp(log - log.max(axis=1, keepdims=True))
        return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def _log(values: Array) -> Array:
    return np.asarray(np.log10(np.maximum(values, _FLOOR)))
