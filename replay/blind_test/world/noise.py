"""The examiner's own sensor noise: drawn by shaping white spectra, with the covariance that goes with it.

Flicker and Gauss-Markov noise are white Gaussian spectra multiplied by the square root of their density on
a circular grid eight times the recording's length, so that drawing and covariance come from one density;
random walks are running sums. Densities are one-sided, per Hz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array

GRID_S = 1.0
"""Step of the slow noise's grid, s; between its points it is interpolated."""

ROOM = 8
"""Length of the circular grid, in lengths of the recording."""

FAMILIES = ("white", "flicker", "gauss_markov", "random_walk", "mixture")


@dataclass(frozen=True, slots=True)
class Colour:
    """Noise of one sensor, the same on its axes, in the sensor's unit.

    white: density per sqrt(Hz). floor: lowest Allan deviation of the flicker. sigma, tau_s: Gauss-Markov
    standard deviation and correlation time. walk: random walk per sqrt(s).
    """

    white: float
    floor: float = 0.0
    sigma: float = 0.0
    tau_s: float = 300.0
    walk: float = 0.0

    def density(self, f: Array) -> Array:
        """Return the one-sided density of flicker and Gauss-Markov noise at f (n,) > 0 Hz.

        Flicker h / f has the Allan variance 2 ln 2 h (Barnes et al. 1971, IEEE Trans. IM-20, Table I).
        """
        flicker = self.floor**2 / (2.0 * math.log(2.0)) / f
        markov = 4.0 * self.sigma**2 * self.tau_s / (1.0 + (2.0 * math.pi * f * self.tau_s) ** 2)
        return flicker + markov

    def drawn(self, duration: float, rng: np.random.Generator) -> Array:
        """Draw the slow noise of three axes on the grid over `duration` s; shape (k, 3)."""
        count = math.ceil(duration / GRID_S) + 2
        slow = np.zeros((count, 3))
        if self.floor > 0.0 or self.sigma > 0.0:
            slow += self._shaped(count, rng)
        if self.walk > 0.0:
            steps = self.walk * math.sqrt(GRID_S) * rng.standard_normal((count, 3))
            slow += np.cumsum(steps, axis=0) - steps[0]
        return slow

    def _shaped(self, count: int, rng: np.random.Generator) -> Array:
        size = _grid_size(count)
        f: Array = np.arange(1, size // 2 + 1) / (size * GRID_S)
        # A one-sided density S puts the variance S df on each line; irfft scales by 2 / size.
        height = np.sqrt(self.density(f) / (size * GRID_S)) * size / 2.0
        lines = rng.standard_normal((f.size, 3)) + 1j * rng.standard_normal((f.size, 3))
        spectrum = np.concatenate([np.zeros((1, 3)), lines * height[:, None]])
        return np.asarray(np.fft.irfft(spectrum, size, axis=0)[:count])

    def covariance(self, centres: Array, width: float) -> Array:
        """Return the covariance (m, m) of averages over `width` s about centres (m,) s, of one axis."""
        lag = np.abs(centres[:, None] - centres[None, :])
        result = np.diag(np.full(centres.size, self.white**2 / (2.0 * width)))
        if self.floor > 0.0 or self.sigma > 0.0:
            result += self._lagged(lag, width, float(centres[-1] + width))
        if self.walk > 0.0:
            earlier = np.minimum(centres[:, None], centres[None, :])
            result += self.walk**2 * (earlier - np.where(lag == 0.0, width / 6.0, 0.0))
        return result

    def _lagged(self, lag: Array, width: float, duration: float) -> Array:
        count = math.ceil(duration / GRID_S) + 2
        size = _grid_size(count)
        f: Array = np.arange(1, size // 2 + 1) / (size * GRID_S)
        power = np.concatenate([[0.0], self.density(f) * np.sinc(f * width) ** 2])
        line = np.fft.irfft(power, size) / (2.0 * GRID_S)
        return np.asarray(np.interp(lag.ravel(), np.arange(count) * GRID_S, line[:count])).reshape(lag.shape)


def _grid_size(count: int) -> int:
    return 1 << (ROOM * count - 1).bit_length()


def at(slow: Array, t: Array) -> Array:
    """Return grid noise (k, 3) at times (n,) s, linearly between the grid's points; shape (n, 3)."""
    place = np.clip(t / GRID_S, 0.0, len(slow) - 1.001)
    node = place.astype(np.int64)
    share = (place - node)[:, None]
    values: Array = slow[node] * (1.0 - share) + slow[node + 1] * share
    return values


_SIZES = {
    "accel": {
        "white": (1.0e-3, 3.0e-3),
        "floor": (2e-4, 6e-4),
        "sigma": (3e-4, 2e-3),
        "walk": (2e-5, 1.5e-4),
    },
    "gyro": {"white": (7e-5, 3e-4), "floor": (1.5e-5, 7e-5), "sigma": (2e-5, 2e-4), "walk": (1e-6, 8e-6)},
}
"""Ranges of phones' noise, drawn evenly in logarithm. White: 100-300 ug/sqrt(Hz), 0.004-0.017 deg/s/sqrt(Hz);
flicker floors of 20-60 ug and 3-15 deg/h; walks from a fifteenth to a half of what Android allows
(compatibility definition, 7.3: 30 ug sqrt(Hz), 0.001 deg/s sqrt(Hz)). Assumed within what makers quote."""


def drawn_colour(family: str, sensor: str, rng: np.random.Generator) -> Colour:
    """Draw a sensor's noise of one family; a mixture has all members at 0.6 of their size."""
    sizes = {name: log_uniform(rng, *span) for name, span in _SIZES[sensor].items()}
    tau = log_uniform(rng, 60.0, 1000.0)
    members = {
        "white": (),
        "flicker": ("floor",),
        "gauss_markov": ("sigma",),
        "random_walk": ("walk",),
        "mixture": ("floor", "sigma", "walk"),
    }
    share = 0.6 if family == "mixture" else 1.0
    slow = {name: share * sizes[name] for name in members[family]}
    return Colour(sizes["white"], tau_s=tau, **slow)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw one number evenly in logarithm."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))
