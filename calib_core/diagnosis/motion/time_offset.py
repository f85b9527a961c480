"""What motion says of the time between the sensors, and of where the accelerometer sits.

Over some seconds of motion the gyroscope carries gravity: turned back by it, specific force stays where it
was, but for a hand's acceleration. A gyroscope that is late carries gravity late. Windows are compared in
frequency, each frequency of each window as sure as what the hand does there is small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.measurement import Measured, direct_finding, of_measured
from stillcal.calib_core.diagnosis.model.records import Alternative, Finding, Where
from stillcal.calib_core.diagnosis.model.residuals import Baseline
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.motion.axis_delays import AxisDelays, axis_columns
from stillcal.calib_core.diagnosis.motion.block_regression import PARTS, Regression, of_arm
from stillcal.calib_core.diagnosis.motion.delay_trend import DelayTrend
from stillcal.calib_core.diagnosis.motion.heterogeneity import Spectrum, disagreement
from stillcal.calib_core.diagnosis.motion.lever_arm import lever_arm
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.maths.rotation import attitudes, matrix
from stillcal.calib_core.streams.resample import interpolate
from stillcal.calib_core.streams.samples import Samples

WINDOW = 8.0
"""s over which gravity is carried; what the gyroscope's scale does meanwhile is nearly steady in time."""

LEAST_RATE, LIVELY_RATE = 0.2, 0.5
"""rad/s, rms, in a window that is looked at: the lively ones, where they are few the liveliest `WANTED`."""

SOME = 50
"""Intervals that are averaged where some may be missing."""

WANTED = 20
LEAST_WINDOWS = 12
DRAWN = 40
"""Windows from which a figure is made, and the delay is found roughly."""

SLOW = 0.05
"""Part of the sample rate that a figure is made of."""

LONGEST = 0.2
SLOWEST = 1.0
"""Hz: about 1 / (2 pi `LONGEST`), so that the phase of no delay goes round."""

HIGHEST = 0.3
"""Part of the sample rate that is looked at."""

USUAL = 0.05
"""s: standard deviation of a delay before motion tells it."""

LINEARISED = 3
"""Times that the model is taken about the delay found before, at all frequencies."""

REWEIGHTED = 3
SMOOTHED = 1.25
"""Factor of frequency over which the power of what is left is averaged to weigh by."""

LEAST_ERROR = 2e-4
ARM = np.array([True, True, True, False])
"""The columns of an arm; the fourth is the delay's."""


def motion_findings(
    accelerometer: Samples,
    gyroscope: Samples,
    affine: Aligned | None,
    gravity: float,
    usual: Usual,
    *,
    spoiled: Sequence[Where] = (),
) -> list[Finding]:
    """Return what motion shows; nothing where there is too little.

    affine: what rests and turns say of the sensors, None without rests; usual: of the delay, s;
    spoiled: when not to look.
    """
    if len(gyroscope) < 200:
        return []
    motion = _Motion.of(accelerometer, gyroscope, affine, gravity, spoiled)
    if len(motion.windows) < LEAST_WINDOWS:
        return []
    interval = sample_period(gyroscope.t)
    fit = motion.fitted()
    where = Where(*motion.span(), (0.1, 0.5 / interval), "rate of turn")
    error = float(np.hypot(np.sqrt(fit.last.sums.jackknifed(PARTS)[1][3, 3]), fit.delay_apart))
    # Errors from few windows are themselves uncertain: about Student's t at four standard deviations.
    delay = Measured(fit.delay, max(error * (1.0 + 6.0 / len(motion.windows)), LEAST_ERROR))
    late, axes, trend = (
        _delayed(delay, fit, usual, where, interval),
        fit.axes(motion),
        fit.trend(motion),
    )
    surely = 0.0 if late is None else late.evidence.log_bayes_factor
    if late is None or axes.differ or trend.grows:
        by_time = trend.log_chance < axes.log_chance
        late = trend.finding(where, fit.delay, surely) if by_time else axes.finding(where, surely)
    found = [
        late,
        lever_arm(fit.last.sums.only(ARM), fit.arm_apart, where),
    ]
    return [f for f in found if f]


def power_over_delays(
    accelerometer: Samples,
    gyroscope: Samples,
    affine: Aligned | None,
    delays: Array,
    gravity: float = STANDARD,
) -> Array | None:
    """Return what motion leaves if the gyroscope is late by each of `delays` (n,) s, over the least, (n,).

    It is the weighed power of the accelerometer less gravity as the gyroscope carries it, with the lever arm
    fitted at each delay, from `DRAWN` windows at most and below `SLOW` of the accelerometer's rate: there the
    power does not depend on where between two samples a delay falls. None where the phone turns too little.
    """
    motion = _Motion.of(accelerometer, gyroscope, affine, gravity, ())
    if len(motion.windows) < LEAST_WINDOWS:
        return None
    motion = replace(motion, windows=drawn(motion.windows))
    weight = motion.fitted().last.weight
    highest = SLOW / sample_period(accelerometer.t)
    weight = np.where(np.arange(weight.shape[1]) / WINDOW <= highest, weight, 0.0)
    left = []
    for delay in delays:
        arm = _summed(*motion.equations(float(delay)), weight).only(ARM)
        left.append(float(arm.left(arm.fitted()).sum()))
    return np.asarray(left) / min(left)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A delay, s, the normal equations about no delay (`first`) and about it (`last`), and its spectra.

    Both are weighed alike, by what is left about the delay. growth: about how much it grows, s.
    """

    delay: float
    growth: float
    first: Regression
    last: _Weighed
    effects: list[Spectrum]
    still: list[Spectrum]

    @property
    def delay_apart(self) -> float:
        """The delay's error, s, that windows that disagree make."""
        return self.last.apart([e[:, :, 3] for e in self.effects])

    @property
    def arm_apart(self) -> float:
        """The arm's, as a part of it."""
        arm = self.last.sums.fitted()[:3]
        return self.last.apart([e[:, :, :3] @ arm for e in self.effects])

    def axes(self, motion: _Motion) -> AxisDelays:
        """Return what sets the delays of single axes apart."""
        return AxisDelays(*self._beside(motion.of_axes()))

    def trend(self, motion: _Motion) -> DelayTrend:
        """Return by how much the delay grows from the first window to the last."""
        effects, still = motion.equations(self.delay, self.growth)
        about = replace(self, effects=effects, still=still)
        sums, (apart,) = about._beside(_growing(effects, motion.age()))
        return DelayTrend(sums, apart, self.growth)

    def _beside(self, more: Sequence[Spectrum]) -> tuple[Regression, list[float]]:
        """Return the equations with further columns, spectra (f, 3, k) a window, and how parts disagree."""
        every = [np.concatenate(pair, axis=2) for pair in zip(self.effects, more, strict=True)]
        beside = _Weighed.of(every, self.still)
        return beside.sums, [beside.apart([m[:, :, k] for m in more]) for k in range(more[0].shape[2])]


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """Some seconds in which a phone turns: stamps t (n,) s and calibrated rate (n, 3), rad/s.

    back: (n, 3, 3), turns the body to where it was at first. arm: what an arm does, turned back, (f, 3, 3).
    """

    t: Array
    rate: Array
    back: Array
    arm: Spectrum

    @classmethod
    def of(cls, t: Array, rate: Array) -> _Window:
        """Carry the attitude through the window."""
        back = matrix(attitudes(t, rate))
        return cls(t, rate, back, _spectrum(back @ of_arm(t, rate)))

    def felt(self, force: Array) -> tuple[Array, Array]:
        """Return force (n, 3) turned back, and its mean direction (3,), up."""
        still = np.einsum("nij,nj->ni", self.back, force)
        mean = still.mean(axis=0)
        return still, np.asarray(mean / np.linalg.norm(mean))

    def equations(self, force: Array, gravity: float) -> tuple[Spectrum, Spectrum]:
        """Return what an arm and a delay do (f, 3, 4) and what there is to explain (f, 3), as spectra.

        Both are turned back to the window's start, and free of gravity and of what grows steadily.
        """
        still, up = self.felt(force)
        late = -gravity * np.cross(self.rate, np.einsum("nji,j->ni", self.back, up))
        turned = _spectrum(np.einsum("nij,nj->ni", self.back, late))
        return np.concatenate([self.arm, turned[:, :, None]], axis=2), _spectrum(still)


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """The windows in which a phone turns, with what it felt."""

    accelerometer: Samples
    baseline: Baseline | None
    windows: Sequence[_Window]
    gravity: float

    @classmethod
    def of(
        cls,
        accelerometer: Samples,
        gyroscope: Samples,
        affine: Aligned | None,
        gravity: float,
        spoiled: Sequence[Where],
    ) -> _Motion:
        """Cut the windows in which both sensors were recorded; spoiled: when not to look."""
        cut = [
            p
            for p in turning_windows(gyroscope, affine)
            if _covered(p[0], accelerometer.t) and all(_apart(p[0], s) for s in spoiled)
        ]
        mapping = np.eye(3) if affine is None else affine.mapping
        parts = [_Window.of(t, rate @ mapping.T) for t, rate in cut]
        return cls(accelerometer, None if affine is None else affine.baseline, parts, gravity)

    def span(self) -> tuple[float, float]:
        """Return when the first window starts and the last one ends, s."""
        return float(self.windows[0].t[0]), float(self.windows[-1].t[-1])

    def age(self) -> Array:
        """Return when windows are, (K,), 1 from the first to the last, 0 in the mean."""
        middle = np.array([w.t.mean() for w in self.windows])
        return np.asarray((middle - middle.mean()) / float(np.ptp(middle)))

    def equations(self, delay: float, growth: float = 0.0) -> tuple[list[Spectrum], list[Spectrum]]:
        """Return the equations of all windows, the accelerometer read earlier by a delay that grows, s."""
        made = [
            w.equations(_force(self.accelerometer, self.baseline, w.t - each), self.gravity)
            for w, each in zip(self.windows, delay + growth * self.age(), strict=True)
        ]
        return [x for x, _ in made], [y for _, y in made]

    def of_axes(self) -> list[Spectrum]:
        """Return what delays of single axes do, as spectra (f, 3, 4) a window."""
        made = []
        for w in self.windows:
            _, up = w.felt(_force(self.accelerometer, self.baseline, w.t))
            made.append(_spectrum(axis_columns(w.t, w.back, w.rate, up, self.gravity)))
        return made

    def fitted(self) -> _Fit:
        """Fit delay and arm, the model taken anew about each delay found."""
        total, growth = replace(self, windows=drawn(self.windows)).by_octaves()
        for _ in range(LINEARISED):
            effects, still = self.equations(total)
            last = _Weighed.of(effects, still)
            total = _within(total + float(last.sums.fitted()[3]))
        first = _summed(*self.equations(0.0), last.weight)
        return _Fit(total, growth, first, last, effects, still)

    def by_octaves(self) -> tuple[float, float]:
        """Return about which delay and growth of it, s, the model is linear in both at all frequencies.

        Below `SLOWEST` it is linear for every delay. Each octave more is fitted about what the slower ones
        tell, which is small beforehand where they tell nothing.
        """
        delay, growth, top = 0.0, 0.0, round(SLOWEST * WINDOW)
        while top < len(self.windows[0].arm):
            effects, still = self.equations(delay, growth)
            both = [
                np.concatenate(x, axis=2) for x in zip(effects, _growing(effects, self.age()), strict=True)
            ]
            slow = _Weighed.of([x[:top] for x in both], [y[:top] for y in still])
            more = slow.likely_step(np.array([delay, growth]))
            delay, growth, top = _within(delay + more[0]), _within(growth + more[1]), 2 * top
        return delay, growth


def _growing(effects: Sequence[Spectrum], age: Array) -> list[Spectrum]:
    """Return what a delay does that grows with age (K,), spectra (f, 3, 1) a window."""
    return [x[:, :, 3:] * a for x, a in zip(effects, age, strict=True)]


def drawn(windows: Sequence[_Window]) -> Sequence[_Window]:
    """Return `DRAWN` windows at most, from all of the recording."""
    return windows[:: -(-len(windows) // DRAWN)]


def _within(delay: float) -> float:
    """Return a delay or its growth, s, that is no longer than is looked for."""
    return float(np.clip(delay, -LONGEST, LONGEST))


def turning_windows(gyroscope: Samples, affine: Aligned | None) -> list[tuple[Array, Array]]:
    """Return stamps (n,), all different, and rate (n, 3) of unbroken windows of turning, the lively ones.

    Slow turns of a hand tell little, and its own acceleration is the louder beside them.
    """
    bias = np.zeros(3) if affine is None else affine.bias
    n = round(WINDOW / _interval(gyroscope.t))
    found, size = [], []
    for first in range(0, len(gyroscope) - n, n):
        t, rate = gyroscope.t[first : first + n], gyroscope.xyz[first : first + n] - bias
        rms = float(np.sqrt((rate**2).sum(axis=1).mean()))
        if t[-1] - t[0] < 1.5 * WINDOW and np.diff(t).min() > 0.0 and rms > LEAST_RATE:
            found.append((t, rate))
            size.append(rms)
    least = min(LIVELY_RATE, sorted(size)[-min(WANTED, len(size))]) if size else 0.0
    return [w for w, x in zip(found, size, strict=True) if x >= least]


def _interval(t: Array) -> float:
    """Return the usual interval of stamps (n,), s, those that are missing here and there counted in."""
    some = min(SOME, len(t) - 1)
    return float(np.median(t[some:] - t[:-some])) / some


def _covered(t: Array, stamps: Array) -> bool:
    """Whether the accelerometer, sampled at `stamps`, has no pause in window t: two files may end apart."""
    within = stamps[np.searchsorted(stamps, t[0]) : np.searchsorted(stamps, t[-1])]
    return bool(np.diff(np.concatenate([t[:1], within, t[-1:]])).max() < 0.5 * WINDOW)


def _apart(t: Array, spoiled: Where) -> bool:
    return bool(t[-1] < spoiled.t_start or t[0] > spoiled.t_end)


def _force(samples: Samples, baseline: Baseline | None, t: Array) -> Array:
    """Return calibrated specific force (n, 3) at times t (n,)."""
    raw = interpolate(t, samples.t, samples.xyz)
    return raw if baseline is None else np.asarray((raw - baseline.bias) @ baseline.scale.T)


def _spectrum(values: Array) -> Spectrum:
    """Return the spectrum (f, ...) of values (n, ...) under a Hann window, free of what grows steadily.

    It ends at `HIGHEST`: beyond, samples between two others are not known.
    """
    n = len(values)
    slow = np.linalg.qr(np.linspace(-1.0, 1.0, n)[:, None] ** np.arange(2.0))[0]
    flat = values.reshape(n, -1)
    free = (flat - slow @ (slow.T @ flat)) * np.hanning(n + 2)[1:-1, None]
    return np.asarray(np.fft.rfft(free, axis=0)[: round(HIGHEST * n)].reshape(-1, *values.shape[1:]))


def _summed(effects: list[Spectrum], still: list[Spectrum], weight: Array) -> Regression:
    """Return the normal equations of windows weighed by (K, f)."""
    designs, lefts = (
        [_parts(x, w) for x, w in zip(every, weight, strict=True)] for every in (effects, still)
    )
    return Regression.of(designs, lefts)


@dataclass(frozen=True, slots=True, eq=False)
class _Weighed:
    """Normal equations of K windows, each frequency weighed by the power of what is left there.

    That is maximum likelihood of a noise of unknown spectrum (Whittle, 1953), each window's own: a hand's
    power is some hundred times as much in one as in another. weight: (K, f); left: (K, f, 3), weighed.
    """

    sums: Regression
    weight: Array
    left: Spectrum

    @classmethod
    def of(cls, effects: list[Spectrum], still: list[Spectrum]) -> _Weighed:
        """Weigh anew by what each fit leaves."""
        x = np.zeros(effects[0].shape[2])
        for _ in range(REWEIGHTED):
            power = (np.abs(_left(effects, still, x)) ** 2).mean(axis=2)
            weight = 1.0 / np.sqrt([_smooth(own) for own in power])
            sums = _summed(effects, still, weight)
            x = sums.fitted()
        return cls(sums, weight, _left(effects, still, x) * weight[:, :, None])

    def likely_step(self, delays: Array) -> Array:
        """Return by how much more than `delays` (k,), s, the last k parameters are, as `USUAL` ones are."""
        held = np.zeros(self.sums.target.shape[1])
        held[-delays.size :] = USUAL**-2.0
        target = self.sums.target.sum(axis=0)
        target[-delays.size :] -= USUAL**-2.0 * delays
        information = self.sums.information.sum(axis=0) + np.diag(held)
        return np.asarray(np.linalg.solve(information, target)[-delays.size :])

    def apart(self, terms: Sequence[Spectrum]) -> float:
        """Return the standard error of a term's size that its scatter makes; terms: (f, 3) a window."""
        frequency, term = np.arange(self.weight.shape[1]) / WINDOW, np.array(terms)
        return disagreement(term * self.weight[:, :, None], self.left, frequency)


def _left(effects: list[Spectrum], still: list[Spectrum], x: Array) -> Spectrum:
    """Return what parameters (k,) leave of K windows' spectra, (K, f, 3)."""
    return np.array([y - e @ x for e, y in zip(effects, still, strict=True)], complex)


def _smooth(power: Array) -> Array:
    """Average a spectrum (f,) over `SMOOTHED` to either side."""
    total = np.concatenate([[0.0], np.cumsum(power)])
    k = np.arange(power.size)
    low = np.maximum((k / SMOOTHED).astype(int) - 1, 0)
    high = np.minimum((k * SMOOTHED).astype(int) + 2, power.size)
    return np.asarray((total[high] - total[low]) / (high - low) + 1e-300)


def _parts(values: Spectrum, weight: Array) -> Array:
    """Stack real and imaginary parts (2 f, ...), weighed (f,)."""
    shaped = values * weight.reshape(-1, *[1] * (values.ndim - 1))
    return np.concatenate([shaped.real, shaped.imag])


def _delayed(delay: Measured, fit: _Fit, usual: Usual, where: Where, interval: float) -> Finding | None:
    """State a delay that no sound phone has; interval: of samples, s."""
    if abs(delay.value) >= LONGEST:
        return None
    side = "behind" if delay.value > 0 else "ahead of"
    say = f"The gyroscope is {abs(delay.value) * 1e3:.1f} ms {side} the accelerometer; shift its time stamps."
    seen = of_measured(delay, usual, fit.last.sums.held_out(ARM, without=fit.first))
    # A second-order low-pass of this cutoff delays as much; beyond the band no noise would show it.
    cutoff = np.sqrt(2.0) / (2.0 * np.pi * abs(delay.value))
    hidden = bool(cutoff > thresholds.BANDWIDTH_LIMIT / interval)
    return direct_finding(
        "accel_gyro_time_offset",
        "timing",
        [],
        where,
        {"delay": delay.parameter("s")},
        statement=say,
        seen=seen,
        alternatives=[Alternative("bandwidth", seen.held_out.gain, True)] if hidden and seen.held_out else [],
    )
