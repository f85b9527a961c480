"""What single samples inside rests say: noise density, its equality, tails, bandwidth, and lines."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.bins import Bins, Index
from stillcal.calib_core.misfit.quick import SIGNIFICANT, Measured, direct_finding, mean_of
from stillcal.calib_core.misfit.records import Claims, Finding, Parameter, Where
from stillcal.calib_core.misfit.values import UNIT
from stillcal.calib_core.samples import Array, Samples

SEGMENT = 256
LOWEST = 0.02
CUTOFFS = 60
FLOORS = (0.0, 0.01, 0.03, 0.1, 0.2, 0.4)
LINE_SECONDS = 20.0
LEAST_LINE_HZ = 4.0
LINE_P = 1e-7
LEAST_STRETCHES = 5
STEADY = 0.1
STACK_ALLOWANCE = 1.3
LOUDEST = 6.0
FLANK = 0.15
COARSE = 0.5
MOST_WIDE = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Quiet:
    """Samples inside rests: pieces (n_i, 3) free of their means; rate: Hz; t_start of each piece, s."""

    pieces: tuple[Array, ...]
    t_start: tuple[float, ...]
    rate: float


def quiet(samples: Samples, bins: Bins) -> Quiet:
    """Cut the bins' samples out of a stream."""
    first = np.searchsorted(samples.t, bins.t - bins.duration / 2)
    last = np.searchsorted(samples.t, bins.t + bins.duration / 2)
    period = float(np.median(np.diff(samples.t)))
    keep = [(int(a), int(b)) for a, b in zip(first, last, strict=True) if b - a >= 64]
    pieces = tuple(samples.xyz[a:b] - samples.xyz[a:b].mean(axis=0) for a, b in keep)
    return Quiet(pieces, tuple(float(samples.t[a]) for a, _ in keep), 1.0 / period)


def spectra(still: Quiet) -> tuple[Array, Array]:
    """Return frequencies (F,) Hz and one-sided densities (pieces, F, 3) by Welch's method."""
    from scipy.signal import welch  # noqa: PLC0415 - the daemon stays light

    length = int(min([SEGMENT, *(len(p) for p in still.pieces)]))
    out = [welch(p, fs=still.rate, nperseg=length, axis=0)[1] for p in still.pieces]
    return np.asarray(np.fft.rfftfreq(length, 1.0 / still.rate), dtype=np.float64), np.array(out)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseLevels:
    """density: (pieces, 3) unit/sqrt(Hz) below the cutoff; sd: (3,) of single samples; cutoff: Hz or None."""

    density: Array
    sd: Array
    cutoff: Measured | None


def noise_levels(still: Quiet) -> NoiseLevels:
    """Measure density and bandwidth; lines and slow wander are kept out by medians and a lowest frequency."""
    f, power = spectra(still)
    band = (f > max(LOWEST * still.rate, 1.0)) & (f < 0.48 * still.rate)
    typical = np.median(power, axis=0)
    whole = np.log(typical / typical[band].mean(axis=0)).mean(axis=1)
    cutoff = _cutoff(f[band], whole[band], still.rate)
    top = 0.4 * still.rate if cutoff is None else 0.5 * cutoff.value
    flat = band & (f < max(top, f[band][3]))
    density = np.sqrt(np.median(power[:, flat], axis=1) / _median_bias(len(still.pieces[0]), len(f)))
    return NoiseLevels(density, np.sqrt(np.median([p.var(axis=0) for p in still.pieces], axis=0)), cutoff)


def _median_bias(samples: int, frequencies: int) -> float:
    """Median over mean of a Welch estimate with about `averages` independent segments (chi-squared)."""
    averages = max(1.0, samples / frequencies / 1.9)
    return float((1.0 - 1.0 / (9.0 * averages)) ** 3)


def _cutoff(f: Array, log_power: Array, rate: float) -> Measured | None:
    """Fit 1 / (1 + (f / fc)^2n), n = 1, 2, to the typical log spectrum; None where flat does as well.

    Filters are tried as analogue ones and as by the bilinear transform, whose frequency is tan(pi f / rate).
    The steps of the values add a floor. Only what is above -15 dB counts.
    """
    used = log_power > np.quantile(log_power, 0.9) - 3.5
    f, log_power = f[used], log_power[used]
    grid = np.geomspace(f[2], 0.49 * rate, CUTOFFS)
    misfits = []
    warped = (f, grid), (np.tan(np.pi * f / rate), np.tan(np.pi * grid / rate))
    for (at, cutoff), order, floor in product(warped, (1, 2), FLOORS):
        model = np.log(1.0 / (1.0 + (at[None, :] / cutoff[:, None]) ** (2 * order)) + floor)
        residual = log_power - model
        misfits.append(((residual - residual.mean(axis=1, keepdims=True)) ** 2).mean(axis=1))
    misfit = np.min(misfits, axis=0)
    best, flat = int(np.argmin(misfit)), float(log_power.var())
    gain = f.size * (flat - misfit[best]) / max(float(misfit[best]), 1e-12)
    if grid[best] > thresholds.BANDWIDTH_LIMIT * rate or gain < thresholds.BANDWIDTH_GAIN:
        return None
    near = np.flatnonzero(f.size * (misfit - misfit[best]) / misfit[best] < 4.0)
    spread = (grid[min(near[-1] + 1, CUTOFFS - 1)] - grid[max(near[0] - 1, 0)]) / 4.0
    return Measured(float(grid[best]), float(spread))


def noise_findings(
    still: Quiet, levels: NoiseLevels, sensor: str, claims: Claims, where: Where, *, step: float = 0.0
) -> list[Finding]:
    """Return what densities, tails and bandwidth show. step: of the values; coarse ones have no tails."""
    tails = _tails(still, sensor, where) if step < COARSE * float(levels.sd.min()) else None
    found = [_unequal(levels, sensor, where), tails]
    found.append(_level(levels, sensor, claims, still.rate, where) if tails is None else None)
    if levels.cutoff is not None:
        say = f"The {sensor} sensor's output is low-passed at {levels.cutoff.value:.2g} Hz."
        parameter = {"cutoff": levels.cutoff.parameter("Hz")}
        found.append(
            direct_finding("bandwidth", sensor, [0, 1, 2], where, parameter, statement=say, sigmas=8.0)
        )
    return [f for f in found if f is not None]


def _claimed(sensor: str, claims: Claims, rate: float) -> float | None:
    """Return the declared density with the declared step's own noise in it, unit/sqrt(Hz)."""
    density = claims.accel_noise_density if sensor == "accel" else claims.gyro_noise_density
    lsb = (claims.accel_lsb if sensor == "accel" else claims.gyro_lsb) or 0.0
    return None if density is None else float(np.hypot(density, lsb / np.sqrt(6.0 * rate)))


def _level(levels: NoiseLevels, sensor: str, claims: Claims, rate: float, where: Where) -> Finding | None:
    claim = _claimed(sensor, claims, rate)
    if claim is None:
        return None
    ratio = mean_of(np.median(levels.density, axis=1) / claim, 2e-3)
    tolerance = thresholds.LEVEL_TOLERANCE
    sigmas = ratio.beyond(1.0 / (1.0 + tolerance), 1.0 + tolerance)
    if sigmas < SIGNIFICANT:
        return None
    say = f"The {sensor} sensor's white noise is {ratio.value:.2f} times what is declared."
    return direct_finding(
        "noise_level", sensor, [0, 1, 2], where, {"ratio": ratio.parameter("1")}, statement=say, sigmas=sigmas
    )


def _unequal(levels: NoiseLevels, sensor: str, where: Where) -> Finding | None:
    """Find axes whose density differs from the middle axis of the same piece."""
    relative = levels.density / np.median(levels.density, axis=1, keepdims=True)
    ratios = [mean_of(relative[:, a], 2e-3) for a in range(3)]
    tolerance = thresholds.LEVEL_TOLERANCE
    sigmas = [r.beyond(1.0 / (1.0 + tolerance), 1.0 + tolerance) for r in ratios]
    axes = [a for a in range(3) if sigmas[a] >= SIGNIFICANT]
    if not axes:
        return None
    value, error = [r.value for r in ratios], [r.error for r in ratios]
    ci = [[v - 1.96 * e, v + 1.96 * e] for v, e in zip(value, error, strict=True)]
    text = ", ".join(f"{v:.2f}" for v in value)
    say = f"The {sensor} sensor's white noise is not alike on its axes: {text} of the middle one."
    parameter = {"ratio": Parameter(value, ci, "1")}
    return direct_finding(
        "noise_unequal_axes", sensor, axes, where, parameter, statement=say, sigmas=max(sigmas)
    )


def _tails(still: Quiet, sensor: str, where: Where) -> Finding | None:
    """Find single samples that fall too far out, by the excess kurtosis of each piece."""
    scaled = [_standardised(p) for p in still.pieces]
    kurtosis = mean_of(np.array([float(np.mean(z**4) / np.mean(z**2) ** 2 - 3.0) for z in scaled]), 1e-3)
    sigmas = kurtosis.beyond(-np.inf, thresholds.KURTOSIS_TOLERANCE)
    everything = np.concatenate(scaled)
    if sigmas < SIGNIFICANT or _clustered(everything):
        return None
    ratio, fraction = contaminated(everything.ravel())
    if fraction > MOST_WIDE:
        return None
    error = ratio.error
    say = f"{fraction:.1%} of the {sensor} sensor's samples scatter {ratio.value:.1f} times wider."
    parameter = {
        "ratio": Measured(ratio.value, error).parameter("1"),
        "fraction": Parameter(fraction, [0.7 * fraction, 1.3 * fraction], "1"),
        "excess_kurtosis": kurtosis.parameter("1"),
    }
    return direct_finding(
        "noise_heavy_tailed", sensor, [0, 1, 2], where, parameter, statement=say, sigmas=sigmas
    )


def _standardised(piece: Array) -> Array:
    """Return a piece free of its slow course (a cubic in time), in units of its own spread."""
    x = np.linspace(-1.0, 1.0, len(piece))
    course = np.polynomial.legendre.legvander(x, 3)
    fast = piece - course @ np.linalg.lstsq(course, piece, rcond=None)[0]
    return np.asarray(fast / np.maximum(fast.std(axis=0), 1e-300))


def _clustered(z: Array) -> bool:
    """Whether far samples come with far samples on other axes: a knock, not noise of the sensor."""
    far = np.abs(z) > 4.0
    if not far.any():
        return False
    together = (far.sum(axis=1) > 1).sum() / max((far.any(axis=1)).sum(), 1)
    return bool(together > 0.3)


def contaminated(z: Array, steps: int = 60) -> tuple[Measured, float]:
    """Fit (1-f) N(0, s^2) + f N(0, (r s)^2) to values (n,) by expectation maximisation; return r and f."""
    s2, r2, f = 0.7, 16.0, 0.02
    for _ in range(steps):
        wide = f * np.exp(-0.5 * z**2 / (r2 * s2)) / np.sqrt(r2)
        share = wide / (wide + (1.0 - f) * np.exp(-0.5 * z**2 / s2) + 1e-300)
        f = float(np.clip(share.mean(), 1e-5, 0.5))
        s2 = float(((1.0 - share) * z**2).sum() / (1.0 - share).sum())
        r2 = max(float((share * z**2).sum() / share.sum() / s2), 1.0)
    error = float(np.sqrt(r2) * np.hypot(0.03, np.sqrt(2.0 / max(f * z.size, 1.0))))
    return Measured(float(np.sqrt(r2)), error), f


def tone(samples: Samples, sensor: str) -> Finding | None:
    """Find a line in the spectrum of steady stretches, all along the recording or for a while.

    A line stands in the same place in several stretches of `LINE_SECONDS` and above the median of its own
    neighbourhood, which a hand's tremor, typing or a road do not.
    """
    rate = 1.0 / float(np.median(np.diff(samples.t)))
    length = int(LINE_SECONDS * rate)
    count = len(samples) // length
    blocks = samples.xyz[: count * length].reshape(count, length, 3)
    steady = _steady(blocks, round(rate)) if count else np.empty(0, dtype=int)
    if steady.size < 3:
        return None
    f, power, ratio = _line_ratios(blocks[steady], rate)
    high = np.flatnonzero((f > LEAST_LINE_HZ) & (f < 0.49 * rate))
    best = ratio[:, high].max(axis=2)
    threshold = float(np.log(best.size * 3 / LINE_P))
    near = np.maximum(best, np.maximum(np.roll(best, 1, axis=1), np.roll(best, -1, axis=1)))
    hits = (near > threshold).sum(axis=0)
    weak = _stacked(ratio[:, high])
    if hits.max() < LEAST_STRETCHES and weak is None:
        return None
    k = (
        int(np.argmax(hits + best.sum(axis=0) / best.sum()))
        if weak is None or hits.max() >= LEAST_STRETCHES
        else weak
    )
    rows = near[:, k] > threshold if hits[k] >= LEAST_STRETCHES else np.ones(steady.size, dtype=bool)
    if not _narrow(power[rows][:, max(high[k] - 20, 0) : high[k] + 21].sum(axis=(0, 2))):
        return None
    line = power[rows][:, high[k] - 3 : high[k] + 4]
    return _tone_finding(
        samples, sensor, float(f[1]), line, middle=int(high[k]), rows=steady[rows], length=length
    )


def _narrow(profile: Array) -> bool:
    """Whether the power (41,) about a line falls off as a Hann window's own does, within three bins."""
    middle = profile.size // 2
    away = np.abs(np.arange(profile.size) - middle)
    floor = float(np.median(profile[away > 12]))
    flank = float(profile[(away >= 4) & (away <= 6)].mean()) - floor
    return flank < FLANK * (float(profile[away <= 1].mean()) - floor)


def _steady(blocks: Array, second: int) -> Index:
    """Return the blocks whose means over a second stay where they are: rests, shaken or not."""
    count, length = len(blocks), blocks.shape[1] // second * second
    means = blocks[:, :length].reshape(count, -1, second, 3).mean(axis=2)
    return np.flatnonzero(np.ptp(means, axis=1).max(axis=1) < STEADY).astype(np.int64)


def _stacked(ratio: Array) -> int | None:
    """Return the frequency at which the mean power of all stretches stands out, or None."""
    from scipy.stats import gamma  # noqa: PLC0415 - the daemon stays light

    count = len(ratio)
    mean = np.minimum(ratio, LOUDEST).mean(axis=0).max(axis=1)
    # The background of 34 lines scatters by a sixth: the mean of powers is widened by as much and more.
    limit = float(gamma.isf(LINE_P / mean.size, count, scale=1.0 / count)) * STACK_ALLOWANCE
    return int(np.argmax(mean)) if mean.max() > limit and count >= 10 else None


def _line_ratios(blocks: Array, rate: float) -> tuple[Array, Array, Array]:
    """Return frequencies, powers and their ratio to the mean power within 1 Hz, a line's own bins apart."""
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    window = np.hanning(blocks.shape[1])[None, :, None]
    spectrum = np.fft.rfft((blocks - blocks.mean(axis=1, keepdims=True)) * window, axis=1)
    power = np.abs(spectrum) ** 2
    around, own = 41 * uniform_filter1d(power, 41, axis=1), 7 * uniform_filter1d(power, 7, axis=1)
    background = np.maximum((around - own) / 34.0, 1e-6 * power.mean(axis=1, keepdims=True))
    frequencies = np.asarray(np.fft.rfftfreq(blocks.shape[1], 1.0 / rate), dtype=np.float64)
    return frequencies, np.asarray(power), np.asarray(power / np.maximum(background, 1e-300))


def _tone_finding(
    samples: Samples, sensor: str, resolution: float, power: Array, *, middle: int, rows: Index, length: int
) -> Finding:
    """Measure a line from the powers (stretches, 7, 3) about it: a Hann window spreads it on three bins."""
    energy = power.sum(axis=1)
    amplitude = np.sqrt(32.0 / 3.0 * np.median(energy, axis=0)) / length
    scatter = np.sqrt(32.0 / 3.0 * energy).std(axis=0) / length / np.sqrt(len(energy)) + 0.02 * amplitude
    profile = power.sum(axis=(0, 2))
    frequency = float((middle + profile @ np.arange(-3, 4) / profile.sum()) * resolution)
    axes = [a for a in range(3) if amplitude[a] > 0.3 * amplitude.max()]
    t_start, t_end = float(samples.t[rows[0] * length]), float(samples.t[(rows[-1] + 1) * length - 1])
    half = 0.2 * resolution
    ci = np.stack([amplitude - 1.96 * scatter, amplitude + 1.96 * scatter], axis=1)
    parameters = {
        "frequency": Parameter(frequency, [frequency - half, frequency + half], "Hz"),
        "amplitude": Parameter(amplitude.tolist(), ci.tolist(), UNIT[sensor]),
    }
    where = Where(t_start, t_end, (frequency - half, frequency + half), "time")
    size = f"{amplitude.max():.3g} {UNIT[sensor]}"
    say = f"The {sensor} sensor's data hold a vibration at {frequency:.2f} Hz, {size}."
    return direct_finding("vibration_tone", sensor, axes, where, parameters, statement=say, sigmas=10.0)
