"""Features of windows of acceleration: time, frequency and ECDF (Stisen et al. 2015, 4.1).

Each family takes windows (n, length, 3) m/s^2 and returns (n, features). The frequency family is told how
long a window lasts and takes its samples for evenly spaced, as recognisers do.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stillcal.calib_core.arrays import Array

SECONDS = 2.0
"""Length of a window (4.1)."""

BINS, ECDF_BINS = 40, 30
"""Spectral coefficients of 0.5 Hz up to 20 Hz; points of the inverse ECDF a component (4.1)."""


def time_features(windows: Array) -> Array:
    """Return ten statistics of x, y, z and the norm, and the three correlations of axes; 43 a window."""
    whole = np.concatenate([windows, np.linalg.norm(windows, axis=2, keepdims=True)], axis=2)
    low, mid, high = np.percentile(whole, [25, 50, 75], axis=1)
    mean, sd = whole.mean(axis=1), whole.std(axis=1)
    least, most = whole.min(axis=1), whole.max(axis=1)
    rms = np.sqrt(np.square(whole).mean(axis=1))
    steps = np.abs(np.diff(whole, axis=1)).mean(axis=1)
    crossings = np.mean(np.diff(np.sign(whole - mean[:, None]), axis=1) != 0, axis=1)
    parts = [mean, sd, mid, least, most, most - least, rms, high - low, steps, crossings]
    return np.concatenate([*parts, _correlations(windows)], axis=1)


def without_counts(features: Array) -> Array:
    """Return time features (n, 43) without those that count by the sample, (n, 35).

    These are the mean step from sample to sample and the share of samples that cross the mean, of each axis
    and of the norm: a device that samples twice as fast halves both.
    """
    return np.asarray(np.delete(features, np.s_[32:40], axis=1))


def _correlations(windows: Array) -> Array:
    off = windows - windows.mean(axis=1, keepdims=True)
    size = np.sqrt(np.square(off).mean(axis=1))
    pairs = ((0, 1), (0, 2), (1, 2))
    return np.stack(
        [(off[:, :, a] * off[:, :, b]).mean(axis=1) / (size[:, a] * size[:, b] + 1e-9) for a, b in pairs],
        axis=1,
    )


def frequency_features(windows: Array, seconds: float = SECONDS) -> Array:
    """Return the norm's spectrum: 40 normalised coefficients to 20 Hz, entropy, peak, sum, mean; 45 a window.

    Coefficients are shares of the whole spectrum's sum, up to the window's own highest frequency; where that
    is below 20 Hz the rest is zero.
    """
    return _spectral(np.linalg.norm(windows, axis=2), seconds)


def frequency_magnitudes(windows: Array, seconds: float = SECONDS) -> Array:
    """Return `frequency_features` with coefficients and sum as magnitudes; 45 a window.

    A magnitude grows with the number of samples: a device that samples twice as fast doubles it.
    """
    return _spectral(np.linalg.norm(windows, axis=2), seconds, shares=False)


def frequency_by_axis(windows: Array, seconds: float = SECONDS) -> Array:
    """Return `frequency_features` of the norm and then the same of each axis; 180 a window."""
    axes = [_spectral(windows[:, :, axis], seconds) for axis in range(3)]
    return np.concatenate([frequency_features(windows, seconds), *axes], axis=1)


def _spectral(values: Array, seconds: float, *, shares: bool = True) -> Array:
    """Return the spectral features of one series a window, (n, length). shares: of the spectrum's sum."""
    mean = values.mean(axis=1)
    spectrum = np.abs(np.fft.rfft(values - mean[:, None], axis=1))[:, 1:]
    total = spectrum.sum(axis=1) + 1e-9
    share = spectrum / total[:, None]
    slot = (np.arange(1, share.shape[1] + 1) / seconds / 0.5 - 0.5).astype(int)
    bins = np.zeros((len(values), BINS))
    for k in np.unique(slot[slot < BINS]):
        bins[:, k] = (share if shares else spectrum)[:, slot == k].sum(axis=1)
    entropy = -(share * np.log(share + 1e-12)).sum(axis=1)
    peak = share.argmax(axis=1)
    rest = [
        entropy,
        (peak + 1) / seconds,
        share.max(axis=1),
        total / (values.shape[1] if shares else 1.0),
        mean,
    ]
    return np.concatenate([bins, np.stack(rest, axis=1)], axis=1)


def ecdf_features(windows: Array) -> Array:
    """Return 30 points of the inverse ECDF of each axis and its mean (Hammerla et al. 2013); 93 a window."""
    points = np.quantile(windows, np.linspace(0.0, 1.0, ECDF_BINS), axis=1)
    parts = [points[:, :, axis].T for axis in range(3)]
    return np.concatenate([*parts, windows.mean(axis=1)], axis=1)


FAMILIES: dict[str, Callable[[Array], Array]] = {
    "time": time_features,
    "frequency": frequency_features,
    "ECDF": ecdf_features,
}
