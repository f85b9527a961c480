"""What two sensors' readings of one motion differ by while they move, sample by sample, and by what effect.

In means over some seconds an error that grows with the square of the rate of turn, or with its change, is
nearly gone. So the effects that show in turns are fitted to the samples of where the readings change most,
beside scale, misalignment and delays. They are put into what the other sensor reads before the rest is
judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.direct import of_delay
from stillcal.calib_core.diagnosis.comparison.linear.quantities import effect_quantity
from stillcal.calib_core.diagnosis.comparison.pair.delay import (
    COMMON,
    Late,
    aligned,
    delay_between,
    found_delays,
    hidden_delay,
    late,
    linear_in_motion,
)
from stillcal.calib_core.diagnosis.comparison.quantity import Key, Quantity
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of, nameless
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, Linear
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, of_chance
from stillcal.calib_core.diagnosis.model.moments import History, Moments, at_samples
from stillcal.calib_core.diagnosis.model.records import AXES, SLOW_BAND, Finding, Where
from stillcal.calib_core.diagnosis.motion.block_regression import PARTS, Regression, of_arm
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, parameters
from stillcal.calib_core.diagnosis.slow.statement import Stated, named_axes
from stillcal.calib_core.streams.resample import temperature_at
from stillcal.calib_core.streams.samples import Samples, Sensor

ALIKE = 0.01
"""Part of an effect's physical size by which two sensors may differ and nothing is wrong, one standard
deviation: 1 mm of an arm, a scale that differs by 2e-4 at 1 rad/s."""

EXPLAINED = 0.5
"""Part of what noise does not explain that effects must explain for their names: less is the smaller part."""

IN_STEPS = "motion shows it, by no more than coarse steps make, which it dithers and a rest does not"

WHITE = 70.0
"""Variance of the fourth differences of white noise of variance one; motion has next to none."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Both sensors of one device at the recording's stamps; the gyroscope's is None where one has none."""

    force: Samples
    rate: Samples | None


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
class Alignment:
    """What the other sensor reads, with the delays and the effects of turns that the one has besides.

    added: what these effects are of it; found: their findings, and those of delays; quantities: the numbers
    of those with a name; sought: what could be looked for, by effect and sensor; hidden: what motion shows of
    the rest and why it may be nothing.
    """

    readings: Readings
    added: Readings
    found: list[Stated]
    quantities: list[Quantity]
    sought: frozenset[Key]
    hidden: Mapping[Key, str] = field(default_factory=dict)


def align(
    own: Readings,
    other: Readings,
    unsure: float = 0.0,
    at_rest: Array | None = None,
    rounding: Mapping[str, Array] | None = None,
) -> Alignment:
    """Put into what the other sensor reads what the one shows besides in motion.

    unsure: s, a standard error that a delay between the sensors has besides. at_rest: (3,) rad/s, what the
    other gyroscope reads where nothing turns, which drives no effect; None where that is not known. rounding:
    sd (3,) of what coarse steps of both leave in a mean, by sensor; None without any.
    """
    force, rate = late(own.force, other.force, "accel"), None
    if own.rate is not None and other.rate is not None:
        rate = late(own.rate, other.rate, "gyro")
    true = Readings(aligned(other.force, force), other.rate and aligned(other.rate, rate))
    none = Readings(_nothing(true.force), true.rate and _nothing(true.rate))
    whole = Alignment(true, none, [], [], frozenset())
    if force is not None and rate is not None:
        delay = delay_between(force, rate, unsure)
        found = found_delays(delay, force, rate, own.force)
        numbers = [of_delay(delay, own.force) for f in found if f.effect == DELAY]
        why = None if found else hidden_delay(delay_between(force, rate), unsure)
        key = (DELAY, "timing")
        sought, hidden = frozenset({key} if why is None else ()), {} if why is None else {key: why}
        whole = Alignment(true, none, [Stated(f) for f in found], numbers, sought, hidden)
    if force is not None:
        whole = _with_effects(
            whole, own.force, true, force, at_rest, filtered=unsure > 0.0, rounding=rounding or {}
        )
    if rate is not None and own.rate is not None:
        whole = _with_effects(
            whole, own.rate, true, rate, at_rest, filtered=unsure > 0.0, rounding=rounding or {}
        )
    return whole


def _nothing(samples: Samples) -> Samples:
    return replace(samples, xyz=frozen(np.zeros_like(samples.xyz)))


def _with_effects(
    before: Alignment,
    own: Samples,
    true: Readings,
    seen: Late,
    at_rest: Array | None,
    *,
    filtered: bool,
    rounding: Mapping[str, Array],
) -> Alignment:
    """Return an alignment with the effects that the turns of one sensor show besides.

    rounding: as in `align`. Motion dithers coarse steps and a rest does not, which goes with the rate of turn
    as an effect does: one that adds no more than they leave is not stated.
    """
    of_force = own.sensor is Sensor.ACCELEROMETER
    reads = true.force if of_force else true.rate
    assert reads is not None, "where a delay was measured there are readings"
    turns = _Turns(own, reads, seen.pieces, _drivers(own, _turning(true, at_rest)), filtered)
    span = float(own.t[0]), float(own.t[-1])
    every = [Arm()] if of_force else effects_of("gyro", in_turns=True)
    # Linear in all that they have: nothing but numbers is fitted to samples, and no moment is looked for.
    effects = [e for e in every if list(e.points(turns.drivers)) == [{}]]
    least = rounding.get("accel" if of_force else "gyro", np.zeros(3))
    found = turns.shown(effects)
    clear = [one for one in found if turns.exceeds(one, least)]
    small = {one.effect.key for one in found if one not in clear}
    shown = [(one, f) for one in clear if (f := one.finding(span)) is not None]
    more = sum((one.added(turns.drivers) for one, _ in shown), np.zeros_like(reads.xyz))
    added, reads = (replace(reads, xyz=frozen(xyz)) for xyz in (more, reads.xyz + more))
    reference = turns.drivers.history.reference_c
    return Alignment(
        replace(before.readings, **{"force" if of_force else "rate": reads}),
        replace(before.added, **{"force" if of_force else "rate": added}),
        [*before.found, *(Stated(f) for _, f in shown)],
        [*before.quantities, *(o.quantity(span, reference) for o, f in shown if f.effect != "unknown")],
        (before.sought | {e.key for e in effects}) - small,
        {**before.hidden, **dict.fromkeys(small, IN_STEPS)},
    )


def _turning(true: Readings, at_rest: Array | None) -> Readings:
    """Return readings without what the gyroscope reads at rest: its cube would hold a square of the rate."""
    if true.rate is None or at_rest is None:
        return true
    return replace(true, rate=replace(true.rate, xyz=frozen(true.rate.xyz - at_rest)))


def _drivers(own: Samples, true: Readings) -> Moments:
    """Return what drives effects at a sensor's samples: what the other reads stands for the true input."""
    warm = temperature_at(true.force, own.t)
    reference = 0.0 if warm is None else float(warm.mean())
    span = float(own.t[0]), float(own.t[-1])
    history = History(span, np.zeros((0, 2)), None, None if warm is None else reference)
    return at_samples(own.t, history, (true.force, true.rate), None if warm is None else warm - reference)


@dataclass(frozen=True, slots=True, eq=False)
class _Turns:
    """Where one sensor's readings change most: what both read there, and what drives effects.

    filtered: whether low-passes were played, for one of the two has them.
    """

    own: Samples
    reads: Samples
    pieces: list[slice]
    drivers: Moments
    filtered: bool

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
        """Fit an effect beside scale, delay and `others`; its evidence is that against these alone."""
        sums = self._equations([*others, effect])
        value, covariance, _ = sums.jackknifed(PARTS)
        sizes = np.concatenate([np.full(p.count, p.size) for p in effect.parameters])
        k = sizes.size
        x, own = value[-k:], covariance[-k:, -k:]
        within = own + np.diag((ALIKE * sizes) ** 2)
        held_out = sums.held_out(np.arange(value.size) < value.size - k)
        return InTurns(effect, x, own, DirectEvidence(of_chance(sums.log_chance(x, within)), held_out))

    def _equations(self, effects: Sequence[Effect]) -> Regression:
        """Return the normal equations of gains, one delay and effects."""

        def response(rows: slice) -> Array:
            return np.concatenate([e.response(self.drivers.during(rows), {}) for e in effects], axis=2)

        sums = linear_in_motion(self.own, self.reads, self.pieces, response if effects else None)
        more = sums.target.shape[1] - len(COMMON)
        mixed = np.zeros((len(COMMON) + more, COMMON.shape[1] + more))
        mixed[: len(COMMON), : COMMON.shape[1]] = COMMON
        mixed[len(COMMON) :, COMMON.shape[1] :] = np.eye(more)
        return sums.through(mixed)

    def _explained(self, effects: Sequence[Effect]) -> float:
        """Return the part that effects explain of what scale, delay and white noise do not."""
        bare, whole = self._equations([]), self._equations(effects)
        before, after = (float(sums.left(sums.fitted()).sum()) for sums in (bare, whole))
        away = self.own.xyz - self.reads.xyz
        rough = [float((np.diff(away[p], 4, axis=0) ** 2).mean()) * away[p].size for p in self.pieces]
        noise = sum(rough) / WHITE
        return (before - after) / max(before - noise, before - after)
