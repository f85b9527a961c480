"""Effects that show in turns, fitted to the samples of where the readings of two sensors change most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.linear.quantities import effect_quantity
from stillcal.calib_core.diagnosis.comparison.pair.delay import (
    COMMON,
    linear_in_motion,
)
from stillcal.calib_core.diagnosis.comparison.quantity import Quantity
from stillcal.calib_core.diagnosis.effects.catalogue import nameless
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, Linear
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, of_chance
from stillcal.calib_core.diagnosis.model.moments import Moments
from stillcal.calib_core.diagnosis.model.records import AXES, SLOW_BAND, Finding, Where
from stillcal.calib_core.diagnosis.motion.block_regression import PARTS, Regression, of_arm
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, parameters
from stillcal.calib_core.diagnosis.slow.statement import named_axes
from stillcal.calib_core.streams.samples import Samples, Sensor

ALIKE = 0.01
"""Part of an effect's physical size by which two sensors may differ and nothing is wrong, one standard
deviation: 1 mm of an arm, a scale that differs by 2e-4 at 1 rad/s."""

EXPLAINED = 0.5
"""Part of what noise does not explain that effects must explain for their names: less is the smaller part."""

WHITE = 70.0
"""Variance of the fourth differences of white noise of variance one; motion has next to none."""


class Arm(Effect):
    """The accelerometer is away from the point that the other one is at."""

    name = "lever_arm"
    sensor = "accel"
    follows = "rate of turn"
    parameters = (Linear("position", "m", 3, 0.1),)
    in_turns = True

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where the rate is known."""
        return [] if moments.rate is None else [{}]

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return what an arm along each axis does, (n, 3, 3)."""
        assert moments.rate is not None, "no grid points without it"
        return of_arm(moments.t, moments.rate)


@dataclass(frozen=True, slots=True, eq=False)
class InTurns:
    """An effect that motion shows, with its numbers (k,), their covariance (k, k), SI, and the evidence."""

    effect: Effect
    value: Array
    covariance: Array
    seen: DirectEvidence

    @property
    def gain(self) -> float:
        """What it adds to the log score of what was left out of the fit, nats."""
        return 0.0 if self.seen.held_out is None else self.seen.held_out.gain

    def added(self, moments: Moments) -> Array:
        """Return what it adds to the readings (n, 3) at some moments."""
        return np.asarray(self.effect.response(moments, {}) @ self.value)

    def finding(self, span: tuple[float, float]) -> Finding | None:
        """Return it as a finding; None where its evidence does not carry it. span: s, of the recording."""
        covariance = self.quantity(span, None).covariance
        own = Estimate(self._hypothesis, self.value, covariance, {}, self.gain)
        axes = [AXES.index(a) for a in named_axes(own)]
        where, say = Where(*span, SLOW_BAND, self.effect.follows), self.effect.sentence
        name, sensor = self.effect.name, self.effect.sensor
        return direct_finding(name, sensor, axes, where, parameters(own), statement=say, seen=self.seen)

    def quantity(self, span: tuple[float, float], reference_c: float | None) -> Quantity:
        """Return its numbers. reference_c: degC about which temperatures count."""
        one = effect_quantity(span, self._hypothesis, self.value, self.covariance)
        if reference_c is None or not one.effect.endswith("_temperature"):
            return one
        return replace(one, reference={"temperature_c": reference_c})

    @property
    def _hypothesis(self) -> Hypothesis:
        return Hypothesis(self.effect, {}, ())


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """Where one sensor's readings change most: what both read there, and what drives effects.

    filtered: whether low-passes were played, for one of the two has them. noise: variance (3,) of the noise
    of what the other reads.
    """

    own: Samples
    reads: Samples
    pieces: list[slice]
    drivers: Moments
    filtered: bool
    noise: Array

    def shown(self, effects: Sequence[Effect]) -> list[InTurns]:
        """Return the effects that predict left-out pieces best, one by one, each beside the others.

        Where they explain the smaller part of what noise does not, something is left that their names do not
        say, and the clearest of them stands for it without a name. Behind low-passes it may be these, which
        are known roughly.
        """
        chosen: list[Effect] = []
        while len(chosen) < thresholds.MAX_FINDINGS:
            tried = [self._fitted(e, chosen) for e in effects]
            best = max(tried, key=lambda one: one.gain, default=None)
            if best is None or not best.seen.stated:
                break
            chosen.append(best.effect)
            effects = [e for e in effects if e is not best.effect and e.name != best.effect.name]
        found = [self._fitted(e, [o for o in chosen if o is not e]) for e in chosen]
        if not found or self._explained(chosen) >= EXPLAINED:
            return found
        if self.filtered:
            return []
        first = max(found, key=lambda one: one.gain)
        return [replace(first, effect=nameless(first.effect))]

    def exceeds(self, one: InTurns, least: Array) -> bool:
        """Whether an effect adds more than `least` (3,), root mean square, on the axis where it adds most."""
        added = np.concatenate([one.added(self.drivers.during(piece)) for piece in self.pieces])
        size = np.sqrt(np.mean(added**2, axis=0))
        return bool(size.max() > least[np.argmax(size)])

    def _fitted(self, effect: Effect, others: Sequence[Effect]) -> InTurns:
        """Fit an effect beside scale, delay and `others`; its evidence is that against these alone.

        What the other sensor's noise makes of it is taken off, and is itself as unsure as it is large.
        """
        sums = self._equations([*others, effect])
        value, covariance, _ = sums.jackknifed(PARTS)
        sizes = np.concatenate([np.full(p.count, p.size) for p in effect.parameters])
        k = sizes.size
        of_noise = value - self._equations([*others, effect], np.zeros(3)).fitted()
        x, own = value[-k:], covariance[-k:, -k:] + np.diag(of_noise[-k:] ** 2)
        within = own + np.diag((ALIKE * sizes) ** 2)
        held_out = sums.held_out(np.arange(value.size) < value.size - k)
        return InTurns(effect, x, own, DirectEvidence(of_chance(sums.log_chance(x, within)), held_out))

    def _equations(self, effects: Sequence[Effect], noise: Array | None = None) -> Regression:
        """Return the normal equations of gains, one delay and effects. noise: (3,), `noise` by default."""

        def response(rows: slice) -> Array:
            return self._response(effects, self.drivers.during(rows))

        sums = linear_in_motion(self.own, self.reads, self.pieces, response if effects else None)
        of_noise = self._of_noise(effects, self.noise if noise is None else noise)
        sums = replace(sums, target=sums.target + of_noise)
        more = sums.target.shape[1] - len(COMMON)
        mixed = np.zeros((len(COMMON) + more, COMMON.shape[1] + more))
        mixed[: len(COMMON), : COMMON.shape[1]] = COMMON
        mixed[len(COMMON) :, COMMON.shape[1] :] = np.eye(more)
        return sums.through(mixed)

    def _response(self, effects: Sequence[Effect], moments: Moments) -> Array:
        """Return what effects do at some moments, (n, 3, k)."""
        return np.concatenate([e.response(moments, {}) for e in effects], axis=2)

    def _of_noise(self, effects: Sequence[Effect], noise: Array) -> Array:
        """Return what the other sensor's noise takes off the targets of `linear_in_motion`, (K, 12 + k).

        The noise n is in what drives a column f, and its opposite in what the columns explain. The mean of
        f(x + n) n is the variance of n times the mean slope of f, where n is normal (Stein's lemma). Where an
        axis turns in one direction only, nothing but noise parts the size of its rate from the rate.
        """
        out = np.zeros((len(self.pieces), 12 + sum(p.count for e in effects for p in e.parameters)))
        for made, piece in zip(out, self.pieces, strict=True):
            made[:9] = (piece.stop - piece.start) * np.diag(noise).ravel()
            moments = self.drivers.during(piece)
            if moments.rate is None or self.own.sensor is Sensor.ACCELEROMETER:
                continue
            for axis in np.flatnonzero(noise) if effects else ():
                step = np.sqrt(noise[axis]) * np.eye(3)[axis]
                up, down = (
                    self._response(effects, replace(moments, rate=moments.rate + sign * step))[:, axis].sum(
                        axis=0
                    )
                    for sign in (1.0, -1.0)
                )
                made[12:] += noise[axis] * (up - down) / (2.0 * step[axis])
        return out

    def _explained(self, effects: Sequence[Effect]) -> float:
        """Return the part that effects explain of what scale, delay and white noise do not."""
        bare, whole = self._equations([]), self._equations(effects)
        before, after = (float(sums.left(sums.fitted()).sum()) for sums in (bare, whole))
        away = self.own.xyz - self.reads.xyz
        rough = [float((np.diff(away[p], 4, axis=0) ** 2).mean()) * away[p].size for p in self.pieces]
        noise = sum(rough) / WHITE
        return (before - after) / max(before - noise, before - after)
