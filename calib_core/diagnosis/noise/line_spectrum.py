"""How far the lines of one long series stand above the spectrum about them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stillcal.calib_core.arrays import Array

ASIDE, OWN = 16, 4
"""Lines of the neighbourhood on either side, and those between that are a line's own."""

INDEPENDENT = 2 * ASIDE / 1.5
"""Of these: neighbouring lines under a Hann window are correlated."""


def lines(series: Array) -> Array:
    """Return nats (k,) of lines of a series (m,), up to half a period a sample: by chance exponential."""
    from scipy.fft import next_fast_len  # noqa: PLC0415 - the daemon stays light
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    length = next_fast_len(series.size + 1, real=True) // 2 * 2
    power = np.abs(np.fft.rfft(series * _taper(series.size), length)) ** 2
    own, every = 2 * OWN + 1, 2 * (ASIDE + OWN) + 1
    around = every * uniform_filter1d(power, every) - own * uniform_filter1d(power, own)
    usual = np.maximum(around / (every - own), 1e-300)
    return np.asarray(INDEPENDENT * np.log1p(power / usual / INDEPENDENT))


@lru_cache(maxsize=1)
def _taper(n: int) -> Array:
    """Return a Hann window (n,); all series of a sensor are as long."""
    return np.hanning(n)
