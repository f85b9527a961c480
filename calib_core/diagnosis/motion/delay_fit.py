"""A delay between the sensors and a lever arm, fitted to windows of motion together.

Windows are compared in frequency, each frequency of each window as sure as what the hand does there is small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.motion.axis_delays import ALIKE, AxisDelays
from stillcal.calib_core.diagnosis.motion.block_regression import Regression, solved
from stillcal.calib_core.diagnosis.motion.delay_trend import DelayTrend
from stillcal.calib_core.diagnosis.motion.heterogeneity import Spectrum, disagreement
from stillcal.calib_core.diagnosis.motion.turning_windows import LONGEST, WINDOW, Motion, Window, smoothed

DRAWN = 40
"""Windows from which a delay is found roughly."""

SLOWEST = 1.0
"""Hz: about 1 / (2 pi `LONGEST`), so that the phase of no delay goes round."""

USUAL = 0.05
"""s: standard deviation of a delay before motion tells it."""

LINEARISED = 3
"""Times that the model is taken about the delay found before, at all frequencies."""

REWEIGHTED, SETTLED = 20, 0.01
"""Most times that windows are weighed anew, and the relative change of what is fitted that ends it: from no
arm and no delay on, weights hold what an arm does for noise at first, and three times are not enough."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A delay, s, the normal equations about no delay (`first`) and about it (`last`), and its spectra.

    Both are weighed alike, by what is left about the delay. growth: about how much it grows, s. errors: what
    bias, scale and misalignment may do beside it, spectra (f, 3, m) a window; None where they are not known.
    """

    delay: float
    growth: float
    first: Regression
    last: Weighed
    effects: list[Spectrum]
    still: list[Spectrum]
    errors: list[Spectrum] | None

    @property
    def delay_apart(self) -> float:
        """The delay's error, s, that windows that disagree make."""
        return self.last.apart([e[:, :, 3] for e in self.effects])

    @property
    def arm_apart(self) -> float:
        """The arm's, as a part of it."""
        arm = self.last.sums.fitted()[:3]
        return self.last.apart([e[:, :, :3] @ arm for e in self.effects])

    def axes(self, motion: Motion) -> AxisDelays:
        """Return what sets the delays of single axes apart."""
        sums, apart = self._beside(motion.of_axes())
        return AxisDelays(sums, np.hypot(apart, ALIKE))

    def trend(self, motion: Motion) -> DelayTrend:
        """Return by how much the delay grows from the first window to the last."""
        effects, still = motion.equations(self.delay, self.growth)
        about = replace(self, effects=effects, still=still)
        sums, (apart,) = about._beside(_growing(effects, motion.age()))
        return DelayTrend(sums, apart, self.delay, self.growth)

    def _beside(self, more: Sequence[Spectrum]) -> tuple[Regression, list[float]]:
        """Return the equations with further columns, spectra (f, 3, k) a window, and how parts disagree."""
        every = [np.concatenate(pair, axis=2) for pair in zip(self.effects, more, strict=True)]
        beside = Weighed.of(every, self.still).beside(every, self.errors)
        return beside.sums, [beside.apart([m[:, :, k] for m in more]) for k in range(more[0].shape[2])]


def fitted(motion: Motion) -> Fit:
    """Fit delay and arm, the model taken anew about each delay found."""
    total, growth = by_octaves(replace(motion, windows=drawn(motion.windows)))
    for _ in range(LINEARISED):
        effects, still = motion.equations(total)
        last = Weighed.of(effects, still)
        total = _within(total + float(last.sums.fitted()[3]))
    first = summed(*motion.equations(0.0), last.weight)
    errors = motion.of_errors(total)
    return Fit(total, growth, first, last.beside(effects, errors), effects, still, errors)


def by_octaves(motion: Motion) -> tuple[float, float]:
    """Return about which delay and growth of it, s, the model is linear in both at all frequencies.

    Below `SLOWEST` it is linear for every delay. Each octave more is fitted about what the slower ones
    tell, which is small beforehand where they tell nothing.
    """
    delay, growth, top = 0.0, 0.0, round(SLOWEST * WINDOW)
    while top < len(motion.windows[0].arm):
        effects, still = motion.equations(delay, growth)
        both = [np.concatenate(x, axis=2) for x in zip(effects, _growing(effects, motion.age()), strict=True)]
        slow = Weighed.of([x[:top] for x in both], [y[:top] for y in still])
        more = slow.likely_step(np.array([delay, growth]))
        delay, growth, top = _within(delay + more[0]), _within(growth + more[1]), 2 * top
    return delay, growth


def _growing(effects: Sequence[Spectrum], age: Array) -> list[Spectrum]:
    """Return what a delay does that grows with age (K,), spectra (f, 3, 1) a window."""
    return [x[:, :, 3:] * a for x, a in zip(effects, age, strict=True)]


def drawn(windows: Sequence[Window]) -> Sequence[Window]:
    """Return `DRAWN` windows at most, from all of the recording."""
    return windows[:: -(-len(windows) // DRAWN)]


def _within(delay: float) -> float:
    """Return a delay or its growth, s, that is no longer than is looked for."""
    return float(np.clip(delay, -LONGEST, LONGEST))


def summed(effects: list[Spectrum], still: list[Spectrum], weight: Array) -> Regression:
    """Return the normal equations of windows weighed by (K, f)."""
    return Regression.of(_weighed(effects, weight), _weighed(still, weight))


def _weighed(every: list[Spectrum], weight: Array) -> list[Array]:
    return [_parts(x, w) for x, w in zip(every, weight, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """Normal equations of K windows, each frequency weighed by the power of what is left there.

    That is maximum likelihood of a noise of unknown spectrum (Whittle, 1953), each window's own: a hand's
    power is some hundred times as much in one as in another. weight: (K, f); left: (K, f, 3), weighed.
    """

    sums: Regression
    weight: Array
    left: Spectrum

    @classmethod
    def of(cls, effects: list[Spectrum], still: list[Spectrum]) -> Weighed:
        """Weigh anew by what each fit leaves."""
        x = np.zeros(effects[0].shape[2])
        for _ in range(REWEIGHTED):
            power = (np.abs(_left(effects, still, x)) ** 2).mean(axis=2)
            weight = 1.0 / np.sqrt([smoothed(own) for own in power])
            sums = summed(effects, still, weight)
            before, x = x, sums.fitted()
            if np.linalg.norm(x - before) < SETTLED * np.linalg.norm(x):
                break
        return cls(sums, weight, _left(effects, still, x) * weight[:, :, None])

    def beside(self, effects: list[Spectrum], errors: list[Spectrum] | None) -> Weighed:
        """Return the same with errors (f, 3, m) a window that all windows share; None are none."""
        if errors is None:
            return self
        designs, added = _weighed(effects, self.weight), _weighed(errors, self.weight)
        return replace(self, sums=self.sums.sharing(designs, added))

    def likely_step(self, delays: Array) -> Array:
        """Return by how much more than `delays` (k,), s, the last k parameters are, as `USUAL` ones are."""
        held = np.zeros(self.sums.target.shape[1])
        held[-delays.size :] = USUAL**-2.0
        target = self.sums.target.sum(axis=0)
        target[-delays.size :] -= USUAL**-2.0 * delays
        information = self.sums.information.sum(axis=0) + np.diag(held)
        return solved(information, target)[-delays.size :]

    def apart(self, terms: Sequence[Spectrum]) -> float:
        """Return the standard error of a term's size that its scatter makes; terms: (f, 3) a window."""
        frequency, term = np.arange(self.weight.shape[1]) / WINDOW, np.array(terms)
        return disagreement(term * self.weight[:, :, None], self.left, frequency)


def _left(effects: list[Spectrum], still: list[Spectrum], x: Array) -> Spectrum:
    """Return what parameters (k,) leave of K windows' spectra, (K, f, 3)."""
    return np.array([y - e @ x for e, y in zip(effects, still, strict=True)], complex)


def _parts(values: Spectrum, weight: Array) -> Array:
    """Stack real and imaginary parts (2 f, ...), weighed (f,)."""
    shaped = values * weight.reshape(-1, *[1] * (values.ndim - 1))
    return np.concatenate([shaped.real, shaped.imag])
