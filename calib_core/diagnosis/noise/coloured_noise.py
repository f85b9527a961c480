"""Noise at rest that is neither white nor white noise behind a low-pass: the band that stands apart most.

A sensor's own noise has one spectrum in every rest and on every axis, whatever the phone lies on. What shakes
the phone differs from rest to rest, and from axis to axis. So a band counts only where its power is as even
over rests, and as alike on the axes in each of them, as chance leaves it. What shakes the phone steadily
moves the axes together, while each axis' own noise knows nothing of the others (`moves_together`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import of_means
from stillcal.calib_core.diagnosis.model.measurement import (
    Measured,
    direct_finding,
    mean_of,
    of_measured,
)
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Where
from stillcal.calib_core.diagnosis.model.settings import BANDWIDTH_LIMIT
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.noise.low_pass import (
    LEAST_PIECES,
    SHARED,
    UNSTEADY,
    USED_RANGE,
    Quiet,
    Spectra,
    quietest,
)
from stillcal.calib_core.diagnosis.noise.noise_level import OF_MEDIAN
from stillcal.calib_core.diagnosis.noise.shared_noise import PAIRS, sums_of_pairs
from stillcal.calib_core.maths.robust import MAD_TO_SD

DRIVER = "frequency in the spectrum of the noise"

SEEN = float(np.exp(-USED_RANGE))
"""Part of its power that a low-pass leaves where the noise before it is still judged."""

WIDTH = 1.15
"""Upper over lower frequency of the narrowest band."""

CHANCE = 0.08
"""Natural logarithm of power that chance may move a band by: narrower ones are taken together."""

FEWEST = 9
"""Frequencies of the narrowest band: twice as many as a line has."""

LEAST_BANDS = 3
"""Bands of which the middle one is most of the spectrum."""

LINE, MOST = 5, 0.75
"""Neighbouring frequencies that a line is spread over, and the part of a band's power that makes it one."""

UNLIKE = 0.25
"""Part of a band's logarithm by which a sensor's axes may differ in it."""

UNEVEN = 0.05
"""Part of a band's logarithm by which rests may scatter besides: few frequencies have a steep one's power."""

MOST_RESTS = 0.5
"""Part of the rests that have to be as quiet as the quietest for these alone to count."""

TOGETHER = 0.5
"""Part of what a band has more, or less, that the axes have in common where something shakes the phone."""

FLOOR = 0.02
"""Natural logarithm of power below which no two spectra of one sensor are known to be alike."""


@dataclass(frozen=True, slots=True, eq=False)
class Coloured:
    """A band (low, high) Hz of noise at rest, and its power over that of most of the spectrum.

    log_ratio: natural logarithm; pieces: (P,) the same piece by piece.
    """

    band: tuple[float, float]
    log_ratio: Measured
    pieces: Array

    def size(self) -> Measured:
        """Return how far it stands apart, on the scale of the population of sound phones."""
        return Measured(abs(self.log_ratio.value), self.log_ratio.error)

    def ratio(self) -> Measured:
        """Return how many times the power of most of the spectrum it has."""
        times = float(np.exp(self.log_ratio.value))
        return Measured(times, times * self.log_ratio.error)


@dataclass(frozen=True, slots=True, eq=False)
class _Flat:
    """Power (P, F, 3) of the quietest pieces before any low-pass, over each axis' usual one; f: (F,) Hz.

    averages: (P,) independent ones.
    """

    power: Array
    f: Array
    averages: Array

    def bands(self) -> list[slice]:
        """Return where bands lie: each wide enough that neither chance nor a line moves it far."""
        by_chance = SHARED * OF_MEDIAN**2 / (self.averages.sum() * 3.0 * CHANCE**2)
        fewest = max(int(np.ceil(by_chance)), FEWEST)
        out, k = [], 0
        while k + fewest <= self.f.size:
            end = max(k + fewest, int(np.searchsorted(self.f, self.f[k] * WIDTH)))
            out.append(slice(k, end))
            k = end
        return out


def coloured_noise(spectrum: Spectra) -> Coloured | None:
    """Return the band that stands apart most.

    None where rests or axes differ in it by more than chance, where it is a line, and where the noise falls
    only so near half the sample rate as it does behind the low-passes that parts come with.
    """
    seen = _flat(spectrum)
    bands = [] if seen is None else seen.bands()
    if seen is None or len(bands) < LEAST_BANDS:
        return None
    typical = seen.power.mean(axis=(0, 2))
    logs = np.log([np.median(typical[band]) for band in bands])
    logs -= np.median(logs)
    k = int(np.argmax(np.abs(logs)))
    beyond = logs * np.sign(logs[k]) > 0.5 * np.abs(logs[k])
    first, last = k, k + 1
    while first > 0 and beyond[first - 1]:
        first -= 1
    while last < logs.size and beyond[last]:
        last += 1
    rows = slice(bands[first].start, bands[last - 1].stop)
    if last == len(bands) and logs[k] < 0.0 and seen.f[rows.start] > BANDWIDTH_LIMIT * spectrum.rate:
        return None
    return None if _is_line(typical[rows], float(np.median(typical))) else _of_band(seen, rows)


def in_band(spectrum: Spectra, band: tuple[float, float]) -> Coloured | None:
    """Return what the noise of a spectrum has in a band, Hz.

    None where that is not even, or most of it is beyond the frequencies that are judged.
    """
    seen = _flat(spectrum)
    if seen is None:
        return None
    first = int(np.searchsorted(seen.f, band[0]))
    last = int(np.searchsorted(seen.f, band[1], side="right"))
    if last <= first or seen.f[last - 1] - seen.f[first] < 0.5 * (band[1] - band[0]):
        return None
    return _of_band(seen, slice(first, last))


def _flat(spectrum: Spectra) -> _Flat | None:
    """Return the noise of the quietest pieces; None where these are too few."""
    shape = spectrum.shape(spectrum.low_pass or spectrum.wide)
    used = spectrum.band & (shape > SEEN).all(axis=1)
    power = spectrum.power[:, used] / shape[None, used]
    own = quietest(spectrum.power[:, spectrum.band], spectrum.averages)
    # Rests are even where the quietest are chosen. Are these few, each may tremble: then all rests count.
    own = (own | (own.mean() < MOST_RESTS)) & (power > 0.0).all(axis=(1, 2))
    if own.sum() < LEAST_PIECES or used.sum() < LEAST_BANDS * FEWEST:
        return None
    level = np.median(power[own].mean(axis=0), axis=0)
    return _Flat(power[own] / level, spectrum.f[used], spectrum.averages[own])


def _of_band(seen: _Flat, rows: slice) -> Coloured | None:
    """Return a band's power over the usual one, by medians over frequencies, which no line moves far.

    None where it is not as even over pieces, and as alike on the axes, as chance leaves it.
    """
    mean = seen.power.mean(axis=2)
    value = float(_log_ratio(mean.mean(axis=0), rows, 0))
    pieces = _log_ratio(mean, rows, 1)
    if not _is_even(seen, rows, value, pieces):
        return None
    band = float(seen.f[rows.start]), float(seen.f[rows.stop - 1])
    return Coloured(band, Measured(value, mean_of(pieces, FLOOR).error), pieces)


def _log_ratio(power: Array, rows: slice, axis: int) -> Array:
    """Return the logarithm of the median power of some frequencies over that of all. axis: theirs."""
    return np.asarray(
        np.log(np.median(power.take(range(rows.start, rows.stop), axis), axis) / np.median(power, axis))
    )


def _is_even(seen: _Flat, rows: slice, value: float, pieces: Array) -> bool:
    """Whether a band's logarithms, `value` of all and (P,) of each piece, are alike over pieces and axes.

    The axes are held against each other over all pieces, and in each of them.
    """
    chance = OF_MEDIAN * float(np.sqrt(SHARED / (np.median(seen.averages) * (rows.stop - rows.start))))
    scatter = MAD_TO_SD * float(np.median(np.abs(pieces - np.median(pieces))))
    if scatter >= UNSTEADY * chance / np.sqrt(3.0) + FLOOR + UNEVEN * abs(value):
        return False
    by_axis, of_each = _log_ratio(seen.power.mean(axis=0), rows, 0), _log_ratio(seen.power, rows, 1)
    apart = MAD_TO_SD * float(np.median(np.abs(of_each - of_each.mean(axis=1, keepdims=True))))
    if apart >= UNSTEADY * chance + UNLIKE * abs(value):
        return False
    return bool(np.abs(by_axis - value).max() < 3.0 * chance / np.sqrt(len(pieces)) + UNLIKE * abs(value))


def moves_together(still: Quiet, spectrum: Spectra, found: Coloured) -> bool:
    """Whether the axes have most of what a band has more, or less, in common, as where something shakes them.

    In each rest and at each frequency by itself: a phone that is turned is shaken along other axes, and what
    it lies on may move one axis after the other. What the axes have in common at all frequencies alike is of
    the sensor, or is told by other names (`shared_noise`).
    """
    of_sums = sums_of_pairs(still)
    first, second = (spectrum.power[:, :, list(axes)] for axes in zip(*PAIRS, strict=True))
    product = np.maximum(first * second, np.finfo(np.float64).tiny)
    common = ((of_sums - first - second) ** 2 / (4.0 * product)).mean(axis=(0, 2))
    inside = spectrum.band & (spectrum.f >= found.band[0]) & (spectrum.f <= found.band[1])
    outside = spectrum.band & ~inside
    if not inside.any() or not outside.any():
        return False
    more, less = float(common[inside].mean()), float(common[outside].mean())
    fewest = len(of_sums) * len(PAIRS) * min(int(inside.sum()), int(outside.sum()))
    chance = 3.0 * float(common[spectrum.band].mean()) * float(np.sqrt(2.0 * SHARED / fewest))
    if found.log_ratio.value < 0.0:
        more, less = less, more
    part = TOGETHER * (1.0 - np.exp(-found.size().value))
    return bool(more - less > part**2 * (1.0 - less) + chance)


def _is_line(power: Array, usual: float) -> bool:
    """Whether most of what a band's power (F,) has over the usual one is in one line, twice as high."""
    excess = power - usual
    highest = np.convolve(excess, np.ones(LINE), "valid").max()
    return bool(highest > LINE * usual and highest > MOST * excess.sum())


def coloured_noise_finding(found: Coloured, sensor: str, sound: Usual, where: Where) -> Finding | None:
    """State a band that no sound phone has; it has no name, for many a cause may have it."""
    sign = 1.0 if found.log_ratio.value >= 0.0 else -1.0
    seen = of_measured(found.size(), sound, of_means(sign * found.pieces, np.array([sound.middle])))
    (low, high), ratio = found.band, found.ratio()
    say = (
        f"The {NAME[sensor]}'s noise at rest is not white: from {low:.3g} to {high:.3g} Hz it has"
        f" {float(f'{ratio.value:.3g}'):g} times the power of most other frequencies, on all axes and in all"
        " rests alike."
    )
    parameters = {"ratio": ratio.parameter("1")}
    own = Where(where.t_start, where.t_end, found.band, DRIVER)
    return direct_finding("unknown", sensor, [0, 1, 2], own, parameters, statement=say, seen=seen)


def is_end_of_wander(found: Finding, spectrum: Spectra) -> bool:
    """Whether a band has more and reaches to the lowest frequency judged, as a bias that wanders much has."""
    more = found.where.driver == DRIVER and float(np.asarray(found.parameters["ratio"].value)) > 1.0
    return more and found.where.band_hz[0] <= float(spectrum.f[spectrum.band][0])
