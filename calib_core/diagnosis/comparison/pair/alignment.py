"""What two sensors' readings of one motion differ by while they move, sample by sample, and by what effect.

In means over some seconds an error that grows with the square of the rate of turn, or with its change, is
nearly gone. So the effects that show in turns are fitted to the samples of where the readings change most,
beside scale, misalignment and delays. They are put into what the other sensor reads before the rest is
judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.direct import of_delay
from stillcal.calib_core.diagnosis.comparison.pair.delay import (
    Late,
    aligned,
    delay_between,
    found_delays,
    hidden_delay,
    late,
)
from stillcal.calib_core.diagnosis.comparison.pair.turns import Arm, Turns
from stillcal.calib_core.diagnosis.comparison.quantity import Key, Quantity
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.model.moments import History, Moments, at_samples
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.streams.resample import read_at, temperature_at
from stillcal.calib_core.streams.samples import Samples, Sensor

IN_STEPS = "motion shows it, by no more than coarse steps make, which it dithers and a rest does not"


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Both sensors of one device at the recording's stamps; the gyroscope's is None where one has none."""

    force: Samples
    rate: Samples | None


@dataclass(frozen=True, slots=True, eq=False)
class KnownBefore:
    """What is known of two sensors before their motion is compared.

    unsure: s, a standard error that a delay between the sensors has besides, since low-passes were played.
    at_rest: (3,) rad/s, what the other gyroscope reads where nothing turns, which drives no effect; None
    where that is not known. rounding: sd (3,) of what coarse steps of both leave in a mean, by sensor.
    noise: variance (3,) of what the other reads at rest, by sensor.
    """

    unsure: float = 0.0
    at_rest: Array | None = None
    rounding: Mapping[str, Array] = field(default_factory=dict)
    noise: Mapping[str, Array] = field(default_factory=dict)


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


def align(own: Readings, other: Readings, known: KnownBefore | None = None) -> Alignment:
    """Put into what the other sensor reads what the one shows besides in motion.

    other: at the recording's stamps, and between them where the recording lacks samples.
    """
    known = known or KnownBefore()
    true = Readings(_at_stamps_of(own.force, other.force), None)
    force, rate = late(own.force, true.force, "accel"), None
    true = replace(true, force=aligned(true.force, force, other.force))
    if own.rate is not None and other.rate is not None:
        same = _at_stamps_of(own.rate, other.rate)
        rate = late(own.rate, same, "gyro")
        true = replace(true, rate=aligned(same, rate, other.rate))
    none = Readings(_nothing(true.force), true.rate and _nothing(true.rate))
    whole = Alignment(true, none, [], [], frozenset())
    if force is not None and rate is not None:
        delay = delay_between(force, rate, known.unsure)
        found = found_delays(delay, force, rate, own.force, known.unsure)
        numbers = [of_delay(delay, own.force) for f in found if f.effect == DELAY]
        why = None if found else hidden_delay(delay_between(force, rate), known.unsure)
        key = (DELAY, "timing")
        sought, hidden = frozenset({key} if why is None else ()), {} if why is None else {key: why}
        whole = Alignment(true, none, [Stated(f) for f in found], numbers, sought, hidden)
    if force is not None:
        whole = _with_effects(whole, own.force, true, force, known)
    if rate is not None and own.rate is not None:
        whole = _with_effects(whole, own.rate, true, rate, known)
    return whole


def _at_stamps_of(own: Samples, other: Samples) -> Samples:
    """Return what the other reads at the recording's stamps, with the recording's temperature."""
    return replace(own, xyz=read_at(other, own.t).xyz)


def _nothing(samples: Samples) -> Samples:
    return replace(samples, xyz=frozen(np.zeros_like(samples.xyz)))


def _with_effects(
    before: Alignment, own: Samples, true: Readings, seen: Late, known: KnownBefore
) -> Alignment:
    """Return an alignment with the effects that the turns of one sensor show besides.

    Motion dithers coarse steps and a rest does not, which goes with the rate of turn as an effect does: one
    that adds no more than they leave is not stated.
    """
    of_force = own.sensor is Sensor.ACCELEROMETER
    reads = true.force if of_force else true.rate
    assert reads is not None, "where a delay was measured there are readings"
    drivers = _drivers(own, _turning(true, known.at_rest))
    name = "accel" if of_force else "gyro"
    noise = known.noise.get(name, np.zeros(3))
    turns = Turns(own, reads, seen.pieces, drivers, filtered=known.unsure > 0.0, noise=noise)
    span = float(own.t[0]), float(own.t[-1])
    every = [Arm()] if of_force else effects_of("gyro", in_turns=True)
    # Linear in all that they have: nothing but numbers is fitted to samples, and no moment is looked for.
    effects = [e for e in every if list(e.points(drivers)) == [{}]]
    least = known.rounding.get(name, np.zeros(3))
    found = turns.shown(effects)
    clear = [one for one in found if turns.exceeds(one, least)]
    small = {one.effect.key for one in found if one not in clear}
    shown = [(one, f) for one in clear if (f := one.finding(span)) is not None]
    more = sum((one.added(drivers) for one, _ in shown), np.zeros_like(reads.xyz))
    added, reads = (replace(reads, xyz=frozen(xyz)) for xyz in (more, reads.xyz + more))
    reference = drivers.history.reference_c
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
