"""Windows of some seconds in which a phone turns: what turns it back, and what it felt there.

Over some seconds of motion the gyroscope carries gravity: turned back by it, specific force stays where it
was, but for a hand's acceleration. A gyroscope that is late carries gravity late.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.residuals import Baseline
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned
from stillcal.calib_core.diagnosis.motion.affine_errors import affine_columns
from stillcal.calib_core.diagnosis.motion.axis_delays import axis_columns
from stillcal.calib_core.diagnosis.motion.block_regression import of_arm, slope_power
from stillcal.calib_core.diagnosis.motion.heterogeneity import Spectrum
from stillcal.calib_core.diagnosis.segments.rests.stillness import runs_of
from stillcal.calib_core.diagnosis.segments.turns import followed
from stillcal.calib_core.maths.rotation import attitudes, matrix
from stillcal.calib_core.streams.resample import interpolate
from stillcal.calib_core.streams.samples import Samples

WINDOW = 8.0
"""s over which gravity is carried; what the gyroscope's scale does meanwhile is nearly steady in time."""

LEAST_RATE, LIVELY_RATE = 0.2, 0.5
"""rad/s, rms, in a window that is looked at: the lively ones, where they are few the liveliest `WANTED`."""

WANTED = 20
SOME = 50
"""Intervals that are averaged where some may be missing."""

SMOOTHED = 1.25
"""Factor of frequency over which a power is averaged."""

HIGHEST = 0.3
"""Part of the sample rate that is looked at."""

MOSTLY = 0.8
"""Part of an arm's or a delay's columns that is motion, below which a frequency is left out. Noise that
chance makes larger than it is, or that a simulation adds once more to what was recorded, stays below."""

LONGEST = 0.2
"""s: the longest delay between the sensors that is looked for."""

Span = tuple[float, float]
"""First and last moment, s."""


@dataclass(frozen=True, slots=True, eq=False)
class RateNoise:
    """A gyroscope's noise at rest: power (F, 3), (rad/s)^2/Hz, one-sided, at frequencies f (F,) Hz."""

    f: Array
    power: Array

    @classmethod
    def of(cls, f: Array, power: Array) -> RateNoise:
        """Return that of the typical rest. power: (rests, F, 3), of which a single frequency tells little."""
        return cls(f, np.median(np.apply_along_axis(smoothed, 1, power), axis=0))

    def at(self, frequency: Array, mapping: Array) -> Array:
        """Return the power (n, 3) at frequencies (n,) of rates that a matrix (3, 3) mixes, calibrated."""
        each = [np.interp(frequency, self.f, p) for p in self.power.T]
        return np.asarray(np.stack(each, axis=1) @ (mapping**2).T)


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Some seconds in which a phone turns: stamps t (n,) s and calibrated rate (n, 3), rad/s.

    back: (n, 3, 3), turns the body to where it was at first. arm: what an arm does, turned back, (f, 3, 3).
    moves: (f,), which part of the rate is motion and not noise.
    """

    t: Array
    rate: Array
    back: Array
    arm: Spectrum
    moves: Array

    @classmethod
    def of(cls, t: Array, rate: Array, mapping: Array, noise: RateNoise | None = None) -> Window:
        """Carry the attitude through the window. rate: (n, 3), less its bias; `mapping` calibrates it.

        noise: as read at rest, None where rests do not show it.
        """
        true = rate @ mapping.T
        back = matrix(attitudes(t, true))
        arm, turning = spectrum(back @ of_arm(t, true)), spectrum(true)
        frequency = np.arange(len(arm)) / (_interval(t) * len(t))
        at_rest = np.zeros((len(arm), 3)) if noise is None else noise.at(frequency, mapping)
        power = _noise_power(t, true, at_rest)
        moves = _part_of_motion((np.abs(turning) ** 2).sum(axis=1), power.sum(axis=1))
        slope = slope_power(2.0 * np.pi * frequency * _interval(t)) / _interval(t) ** 2
        # Each column has the derivatives of the two other axes.
        others = slope[:, None] * (power.sum(axis=1)[:, None] - power)
        columns = zip((np.abs(arm) ** 2).sum(axis=1).T, others.T, strict=True)
        part = np.stack([_part_of_motion(*each) for each in columns], axis=1)
        return cls(t, true, back, arm * part[:, None, :], moves)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The windows in which a phone turns, with what it felt."""

    accelerometer: Samples
    affine: Aligned | None
    windows: Sequence[Window]
    gravity: float

    @property
    def baseline(self) -> Baseline | None:
        """The accelerometer's bias and scale; None where no rest tells them."""
        return None if self.affine is None else self.affine.baseline

    @classmethod
    def of(
        cls,
        accelerometer: Samples,
        gyroscope: Samples,
        affine: Aligned | None,
        gravity: float,
        spoiled: Sequence[Span],
        *,
        noise: RateNoise | None = None,
    ) -> Motion:
        """Cut the windows in which both sensors were recorded; spoiled: when not to look; noise: of rates."""
        windows = turning_windows(gyroscope, affine, spoiled)
        cut = [w for w in windows if _covered(w[0], accelerometer.t)]
        mapping = np.eye(3) if affine is None else affine.mapping
        parts = [Window.of(t, rate, mapping, noise) for t, rate in cut]
        return cls(accelerometer, affine, parts, gravity)

    def span(self) -> tuple[float, float]:
        """Return when the first window starts and the last one ends, s."""
        return float(self.windows[0].t[0]), float(self.windows[-1].t[-1])

    def age(self) -> Array:
        """Return when windows are, (K,), 1 from the first to the last, 0 in the mean."""
        middle = np.array([w.t.mean() for w in self.windows])
        return np.asarray((middle - middle.mean()) / float(np.ptp(middle)))

    def equations(self, delay: float, growth: float = 0.0) -> tuple[list[Spectrum], list[Spectrum]]:
        """Return what an arm and a delay do (f, 3, 4) and what there is to explain (f, 3), by window.

        Both are spectra of what is turned back to the window's start, free of gravity and of what grows
        steadily. The accelerometer is read earlier by a delay that grows, s.
        """
        every = [(w.t, w.rate, w.back, w.arm, w.moves) for w in self.windows]
        t, rate, back, arm, moves = (np.stack(each) for each in zip(*every, strict=True))
        times = t - (delay + growth * self.age())[:, None]
        force = force_at(self.accelerometer, self.baseline, times.ravel()).reshape(rate.shape)
        still, up = felt(back, force)
        late = -self.gravity * np.cross(rate, np.einsum("knji,kj->kni", back, up))
        turned = np.einsum("knij,knj->kni", back, late)
        by_delay, left = (spectrum(x.swapaxes(0, 1)).swapaxes(0, 1) for x in (turned, still))
        by_delay *= moves[:, :, None]
        return list(np.concatenate([arm, by_delay[..., None]], axis=3)), list(left)

    def of_axes(self) -> list[Spectrum]:
        """Return what delays of single axes do, as spectra (f, 3, 4) a window."""
        made = []
        for w in self.windows:
            _, up = felt(w.back, force_at(self.accelerometer, self.baseline, w.t))
            columns = spectrum(axis_columns(w.t, w.back, w.rate, up, self.gravity))
            made.append(columns * w.moves[:, None, None])
        return made

    def of_errors(self, delay: float) -> list[Spectrum] | None:
        """Return what errors of bias, scale and misalignment do, as spectra (f, 3, 18) a window.

        Each is one standard deviation of what rests and turns leave unknown. None without rests.
        """
        if self.affine is None:
            return None
        parameters, errors = self.affine.baseline.parameters, self.affine.left_unknown()
        made = []
        for w in self.windows:
            raw = force_at(self.accelerometer, None, w.t - delay)
            made.append(spectrum(affine_columns(w.t, w.back, w.rate, raw, parameters) @ errors))
        return made


def _noise_power(t: Array, rate: Array, at_rest: Array) -> Array:
    """Return the power (f, 3) that a gyroscope's noise has in the spectrum of a window's rate (n, 3).

    Fourth differences of white noise have 70 times its variance, those of motion next to none. at_rest:
    (f, 3), the power of noise at rest, (rad/s)^2/Hz: what has a memory, or is behind a low-pass, those
    differences do not show.
    """
    white = (np.diff(rate, 4, axis=0) ** 2).mean(axis=0) / 70.0
    return np.asarray((np.hanning(len(t) + 2) ** 2).sum() * np.maximum(white, at_rest / (2.0 * _interval(t))))


def _part_of_motion(power: Array, noise: Array) -> Array:
    """Return by frequency (f,) which part of a column's power is motion, and not the gyroscope's noise.

    An arm's columns are made of the rate's derivative, in which white noise grows with frequency, a delay's
    of the rate. Columns with noise make what is fitted seem smaller, and surer; what is to be expected of
    them, given what was read, does not (regression calibration: Carroll et al., Measurement Error in
    Nonlinear Models, 2006, 4). Nothing is taken from where noise is much of them: what chance leaves of it
    would count as motion.
    """
    part = 1.0 - noise / smoothed(power)
    return np.asarray(np.where(part > MOSTLY, part, 0.0))


def on_limits(accelerometer: Samples, gyroscope: Samples, limits: Mapping[str, float]) -> list[Span]:
    """Return when one of the sensors is on its limit, from the sample before to the one after.

    What a gyroscope does not see of a turn is missing from the attitude ever after, and says nothing of
    times; a window of motion can begin behind it. limits: by sensor, m/s^2 and rad/s; none where a sensor has
    none. An accelerometer is read by up to `LONGEST` earlier or later than the gyroscope.
    """
    sensors = (("accel", accelerometer, LONGEST), ("gyro", gyroscope, 0.0))
    return [
        (float(samples.t[max(a - 1, 0)]) - reach, float(samples.t[min(b, len(samples) - 1)]) + reach)
        for sensor, samples, reach in sensors
        for a, b in runs_of(np.any(np.abs(samples.xyz) >= limits.get(sensor, np.inf), axis=1))
    ]


def turning_windows(
    gyroscope: Samples, affine: Aligned | None, spoiled: Sequence[Span]
) -> list[tuple[Array, Array]]:
    """Return stamps (n,), all different, and rate (n, 3) of unbroken windows of turning, the lively ones.

    Samples of one stamp, as of a coarse clock or one that was kept from running back, are spread up to the
    next stamp. spoiled: when not to look; what lies between is cut into windows. Slow turns of a hand tell
    little, and its own acceleration is the louder beside them.
    """
    bias = np.zeros(3) if affine is None else affine.bias
    n = round(WINDOW / _interval(gyroscope.t))
    clear, stamps = np.ones(len(gyroscope), dtype=bool), _spread(gyroscope.t)
    for start, end in spoiled:
        clear[np.searchsorted(gyroscope.t, start) : np.searchsorted(gyroscope.t, end, side="right")] = False
    found, size = [], []
    for first in (k for a, b in runs_of(clear) for k in range(a, b - n, n)):
        t, rate = stamps[first : first + n], gyroscope.xyz[first : first + n] - bias
        rms = float(np.sqrt((rate**2).sum(axis=1).mean()))
        unbroken = t[-1] - t[0] < 1.5 * WINDOW and np.diff(t).min() > 0.0
        if unbroken and rms > LEAST_RATE and followed(t, rate):
            found.append((t, rate))
            size.append(rms)
    least = min(LIVELY_RATE, sorted(size)[-min(WANTED, len(size))]) if size else 0.0
    return [w for w, x in zip(found, size, strict=True) if x >= least]


def _spread(t: Array) -> Array:
    """Return stamps (n,) with those that are alike spread evenly up to the next one."""
    first = np.flatnonzero(np.diff(t, prepend=-np.inf) > 0.0)
    return t if first.size == t.size else np.interp(np.arange(t.size), first, t[first])


def _interval(t: Array) -> float:
    """Return the usual interval of stamps (n,), s, those that are missing here and there counted in."""
    some = min(SOME, len(t) - 1)
    return float(np.median(t[some:] - t[:-some])) / some


def _covered(t: Array, stamps: Array) -> bool:
    """Whether the accelerometer, sampled at `stamps`, has no pause in window t: two files may end apart."""
    within = stamps[np.searchsorted(stamps, t[0]) : np.searchsorted(stamps, t[-1])]
    return bool(np.diff(np.concatenate([t[:1], within, t[-1:]])).max() < 0.5 * WINDOW)


def felt(back: Array, force: Array) -> tuple[Array, Array]:
    """Return force (..., n, 3) turned back by `back` (..., n, 3, 3), and its mean direction (..., 3), up."""
    still = np.einsum("...nij,...nj->...ni", back, force)
    mean = still.mean(axis=-2)
    return still, np.asarray(mean / np.linalg.norm(mean, axis=-1, keepdims=True))


def force_at(samples: Samples, baseline: Baseline | None, t: Array) -> Array:
    """Return calibrated specific force (n, 3) at times t (n,)."""
    raw = interpolate(t, samples.t, samples.xyz)
    return raw if baseline is None else np.asarray((raw - baseline.bias) @ baseline.scale.T)


def smoothed(power: Array) -> Array:
    """Average a spectrum (f,) over `SMOOTHED` to either side."""
    total = np.concatenate([[0.0], np.cumsum(power)])
    k = np.arange(power.size)
    low = np.maximum((k / SMOOTHED).astype(int) - 1, 0)
    high = np.minimum((k * SMOOTHED).astype(int) + 2, power.size)
    return np.asarray((total[high] - total[low]) / (high - low) + 1e-300)


def spectrum(values: Array) -> Spectrum:
    """Return the spectrum (f, ...) of values (n, ...) under a Hann window, free of what grows steadily.

    It ends at `HIGHEST`: beyond, samples between two others are not known.
    """
    n = len(values)
    slow, taper = _steady_and_taper(n)
    flat = values.reshape(n, -1)
    free = (flat - slow @ (slow.T @ flat)) * taper
    return np.asarray(np.fft.rfft(free, axis=0)[: round(HIGHEST * n)].reshape(-1, *values.shape[1:]))


@cache
def _steady_and_taper(n: int) -> tuple[Array, Array]:
    """Return what grows steadily, orthonormal (n, 2), and a Hann window (n, 1)."""
    slow = np.linalg.qr(np.linspace(-1.0, 1.0, n)[:, None] ** np.arange(2.0))[0]
    return slow, np.hanning(n + 2)[1:-1, None]
