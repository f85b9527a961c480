"""Lines in the spectrum of steady stretches, all along the recording or for a while.

A line stands in the same place in several stretches and above its own neighbourhood, which a hand's tremor,
typing or a road do not. Its frequency and amplitude come from the stamps themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.misfit.left_out import blocks, rms
from stillcal.calib_core.misfit.quick import SIGNIFICANT, Index, Seen, direct_finding, vector
from stillcal.calib_core.misfit.records import Finding, Parameter, Where
from stillcal.calib_core.misfit.values import UNIT
from stillcal.calib_core.samples import Array, Samples

BRIEF, SHORT, LONG = 8.0, 20.0, 60.0
"""s of a stretch: short ones tell when a line comes and goes, long ones show faint lines, brief ones are for
rests that hold no others."""

PLAIN = 1e-20
"""Probability of a line by chance below which short stretches show it well enough."""

LEAST_LINE_HZ = 4.0
BODY_HZ, SURE = 6.0, 1e-12
"""Below this frequency a line must be as sure: overtones of hearts and hands reach so far."""

LINE_P = 1e-7
LEAST_STRETCHES = 5
LEAST_STACK = 10
STEADY = {"accel": 0.1, "gyro": 0.03}
STACK_ALLOWANCE = 1.15
LOUDEST = 10.0
LEAST_HALF, QUIET = 3.3, 2.83
"""QUIET: mean of the largest of nine powers with no line (1 + 1/2 + ... + 1/9)."""

FLANK = 0.15
FINE = 0.05
MOST_REFINED = 60
CLOCK = 2e-5
NAMED = 0.3
PACES = (0.6, 3.0)
"""Hz of hearts and steps."""
CONTRAST = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """Steady stretches. t: (S, n) s; values: (S, n, 3), no means; first: (S,); ratio, power: (S, F, 3)."""

    t: Array
    values: Array
    first: Index
    f: Array
    power: Array
    ratio: Array


def tone(samples: Samples, sensor: str) -> Finding | None:
    """Find the strongest line of one sensor above `LEAST_LINE_HZ`, or None."""
    found = _of_any_length(samples, sensor)
    if found is None or found.where.band_hz[0] > BODY_HZ or found.evidence.p_value < SURE:
        return found
    return None


def _of_any_length(samples: Samples, sensor: str) -> Finding | None:
    short = _stretches(samples, sensor, SHORT)
    found = _tone(samples, sensor, short)
    if found is not None and found.evidence.p_value < PLAIN:
        return found
    found = _tone(samples, sensor, _stretches(samples, sensor, LONG)) or found
    if found is None and (short is None or short.first.size < LEAST_STACK):
        return _tone(samples, sensor, _stretches(samples, sensor, BRIEF))
    return found


def _tone(samples: Samples, sensor: str, seen: Stretches | None) -> Finding | None:
    if seen is None:
        return None
    rate = 2.0 * float(seen.f[-1])
    high = np.flatnonzero((seen.f > LEAST_LINE_HZ) & (seen.f < 0.49 * rate))
    if high.size == 0:
        return None
    k = _line(seen.ratio[:, high])
    if k is None:
        return None
    middle = int(high[k])
    near = seen.ratio[:, middle - 1 : middle + 2].max(axis=(1, 2))
    lasting = _lasting(near)
    profile = seen.power[lasting][:, max(middle - 20, 0) : middle + 21].sum(axis=(0, 2))
    if lasting.size < LEAST_STRETCHES or not _narrow(profile) or _of_a_body(seen, lasting, middle):
        return None
    return _stated(samples, sensor, seen, lasting, middle)


def _stretches(samples: Samples, sensor: str, seconds: float) -> Stretches | None:
    rate = 1.0 / float(np.median(np.diff(samples.t)))
    length = int(seconds * rate)
    if length < 100 or len(samples) < 3 * length:
        return None
    first = _steady(samples.xyz, max(round(rate), 1), length, STEADY[sensor])
    first = first[samples.t[first + length - 1] - samples.t[first] < 1.2 * seconds]
    if first.size < 3:
        return None
    rows = first[:, None] + np.arange(length)
    values = samples.xyz[rows] - samples.xyz[rows].mean(axis=1, keepdims=True)
    power, ratio = _ratios(values)
    f = np.asarray(np.fft.rfftfreq(length, 1.0 / rate), dtype=np.float64)
    return Stretches(samples.t[rows], values, first, f, power, ratio)


def _steady(xyz: Array, second: int, length: int, most: float) -> Index:
    """Return first rows of stretches, one after another, whose means over a second stay where they are.

    They are rests, shaken or not; each begins where the one before has ended, or as the phone comes to rest.
    """
    count = len(xyz) // second
    means = xyz[: count * second].reshape(count, second, 3).mean(axis=1)
    span = max(length // second, 1)
    around = np.lib.stride_tricks.sliding_window_view(means, span, axis=0)
    still = np.ptp(around, axis=2).max(axis=1) < most
    still = still[: max((len(xyz) - length) // second + 1, 0)]
    starts, free = [], 0
    for k in np.flatnonzero(still):
        if k * second >= free:
            starts.append(int(k) * second)
            free = starts[-1] + length
    return np.array(starts, dtype=np.int64)


def _ratios(values: Array) -> tuple[Array, Array]:
    """Return powers (S, F, 3) and their ratio to the mean of 34 neighbours, a line's own bins apart."""
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    spectrum = np.fft.rfft(values * np.hanning(values.shape[1])[None, :, None], axis=1)
    power = np.asarray(np.abs(spectrum) ** 2)
    around, own = 41 * uniform_filter1d(power, 41, axis=1), 7 * uniform_filter1d(power, 7, axis=1)
    background = np.maximum((around - own) / 34.0, 1e-6 * power.mean(axis=1, keepdims=True))
    return power, np.asarray(power / np.maximum(background, 1e-300))


def _line(ratio: Array) -> int | None:
    """Return the frequency that stands out in `LEAST_STRETCHES` stretches, or in the mean of all."""
    best = ratio.max(axis=2)
    threshold = float(np.log(best.size * 3 / LINE_P))
    near = np.maximum(best, np.maximum(np.roll(best, 1, axis=1), np.roll(best, -1, axis=1)))
    hits = (near > threshold).sum(axis=0)
    if hits.max() >= LEAST_STRETCHES:
        clear = hits >= hits.max() - 1
        return int(np.argmax(np.where(clear, best.sum(axis=0), 0.0)))
    return _stacked(ratio)


def _stacked(ratio: Array) -> int | None:
    """Return where the mean power of all, half or a quarter of the stretches stands out, or None.

    On one axis, or in the sum of the three.
    """
    from scipy.stats import gamma  # noqa: PLC0415 - the daemon stays light

    total = np.concatenate([np.zeros((1, *ratio.shape[1:])), np.cumsum(np.minimum(ratio, LOUDEST), axis=0)])
    best: tuple[float, int] | None = None
    for part in (1, 2, 4):
        count = len(ratio) // part
        if count < LEAST_STACK:
            break
        first = np.arange(0, len(ratio) - count + 1, max(count // 2, 1))
        mean = (total[first + count] - total[first]) / count
        # The background of 34 lines scatters by a sixth, which widens the tail of means of powers.
        for values, freedom in ((mean.max(axis=2), count), (mean.mean(axis=2), 3 * count)):
            limit = float(gamma.isf(LINE_P / mean.size, freedom, scale=1.0 / freedom)) * STACK_ALLOWANCE
            top = float(values.max()) / limit
            if top > 1.0 and (best is None or top > best[0]):
                best = top, int(np.argmax(values.max(axis=0)))
    return None if best is None else best[1]


def _lasting(near: Array) -> Index:
    """Return the run of stretches that gains most over half way from no line to the mean; near: (S,)."""
    half = max(0.5 * (QUIET + float(near.mean())), LEAST_HALF)
    gain = np.concatenate([[0.0], np.cumsum(np.minimum(near, 4.0 * half) - half)])
    lowest = np.minimum.accumulate(gain)
    last = int(np.argmax(gain - lowest))
    first = int(np.argmin(gain[: last + 1]))
    return np.arange(first, last, dtype=np.int64)


def _narrow(profile: Array) -> bool:
    """Whether the power (41,) about a line falls off as a Hann window's own does, within three bins."""
    middle = profile.size // 2
    away = np.abs(np.arange(profile.size) - middle)
    floor = float(np.median(profile[away > 12]))
    flank = float(profile[(away >= 4) & (away <= 6)].mean()) - floor
    return flank < FLANK * (float(profile[away <= 1].mean()) - floor)


def _of_a_body(seen: Stretches, rows: Index, middle: int) -> bool:
    """Whether a line is an overtone of a heart or a step.

    Its lower neighbours stand at multiples of one pace.
    """
    power = seen.power[rows].sum(axis=(0, 2))
    floor = np.array([np.median(power[max(k - 20, 1) : k + 21]) for k in range(middle + 3)])
    step, line = float(seen.f[1]), float(power[middle - 1 : middle + 2].max())
    for n in range(2, int(middle * step / PACES[0]) + 1):
        pace = middle / n
        if not PACES[0] <= pace * step <= PACES[1]:
            continue
        lower = [round(pace * (n - k)) for k in (1, 2) if n > k]
        tops = [float(power[max(j - 2, 0) : j + 3].max()) for j in lower]
        if all(p > CONTRAST * floor[j] and p > 0.5 * line for p, j in zip(tops, lower, strict=True)):
            return True
    return False


def _amplitudes(seen: Stretches, rows: Index, f: Array) -> Array:
    """Return complex amplitudes (rows, f, 3) of sines by the stamps, under a Hann window."""
    window = np.hanning(seen.values.shape[1])
    out = np.empty((rows.size, f.size, 3), dtype=np.complex128)
    for i, row in enumerate(rows):
        t = seen.t[row] - seen.t[row].mean()
        out[i] = np.exp(-2j * np.pi * np.outer(f, t)) @ (seen.values[row] * window[:, None])
    return np.asarray(2.0 * out / window.sum())


def _frequency(seen: Stretches, rows: Index, middle: int) -> tuple[float, float]:
    """Return frequency and standard error from the power about a bin, the error from fifths left out."""
    few = rows[np.linspace(0, rows.size - 1, min(rows.size, MOST_REFINED)).astype(int)]
    step = float(seen.f[1])
    grid = seen.f[middle] + np.arange(-1.5, 1.5 + FINE, FINE) * step
    power = (np.abs(_amplitudes(seen, few, grid)) ** 2).sum(axis=2)
    fold = blocks(len(power))
    best = _peak(grid, power.sum(axis=0))
    parts = np.array([_peak(grid, power[fold != k].sum(axis=0)) for k in np.unique(fold)])
    n = parts.size
    error = float(np.sqrt((n - 1) / n * ((parts - parts.mean()) ** 2).sum()))
    return best, float(np.hypot(error, max(CLOCK * best, 2e-3 * step)))


def _peak(grid: Array, power: Array) -> float:
    k = int(np.clip(np.argmax(power), 1, grid.size - 2))
    a, b, c = power[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    return float(
        grid[k] + (0.0 if bend >= 0.0 else np.clip(0.5 * (a - c) / bend, -1, 1)) * (grid[1] - grid[0])
    )


def _stated(samples: Samples, sensor: str, seen: Stretches, rows: Index, middle: int) -> Finding | None:
    frequency, error = _frequency(seen, rows, middle)
    line = np.abs(_amplitudes(seen, rows, np.array([frequency]))[:, 0]) ** 2
    scale = (2.0 / np.hanning(seen.values.shape[1]).sum()) ** 2
    noise = scale * seen.power[rows, middle] / np.maximum(seen.ratio[rows, middle], 1e-300)
    power, spread = (line - noise).mean(axis=0), line.std(axis=0) / np.sqrt(rows.size)
    amplitude = np.sqrt(np.maximum(power, 0.0))
    scatter = np.minimum(spread / np.maximum(2.0 * amplitude, 1e-12), np.sqrt(spread)) + 1e-3 * amplitude
    axes = [
        a for a in range(3) if amplitude[a] > NAMED * amplitude.max() and power[a] > 3.0 * spread[a] - 1e-30
    ]
    axes = axes or [int(np.argmax(amplitude))]
    evidence = _left_out(line, noise)
    if evidence.sigmas < SIGNIFICANT:
        return None
    first, last = int(seen.first[rows[0]]), int(seen.first[rows[-1]]) + seen.values.shape[1] - 1
    half = 1.96 * error
    parameters = {
        "frequency": Parameter(frequency, [frequency - half, frequency + half], "Hz"),
        "amplitude": vector(amplitude, scatter, UNIT[sensor]),
    }
    where = Where(
        float(samples.t[first]), float(samples.t[last]), (frequency - half, frequency + half), "time"
    )
    rate = 2.0 * float(seen.f[-1])
    say = (
        f"The {sensor} sensor's data hold a vibration at {frequency:.2f} Hz,"
        f" {amplitude.max():.3g} {UNIT[sensor]}"
        f" (or at {rate - frequency:.1f} or {rate + frequency:.1f} Hz, sampled too slowly)."
    )
    return direct_finding("vibration_tone", sensor, axes, where, parameters, statement=say, seen=evidence)


def _left_out(line: Array, noise: Array) -> Seen:
    """Predict powers (S, 3) of stretches left out: exponential about noise, with and without a line."""
    floor = np.maximum(noise.mean(axis=0), 1e-300)
    ratio = line / floor
    fold, gain = blocks(len(ratio)), 0.0
    before, after = [], []
    for k in np.unique(fold):
        test, more = ratio[fold == k], np.maximum(ratio[fold != k].mean(axis=0), 1.0)
        gain += float((test - test / more - np.log(more)).sum())
        seen = np.sqrt(line[fold == k])
        before.append(rms(seen))
        after.append(rms(seen - np.sqrt(line[fold != k].mean(axis=0))))
    more = np.maximum(ratio.mean(axis=0), 1.0)
    whole = float(len(ratio) * (more - 1.0 - np.log(more)).sum())
    return Seen(float(np.sqrt(2.0 * whole)), gain, rms(np.array(before)), rms(np.array(after)))
