"""How far the lines of one long series stand above the spectrum about them.

Two windows, for two tasks. Hann's keeps strong lines apart (`lines`). For a faint line among noise the series
is taken as it is, with as many zeros after it (`faint_lines`): under Hann's window such a line is heard as in
two thirds of the series, and without zeros one half way between two frequencies has 0.4 of its power.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

ASIDE, OWN = 16, 4
"""Lines of the neighbourhood on either side, and those between that are a line's own."""

INDEPENDENT = 2 * ASIDE / 1.5
"""Of these: neighbouring lines under a Hann window are correlated."""

FAR_ASIDE = 128
"""Lines of a wide neighbourhood on either side. Noise's power is known from 2 * 16 so badly that a line which
is certain at 25 nats tells 18; from so many it tells 24."""

HUMP = 1.0 + 2.0 / (2.0 * ASIDE) ** 0.5
"""Times the wide neighbourhood's power from which the near one's counts: two standard errors more."""

TINY = 1e-30
"""What stands for no power, in single precision too: simulations may have no noise."""

ZEROS = 2
"""Frequencies that are looked at for each one that a series tells apart."""


def lines(series: Array) -> Array:
    """Return nats (k,) of lines of a series (m,), up to half a period a sample: by chance exponential."""
    power = _powers(series * _taper(series.size), series.size)
    usual = _about(power, ASIDE, OWN)
    return np.asarray(INDEPENDENT * np.log1p(power / usual / INDEPENDENT))


def faint_lines(series: Array, recorded: float) -> Array:
    """Return nats (k,) of lines of a series (m,), `ZEROS` times as close as `lines` does; by chance as many.

    recorded: the part of the series that is no gap; of neighbouring frequencies only so many are independent.
    The noise is the mean of a wide neighbourhood, or of a near one where this has plainly more: a hump.
    """
    # Single precision takes half of the time and of the memory.
    scaled: NDArray[np.float32] = (series / max(float(np.abs(series).max()), TINY)).astype(np.float32)
    power = _powers(scaled, ZEROS * series.size)
    near, far, own = (round(ZEROS * n / recorded) for n in (ASIDE, FAR_ASIDE, OWN))
    about, usual = _about(power, near, own), _about(power, far, own)
    np.copyto(usual, about, where=about > HUMP * usual)
    independent = 2 * FAR_ASIDE
    return np.asarray(independent * np.log1p(power / usual / independent))


def _powers(series: Array | NDArray[np.float32], length: int) -> Array:
    """Return the spectrum (k,) of a series, with zeros up to a length at least."""
    from scipy.fft import next_fast_len, rfft  # noqa: PLC0415 - the daemon stays light

    spectrum = rfft(series, next_fast_len(length + 1, real=True) // 2 * 2)
    return np.asarray(spectrum.real**2 + spectrum.imag**2)


def _about(power: Array, aside: int, own: int) -> Array:
    """Return the mean power (k,) of the neighbours of each frequency, beyond its own ones."""
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    mine, every = 2 * own + 1, 2 * (aside + own) + 1
    around = every * uniform_filter1d(power, every) - mine * uniform_filter1d(power, mine)
    return np.asarray(np.maximum(around / (every - mine), TINY))


@lru_cache(maxsize=1)
def _taper(n: int) -> Array:
    """Return a Hann window (n,); all series of a sensor are as long."""
    return np.hanning(n)
