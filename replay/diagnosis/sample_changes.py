"""Differences that change a simulation's samples instead of adding to them.

What was read is stamped later, filtered, clipped, rounded, lost, repeated or stamped roughly, in this order:
the share that repeats the one before is measured of the samples that are there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.coverage.not_logged import SHOWS_MORE
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import LOW_PASS
from stillcal.calib_core.diagnosis.comparison.quantity import Quantity
from stillcal.calib_core.diagnosis.comparison.records import Discrepancy
from stillcal.calib_core.diagnosis.comparison.sample_rate import rate as counted_rate
from stillcal.calib_core.diagnosis.model.records import AXES
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY
from stillcal.calib_core.streams.samples import Samples

Change = Callable[[Samples], Samples]
"""Makes samples of one sensor as the recording's are."""

REGULAR = 0.02
"""Part of the repeats that all runs of the longest kind would make, by which fewer are as good as those."""

MORE = SHOWS_MORE[0]
"""Relations of a simulation that has none of something, or less than the recording."""


def changes(discrepancies: Sequence[Discrepancy], seed: int) -> list[tuple[Discrepancy, Change]]:
    """Return the differences that change samples, in order, and what does so. seed: of what is drawn."""
    makers: list[Callable[[Discrepancy], Change | None]] = [_moving, _clipping, _rounding]
    makers += [partial(make, seed=seed) for make in (_losing, _repeating, _jittering)]
    made = ((one, make(one)) for make in makers for one in discrepancies)
    return [(one, change) for one, change in made if change is not None]


def sensors_of(one: Discrepancy) -> tuple[str, ...]:
    """Return the sensors whose samples a difference changes; stamps are those of both."""
    if one.sensor == "timing":
        return ("gyro",) if one.effect == DELAY else ("accel", "gyro")
    return (one.sensor,)


def rate_of(samples: Samples) -> float:
    """Return the rate at which samples come, Hz."""
    return float(np.exp(counted_rate(samples).value[0]))


def _moving(one: Discrepancy) -> Change | None:
    """Stamp samples later, or filter them by a low-pass that the recording has.

    Values between the samples would be means of their noise, and means of two look like a low-pass, which
    delays by as much.
    """
    if one.effect == DELAY:
        delay = _delay(one)
        return lambda samples: replace(samples, t=frozen(samples.t + delay))
    known = one.difference
    if one.effect != LOW_PASS or known is None or known.recorded.none:
        return None
    return partial(low_passed, found=known.recorded, own=known.simulated)


def _delay(one: Discrepancy) -> float:
    """Return by how much later than in the simulation the gyroscope reads, s."""
    if one.difference is not None:
        both = one.difference.recorded, one.difference.simulated
        late, other = (float(np.exp(q.value[0]) if q.logarithmic else q.value[0]) for q in both)
        return late - other
    own = one.recorded or one.simulated
    assert own is not None, "what has no difference was found in one of the two"
    delay = float(np.ravel(own.parameters["delay"].value)[0])
    return delay if one.recorded is not None else -delay


def low_passed(samples: Samples, found: Quantity, own: Quantity | None = None) -> Samples:
    """Return samples behind a low-pass as it was measured, a Butterworth filter.

    own: the low-pass that they are behind already, which it takes the place of. Both filters have zeros where
    nothing passes, as many as their orders; those of the one stand for those of the other. Where it filters
    some axes only, the others stay as they are.
    """
    from scipy.signal import butter, lfilter, lfilter_zi  # noqa: PLC0415 - scipy is loaded when it is needed

    rate, order = rate_of(samples), _order(found)
    _, poles = butter(order, float(np.exp(found.value[0])), fs=rate)
    zeros, instead = order, np.ones(1)
    if own is not None and not own.none:
        zeros = max(order - _order(own), 0)
        _, instead = butter(_order(own), float(np.exp(own.value[0])), fs=rate)
    made = np.convolve(np.poly(-np.ones(zeros)), instead)
    made *= poles.sum() / made.sum()
    state = np.outer(lfilter_zi(made, poles), samples.xyz[0])
    filtered = lfilter(made, poles, samples.xyz, axis=0, zi=state)[0]
    behind = [not found.axes or a in found.axes for a in range(len(AXES))]
    return replace(samples, xyz=frozen(np.where(behind, filtered, samples.xyz)))


def _order(low_pass: Quantity) -> int:
    return int(low_pass.reference["order"])


def _clipping(one: Discrepancy) -> Change | None:
    limit = limit_of(one)
    return None if limit is None else partial(clipped, limit=limit)


def clipped(samples: Samples, limit: float) -> Samples:
    """Return samples that stop at a limit."""
    return replace(samples, xyz=frozen(np.clip(samples.xyz, -limit, limit)))


def limit_of(one: Discrepancy) -> float | None:
    """Return the limit at which the recording's sensor stops below the simulation's; None for all else."""
    if not one.effect.endswith("_saturation"):
        return None
    if one.difference is None:
        return None if one.recorded is None else float(np.min(one.recorded.parameters["limit"].value))
    return float(np.exp(one.difference.recorded.value.min())) if one.relation == "too_large" else None


def _rounding(one: Discrepancy) -> Change | None:
    """Round values to the step of the recording's, where the simulation's are finer."""
    if not one.effect.endswith("_quantisation") or one.relation not in MORE:
        return None
    if one.difference is not None:
        step = float(np.exp(one.difference.recorded.value.max()))
    elif one.recorded is not None:
        step = float(np.max(one.recorded.parameters["step"].value))
    else:
        return None
    coarse = [not one.axes or axis in one.axes for axis in AXES]

    def rounded(samples: Samples) -> Samples:
        return replace(samples, xyz=frozen(np.where(coarse, np.rint(samples.xyz / step) * step, samples.xyz)))

    return rounded


def _both(one: Discrepancy, effect: str) -> tuple[float, float] | None:
    """Return the recording's and the simulation's number of an effect of which the simulation has less."""
    known = one.difference
    if not one.effect.endswith(effect) or one.relation not in MORE or known is None:
        return None
    recorded, simulated = (
        0.0 if q.none else float(np.exp(q.value[0])) for q in (known.recorded, known.simulated)
    )
    return recorded, simulated


def _share(one: Discrepancy, effect: str) -> float | None:
    """Return the part of a simulation's samples that are spoiled besides to be as many as the recording's."""
    both = _both(one, effect)
    return None if both is None else (both[0] - both[1]) / (1.0 - both[1])


def _repeating(one: Discrepancy, seed: int) -> Change | None:
    """Give some samples the value of the one before, no more in a row than the recording has."""
    share, known = _share(one, "held_samples"), one.difference
    if share is None or known is None:
        return None
    longest = int(known.recorded.reference["longest"])

    def held(samples: Samples) -> Samples:
        return held_at(samples, in_runs(len(samples), share, longest, np.random.default_rng(seed)))

    return held


def in_runs(n: int, share: float, longest: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Choose a share of n samples by chance, at most `longest` in a row.

    After each that is not chosen one more follows with one chance, again and again. Runs of a driver that
    reads each value twice are all of one.
    """
    from scipy.optimize import brentq  # noqa: PLC0415 - heavy, and only here

    mean, count = share / (1.0 - share), np.arange(1, longest + 1)
    regular = mean >= (1.0 - REGULAR) * longest
    goes_on = 1.0 if regular else float(brentq(lambda p: (p**count).sum() - mean, 0.0, 1.0))
    runs = np.full(n, longest) if regular else np.minimum(rng.geometric(1.0 - goes_on, n) - 1, longest)
    chosen = np.ones(n, dtype=np.bool_)
    others = np.cumsum(np.concatenate([[0], 1 + runs]))
    chosen[others[others < n]] = False
    return chosen


def held_at(samples: Samples, again: NDArray[np.bool_]) -> Samples:
    """Return samples of which some, (n,), have the values of the one before."""
    last = np.maximum.accumulate(np.where(again, 0, np.arange(len(samples))))
    return replace(samples, xyz=frozen(samples.xyz[last]))


def _losing(one: Discrepancy, seed: int) -> Change | None:
    """Leave some samples out, of sensors that are read together the same ones."""
    share = _share(one, "dropped_samples")
    if share is None:
        return None

    def left(samples: Samples) -> Samples:
        return samples.where(np.random.default_rng(seed).random(len(samples)) >= share)

    return left


def _jittering(one: Discrepancy, seed: int) -> Change | None:
    """Stamp samples by chance too early or too late, in their order all the same."""
    both = _both(one, "timestamp_jitter")
    if both is None:
        return None
    sigma = float(np.sqrt(both[0] ** 2 - both[1] ** 2))

    def stamped(samples: Samples) -> Samples:
        t = samples.t + np.random.default_rng(seed).normal(0.0, sigma, len(samples))
        return replace(samples, t=frozen(np.maximum.accumulate(t)))

    return stamped
