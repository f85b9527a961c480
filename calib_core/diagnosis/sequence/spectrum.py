"""Lines in the spectrum of what neighbours leave of samples, and residuals without them.

A vibration is no noise. A strong one leaks to all frequencies, since rests begin and end, and the size of
what it leaves goes up and down twice in each of its periods.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.noise.lines.line_spectrum import ASIDE, lines
from stillcal.calib_core.maths import sines
from stillcal.calib_core.maths.chi_squared import exceeded

LINE = 3.0
"""Times the amplitude of its neighbourhood to which a line of the spectrum is cut."""

AROUND = 101
"""Frequencies of a line's neighbourhood."""

MOST_SINES = 8
"""Sines that are taken off: three vibrations with overtones."""

SINE_P = 1e-4
"""Chance of a line that noise makes anywhere in the spectrum, below which it is a sine."""

PIECE = 256
"""Samples in which a sine keeps its amplitude and phase, but for a straight change of both."""


def without_lines(left: Array) -> Array:
    """Return residuals (n, k) with the lines of their spectrum cut: what vibrates is not noise."""
    return np.column_stack([_without_lines(axis) for axis in left.T])


def _without_lines(left: Array) -> Array:
    """Return one axis (n,) of them; by itself, for together a day's spectra take much memory."""
    from scipy.fft import next_fast_len  # noqa: PLC0415 - the daemon stays light
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    length = next_fast_len(len(left), real=True)
    spectrum = np.fft.rfft(left, length)
    size = np.abs(spectrum)
    usual = np.sqrt(uniform_filter1d(np.minimum(size, LINE * np.median(size)) ** 2, AROUND))
    spectrum *= np.minimum(1.0, LINE * usual / np.maximum(size, 1e-300))
    return np.asarray(np.fft.irfft(spectrum, length)[: len(left)])


def without_bands(left: Array, middles: Sequence[float], half: float) -> Array:
    """Return residuals (n, k) without the frequencies, a sample, within `half` of some."""
    from scipy.fft import next_fast_len  # noqa: PLC0415 - the daemon stays light

    length = next_fast_len(len(left), real=True)
    f = np.fft.rfftfreq(length)
    passed = np.abs(f[:, None] - np.asarray(middles)).min(axis=1) > half
    cut = [np.fft.irfft(np.fft.rfft(axis, length) * passed, length)[: len(left)] for axis in left.T]
    return np.column_stack(cut)


def without_sines(left: Array, rest: NDArray[np.bool_], known: Sequence[float] = ()) -> tuple[Array, Array]:
    """Return residuals (n, 3) without sines that stand out of the spectrum, and their frequencies, a sample.

    rest: (n,), where residuals are; they are nothing elsewhere. known: frequencies that single rests show; in
    another attitude a sine may have the opposite sign, and the spectrum of all has none of it.
    """
    parts, found = _pieces(rest), list(known)
    for each in known:
        left = _without_sine(left, parts, each)
    for _ in range(MOST_SINES):
        frequency = _clearest_sine(left)
        if frequency is None:
            break
        found.append(frequency)
        left = _without_sine(left, parts, frequency)
    return left, np.array(found)


def _clearest_sine(left: Array) -> float | None:
    """Return the frequency, a sample, of the line that all axes together show best, or None."""
    told = sum((lines(axis) for axis in left.T), np.zeros(1))
    k = ASIDE + int(np.argmax(told[ASIDE:-ASIDE]))
    limit = exceeded(SINE_P / told.size, 2 * left.shape[1]) / 2.0
    return k / (2.0 * (told.size - 1)) if told[k] > limit else None


def _pieces(rest: NDArray[np.bool_]) -> list[slice]:
    """Return the rows of every piece of a rest."""
    edges = np.flatnonzero(np.diff(rest.astype(np.int8), prepend=0, append=0))
    out = []
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        cuts = np.linspace(a, b, max(round((b - a) / PIECE), 1) + 1).round().astype(int)
        out += [slice(i, j) for i, j in pairwise(cuts) if j - i >= 2 * sines.SINE_NUMBERS]
    return out


def _without_sine(left: Array, parts: Sequence[slice], frequency: float) -> Array:
    """Return residuals without a sine, fitted to every piece by itself."""
    out = left.copy()
    for part in parts:
        counted = np.arange(part.stop - part.start, dtype=np.float64)
        out[part] = sines.without_sines(out[part], counted, [frequency])
    return out
