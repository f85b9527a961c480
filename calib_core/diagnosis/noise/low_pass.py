"""What the spectrum at rest says: the quiet samples themselves, their densities, and a low-pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import blocks
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.measurement import (
    NORMAL_95,
    DirectEvidence,
    HeldOut,
    Measured,
    direct_finding,
    of_measured,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Alternative, Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.noise.filter_kinds import kinds_of
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.maths.sines import without_vibrations
from stillcal.calib_core.maths.welch import densities
from stillcal.calib_core.streams.samples import Samples

SEGMENT = 256
SHORTEST = 64
LOWEST = 0.02
CUTOFFS, NEAR = 240, 9
"""Cutoffs that are tried all over the band, and within the interval of one found elsewhere."""

USED_RANGE = 3.5
LEAST_PIECES = 3
CLEAN = 0.02
MODEL = 0.02
"""Relative error of a cutoff for not knowing how the filter was made."""

ABOVE_STEPS = 3.0
LEAST_SHAPE = 8
"""Times the noise of the steps that power has, and numbers of a spectrum that have it, to tell a shape."""

FLATTENED = 1.0
"""ln of power over a filter's, at frequencies that it suppresses: what is more is no noise of that filter."""

FADED = 1e-6
"""Part of the power below which nothing is left of it: windows spread more into what a filter suppresses."""

AS_LOUD = float(np.log(4.0))
"""ln of power, before any filter, by which two axes of a sound phone differ at most: twice the density."""

OF_MEDIAN = 1.35
"""Variance of the median of three numbers, times three, over that of one."""

SHARED = 1.9
"""Numbers of a spectrum under overlapping Hann windows for each independent one."""

UNSTEADY = 2.0
"""Times the scatter that chance makes of a rest's power, beyond which it differs from the quietest ones."""

QUIETEST = 0.1
"""Part of the rests that has no more than the sensor's own noise, and that may be louder."""

ABOUT, OUTSTANDING = 8, 4.0
"""Half of how many frequencies one is held against, and standard errors of a logarithm it stands out by."""

FEW_PEAKS = 0.2
"""Part of a band that may stand out of it."""

LOBE = 2.0
"""Frequencies of a spectrum on either side of a line that a Hann window spreads it over."""


@dataclass(frozen=True, slots=True, eq=False)
class Quiet:
    """Samples inside rests: pieces (n_i, 3) free of their means; rate: Hz; t_start of each piece, s.

    lines: Hz, the vibrations that are taken off.
    """

    pieces: tuple[Array, ...]
    t_start: tuple[float, ...]
    rate: float
    lines: tuple[float, ...] = ()


def quiet(samples: Samples, bins: Bins, lines: Sequence[float] = ()) -> Quiet:
    """Cut the bins' samples out of a stream. lines: Hz, of vibrations, which are fitted and taken off.

    A vibration is no noise: it is alike on all axes, regular and of one size.
    """
    first = np.searchsorted(samples.t, bins.t - bins.duration / 2)
    last = np.searchsorted(samples.t, bins.t + bins.duration / 2)
    period = sample_period(samples.t)
    keep = _pieces(first.tolist(), last.tolist(), bins.rest.tolist())
    rests = [(samples.xyz[a:b] - samples.xyz[a:b].mean(axis=0), samples.t[a:b]) for a, b in keep]
    pieces = tuple(without_vibrations(xyz, t, lines) for xyz, t in rests)
    starts = tuple(float(samples.t[a]) for a, _ in keep)
    return Quiet(pieces, starts, 1.0 / max(period, 1e-9), tuple(lines))


def _pieces(first: Sequence[int], last: Sequence[int], rest: Sequence[int]) -> list[tuple[int, int]]:
    """Return [first, last) of the samples of bins, and of neighbours in one rest where each has too few."""
    out: list[tuple[int, int]] = []
    start, end, of = 0, 0, -1
    for a, b, own in zip(first, last, rest, strict=True):
        start = start if own == of and a == end and b - a < SHORTEST else a
        end, of = b, own
        if end - start >= SHORTEST:
            out.append((start, end))
            start = end
    return out


@dataclass(frozen=True, slots=True, eq=False)
class LowPass:
    """A low-pass: cutoff Hz, its shape (F,) of power at the spectra's frequencies, how far flat is worse.

    rounded: part of the power at low frequency that is the steps' own. late: s, how much it delays slow
    motion, by all kinds of filters of this order that fit as well. axes: those that it filters.
    """

    cutoff: Measured
    shape: Array
    gain: float
    order: int
    rounded: float
    late: Measured
    axes: tuple[int, ...] = (0, 1, 2)

    @property
    def on_all(self) -> bool:
        """Whether it filters all axes."""
        return len(self.axes) == len(AXES)

    @property
    def order_known(self) -> bool:
        """Whether its order can be told: rounding of noise as fine as the steps bends spectra, too."""
        return self.rounded <= MODEL


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """f: (F,) Hz; power: (pieces, F, 3) unit^2/Hz; averages: (pieces,) independent ones; band: (F,) judged.

    t: (pieces + 1,) s, when each began and the last ended. low_pass: what shapes it, None where it is flat.
    wide: one that is no finding, for parts come with such (`BANDWIDTH_LIMIT`); it delays motion all the same.
    """

    t: Array
    f: Array
    power: Array
    averages: Array
    band: NDArray[np.bool_]
    rate: float
    low_pass: LowPass | None
    wide: LowPass | None = None

    def shape(self, found: LowPass | None = None) -> Array:
        """Return the power (F, 3) that white noise would have, 1 at low frequency.

        found: the low-pass that shapes it, in place of its own.
        """
        out, behind = np.ones((self.f.size, len(AXES))), found or self.low_pass
        if behind is not None:
            out[:, behind.axes] = behind.shape[:, None]
        return out


def may_be_behind(spectrum: Spectra, found: LowPass, axes: Sequence[int]) -> bool:
    """Whether noise behind a low-pass, found elsewhere, fits some axes as well as white noise does."""
    band = spectrum.band
    typical = np.median(spectrum.power[quietest(spectrum.power[:, band], spectrum.averages)], axis=0)
    of_all = float(spectrum.averages.sum())
    band = band & ~_peaks(typical, band, of_all)
    power, _ = _of_most_axes(typical[:, list(axes)], band, of_all)
    logs = np.log(np.maximum(power[band], np.finfo(np.float64).tiny))
    reach = NORMAL_95 * found.cutoff.error
    cutoffs = found.cutoff.value + np.linspace(-reach, reach, NEAR)
    kinds = [kind for kind in kinds_of(spectrum.f, cutoffs, spectrum.rate) if kind.order == found.order]
    behind = min(float((logs - np.log(kind.shapes[:, band])).var(axis=1).min()) for kind in kinds)
    white = float(logs.var())
    return logs.size * (behind - white) / max(white, 1e-12) < 4.0 * SHARED


def _segment(still: Quiet) -> int:
    """Return how many samples a Welch segment has: most pieces hold one, the few shorter are left out."""
    sizes = [len(p) for p in still.pieces]
    return int(np.clip(np.quantile(sizes, 0.1), SHORTEST, SEGMENT))


def spectra(still: Quiet, mixed: Array | None = None) -> tuple[Array, Array]:
    """Return frequencies (F,) Hz and one-sided densities (pieces, F, k) of the pieces long enough.

    One at least. mixed: (3, k), of what sums of the axes; None for the axes themselves.
    """
    length = _segment(still)
    enough = [p if mixed is None else p @ mixed for p in still.pieces if len(p) >= length]
    power = densities(enough, still.rate, length)
    return np.asarray(np.fft.rfftfreq(length, 1.0 / still.rate), dtype=np.float64), power


def judged(still: Quiet, floor: float = 0.0) -> Spectra | None:
    """Return the spectra with what is needed to judge them; None where there are too few pieces.

    floor: density^2 of the steps' noise.
    """
    if len(still.pieces) < LEAST_PIECES:
        return None
    f, power = spectra(still)
    length = _segment(still)
    sizes = np.array([len(p) for p in still.pieces if len(p) >= length])
    t = [t for t, p in zip(still.t_start, still.pieces, strict=True) if len(p) >= length]
    times = np.array([*t, t[-1] + sizes[-1] / still.rate])
    lowest = min(max(LOWEST * still.rate, 1.0), 0.1 * still.rate)
    band = (f > lowest) & (f < 0.48 * still.rate)
    for line in still.lines:
        band &= np.abs(f - line) >= LOBE * f[1]
    # Hann windows that overlap by half leave 0.95 independent averages a segment (Welch 1967).
    averages = 0.95 * np.maximum(2 * sizes // length - 1, 1)

    def fitted(pieces: NDArray[np.bool_]) -> LowPass | None:
        typical, noise = np.median(power[pieces], axis=0), (still.rate, floor)
        of_all = float(averages[pieces].sum())
        clear = band & ~_peaks(typical, band, of_all)
        return _of_some_axes(f, typical, clear, noise, of_all) or _low_pass(f, typical, clear, noise, of_all)

    own = quietest(power[:, band], averages)
    low_pass = fitted(own)
    # Of a few quiet rests each may tremble: there all rests together must show it as well.
    few = own.sum() < 2 * LEAST_PIECES and not own.all()
    if few and low_pass is not None and fitted(np.ones_like(own)) is None:
        low_pass = None
    wide = None
    if low_pass is not None and low_pass.cutoff.value > thresholds.BANDWIDTH_LIMIT * still.rate:
        low_pass, wide = None, low_pass
    return Spectra(times, f, power, averages, band, still.rate, low_pass, wide)


def _peaks(typical: Array, band: NDArray[np.bool_], averages: float) -> NDArray[np.bool_]:
    """Return which frequencies (F,) stand out of those next to them, as those of an engine or of a hand do.

    They are no line, and no filter makes them: beside them the filter can be fitted, where they are a small
    part of the band. typical: (F, k); averages: of so many independent spectra.
    """
    at = np.flatnonzero(band)
    if at.size < 4 * ABOUT:
        return np.zeros_like(band)
    logs = np.log(np.maximum(typical[at], np.finfo(np.float64).tiny)).mean(axis=1)
    next_to = np.median(np.lib.stride_tricks.sliding_window_view(logs, 2 * ABOUT + 1), axis=1)
    nearest = np.clip(np.arange(logs.size) - ABOUT, 0, next_to.size - 1)
    above = logs - next_to[nearest] > OUTSTANDING * np.sqrt(_by_chance(averages))
    out = np.zeros(band.size, dtype=np.bool_)
    for k in at[above]:
        out[max(k - int(LOBE), 0) : k + int(LOBE) + 1] = True
    return out if (out & band).sum() <= FEW_PEAKS * at.size else np.zeros_like(out)


def quietest(power: Array, averages: Array) -> NDArray[np.bool_]:
    """Return which pieces (n,) show the sensor's own noise: those that only chance parts from the quietest.

    A filter shapes every rest alike. What a hand adds to some of them falls with frequency, too, and is in
    the quietest ones least. power: (n, F, 3); averages: (n,). Pieces in which coarse values hold still count
    as loud.
    """
    level = power.mean(axis=(1, 2))
    # A spectrum that falls has its power in few frequencies.
    typical = power.mean(axis=(0, 2))
    many = 3.0 * max(float(typical.sum() ** 2 / np.maximum((typical**2).sum(), 1e-300)), 1.0)
    chance = float(np.sqrt(SHARED / (np.median(averages) * many)))
    near = UNSTEADY * chance + 0.02
    level = np.where((power > 0.0).all(axis=(1, 2)), level, np.inf)
    least = float(np.quantile(level, QUIETEST, method="lower")) * (1.0 + 1.28 * chance)
    fewest = np.sort(level)[min(LEAST_PIECES, level.size) - 1]
    own = np.asarray(level <= max(least * (1.0 + near), float(fewest)))
    # A tenth that is louder moves no median far.
    return own if own.mean() < 1.0 - QUIETEST else np.ones_like(own)


def _of_most_axes(typical: Array, band: NDArray[np.bool_], averages: float) -> tuple[Array, float]:
    """Return the power (F,) of all axes (F, 3) together, and its variance over that of a mean of three.

    Where they differ by more than chance, it is that of the two most alike, as parts of their medians in the
    band: what shakes, or is noise behind the filter, on one axis alone is none of its shape. Where these
    differ too, it is the median of all; beside an axis that has more it is the larger of the others. Fewer
    than three (F, k) are taken together.
    """
    if typical.shape[1] < len(AXES):
        return np.asarray(typical.mean(axis=1)), len(AXES) / typical.shape[1]
    level = np.maximum(np.median(typical[band], axis=0), np.finfo(np.float64).tiny)
    parts = typical / level
    logs = np.log(np.maximum(parts[band], np.finfo(np.float64).tiny))
    by_chance = _by_chance(averages)
    if _apart(logs) < by_chance:
        return np.asarray(typical.mean(axis=1)), 1.0
    alike = min(([0, 1], [0, 2], [1, 2]), key=lambda two: _apart(logs[:, two]))
    if _apart(logs[:, alike]) < by_chance:
        return np.asarray(level.mean() * parts[:, alike].mean(axis=1)), 3.0 / 2.0
    return np.asarray(level.mean() * np.median(parts, axis=1)), OF_MEDIAN


def _of_some_axes(
    f: Array, typical: Array, band: NDArray[np.bool_], noise: tuple[float, float], averages: float
) -> LowPass | None:
    """Return the low-pass of one axis or two beside noise as white as chance leaves it on the rest.

    None where the axes are alike, or one is neither. White noise as loud as the others' before the filter is
    what passes none; louder noise may be added behind one. typical: (F, 3); the others as for `_low_pass`.
    """
    logs = np.log(np.maximum(typical, np.finfo(np.float64).tiny))
    by_chance = _by_chance(averages)
    if _apart(logs[band] - np.median(logs[band], axis=0)) < by_chance:
        return None
    # Parts come with a filter near half the rate on all axes.
    below = band & (f < thresholds.BANDWIDTH_LIMIT * noise[0])
    white = [a for a in range(len(AXES)) if logs[below, a].var() < by_chance]
    axes = [a for a in range(len(AXES)) if a not in white]
    found = None if not white or not axes else _low_pass(f, typical[:, axes], band, noise, averages)
    if found is None:
        return None
    level = np.median(logs[band][:, white])
    before = np.median(logs[band][:, axes] - np.log(found.shape[band])[:, None], axis=0)
    return replace(found, axes=tuple(axes)) if (np.abs(before - level) < AS_LOUD).all() else None


def _by_chance(averages: float) -> float:
    """Return up to which variance logarithms of power scatter by chance, of so many independent spectra.

    Their median's is pi/2 over their number; so much again is allowed.
    """
    return CLEAN + 2.0 * np.pi / 2.0 / averages


def _apart(logs: Array) -> float:
    """Return the variance of log power (F, k) between axes."""
    return float(logs.var(axis=1, ddof=1).mean())


def _low_pass(
    f: Array, typical: Array, band: NDArray[np.bool_], noise: tuple[float, float], averages: float
) -> LowPass | None:
    """Fit A / (1 + (f / fc)^2n) + floor to the typical log spectrum (F, k); None where flat does as well.

    noise: rate Hz, floor of the steps. Only what is above -15 dB counts. A spectrum that no filter fits
    cleanly is of something else, and so is one that falls all over the band: a bias that walks has such.
    So is one that is level again beyond what falls: the sensor's own noise is not filtered there, and what
    falls is motion, as of a vehicle.
    """
    rate, floor = noise
    power, scatter = _of_most_axes(typical, band, averages)
    if np.median(power[band]) <= 0.0:
        return None
    logs = np.log(np.maximum(power, np.finfo(np.float64).tiny))
    used = band & (logs > np.quantile(logs[band], 0.9) - USED_RANGE)
    # Of steps as coarse as what a filter leaves the level is known, and that their noise is not white.
    above = used & (power > ABOVE_STEPS * floor)
    used = above if above.sum() > LEAST_SHAPE else used
    seen = logs[used]
    cutoffs = np.geomspace(0.02 * rate, 0.49 * rate, CUTOFFS)
    fits: list[_Fit] = []
    for kind in kinds_of(f, cutoffs, rate):
        bent = kind.shapes[:, used]
        level = np.median(np.maximum(power[used] - floor, 0.2 * power[used]) / bent, axis=1)
        misfit = (seen - np.log((level[:, None] * bent + floor) / (level[:, None] + floor))).var(axis=1)
        k = int(np.argmin(misfit))
        whole = float(level[k]) + floor
        shape = (float(level[k]) * kind.shapes[k] + floor) / whole
        fits.append(_Fit(kind.order, k, misfit, shape, float(kind.late[k]), floor / whole, kind.common))
    least = min(fit.least for fit in fits)

    def as_good_as_best(fit: _Fit) -> bool:
        return bool(seen.size * (fit.least - least) / least < 4.0 * SHARED)

    common = [fit for fit in fits if fit.common]
    of_kind = common if any(map(as_good_as_best, common)) else [fit for fit in fits if not fit.common]
    best = min(of_kind, key=lambda fit: fit.least)
    least, k = best.least, best.k
    gain = seen.size * (float(seen.var()) - least) / max(least, 1e-12)
    clean = least < _by_chance(3.0 * averages / scatter)
    inside = f[band][0] < cutoffs[k] < cutoffs[-1]
    if not inside or gain < thresholds.BANDWIDTH_GAIN or not clean:
        return None
    as_good = [fit for fit in of_kind if as_good_as_best(fit)]
    if _level_beyond(logs, np.max([fit.shape for fit in as_good], axis=0), band, used):
        return None
    near = np.concatenate([cutoffs[seen.size * (fit.misfit - least) / least < 4.0] for fit in of_kind])
    # What steps do to noise as fine as they are is no white noise: as much as it is of the power is unsure.
    unsure = (MODEL + best.rounded) * float(cutoffs[k])
    spread = max(float(np.sqrt(SHARED)) * float(np.ptp(near)) / 4.0, unsure)
    alike = [fit.late for fit in as_good if fit.order == best.order]
    late = Measured(best.late, float(np.ptp(alike)) / 2.0)
    cutoff = Measured(_between(cutoffs, best.misfit, k), spread)
    return LowPass(cutoff, best.shape, gain, best.order, best.rounded, late)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """The best low-pass of one kind: its place k in the grid, the misfits (C,) of all, what it does."""

    order: int
    k: int
    misfit: Array
    shape: Array
    late: float
    rounded: float
    common: bool

    @property
    def least(self) -> float:
        return float(self.misfit[self.k])


def _level_beyond(logs: Array, shape: Array, band: NDArray[np.bool_], used: NDArray[np.bool_]) -> bool:
    """Whether log powers (F,) at the highest frequencies are level again, above a filter's shape (F,).

    used: where the filter was fitted.
    """
    ratio = logs - np.log(np.maximum(shape, FADED))
    beyond = np.flatnonzero(band)[np.flatnonzero(band) > np.flatnonzero(used)[-1]]
    highest = ratio[beyond[beyond.size // 2 :]]
    return bool(highest.size and np.median(highest) > np.median(ratio[used]) + FLATTENED)


def _between(cutoffs: Array, misfit: Array, k: int) -> float:
    """Return the least of a curve between the places of a logarithmic grid, by a parabola."""
    k = int(np.clip(k, 1, cutoffs.size - 2))
    left, middle, right = misfit[k - 1 : k + 2]
    bend = left - 2.0 * middle + right
    shift = 0.0 if bend <= 0.0 else float(np.clip(0.5 * (left - right) / bend, -1.0, 1.0))
    return float(cutoffs[k] * (cutoffs[k + 1] / cutoffs[k]) ** shift)


def relative_cutoff(spectrum: Spectra) -> Measured:
    """Return the natural logarithm of the cutoff over the sample rate; of half the rate where it is flat."""
    found = spectrum.low_pass
    if found is None:
        return Measured(float(np.log(0.5)), MODEL)
    return Measured(
        float(np.log(found.cutoff.value / spectrum.rate)), found.cutoff.error / found.cutoff.value
    )


def population(spectrum: Spectra) -> str:
    """Return the name of the population of sound phones that a low-pass is held against."""
    found = spectrum.low_pass
    return "bandwidth" if found is None or found.on_all else "bandwidth_of_some_axes"


def bandwidth(spectrum: Spectra, sensor: str, usual: Usual, where: Where) -> Finding | None:
    """State a low-pass, with the spectra of rests left out. usual: of the log of cutoff over rate."""
    found = spectrum.low_pass
    if found is None:
        return None
    seen = of_measured(relative_cutoff(spectrum), usual, _left_out(spectrum, found))
    return low_pass_finding(spectrum, sensor, where, seen)


def low_pass_finding(
    spectrum: Spectra,
    sensor: str,
    where: Where,
    seen: DirectEvidence,
    alternatives: Sequence[Alternative] = (),
) -> Finding | None:
    """State the low-pass of a spectrum that has one; None where the evidence does not carry it."""
    found = spectrum.low_pass
    assert found is not None, "a spectrum that is not flat"
    on = "" if found.on_all else f" on {' and '.join(AXES[a] for a in found.axes)} alone"
    say = f"The {NAME[sensor]}'s output is low-pass filtered at {found.cutoff.value:.2g} Hz{on}."
    parameters = {"cutoff": found.cutoff.parameter("Hz")}
    return direct_finding(
        "bandwidth",
        sensor,
        found.axes,
        where,
        parameters,
        statement=say,
        seen=seen,
        alternatives=alternatives,
    )


def _left_out(spectrum: Spectra, found: LowPass) -> HeldOut:
    """Predict spectra of rests by the filter and by flat noise.

    Each of the others' level (Whittle's likelihood). Rests in which coarse values hold still on an axis have
    no spectrum.
    """
    power = spectrum.power[:, spectrum.band]
    alive = (power > 0.0).all(axis=(1, 2))
    if alive.sum() < LEAST_PIECES:
        return HeldOut(0.0, 0.0, 0.0)
    power, averages = power[alive], spectrum.averages[alive]
    shape = spectrum.shape(found)[None, spectrum.band]
    fold, gain = blocks(len(power)), 0.0
    before, after = [], []
    for k in np.unique(fold):
        train, test = power[fold != k], power[fold == k]
        weight = averages[fold == k][:, None, None] / SHARED
        flat = np.broadcast_to(train.mean(axis=(0, 1), keepdims=True), (1, *power.shape[1:]))
        bent = (train / shape).mean(axis=(0, 1), keepdims=True) * shape
        gain += float((weight * (np.log(flat / bent) + test / flat - test / bent)).sum())
        mean = np.log(test.mean(axis=0))
        before.append(rms(mean - np.log(flat[0])))
        after.append(rms(mean - np.log(bent[0])))
    return HeldOut(gain, rms(np.array(before)), rms(np.array(after)))
