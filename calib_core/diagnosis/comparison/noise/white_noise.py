"""White noise and low-passes of a recording as quantities that do not depend on its rate or length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.quantity import (
    TIMES,
    Difference,
    Key,
    Part,
    Quantity,
    Relation,
    subtract,
)
from stillcal.calib_core.diagnosis.direct.repeated_values import MANY
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.model.records import AT_REST, AXES, Where
from stillcal.calib_core.diagnosis.model.settings import AXIS_SIGMA, BANDWIDTH_LIMIT, CERTAIN_NATS
from stillcal.calib_core.diagnosis.noise.low_pass import may_be_behind, relative_cutoff
from stillcal.calib_core.diagnosis.noise.noise_level import odd_one_out, ratios_to_others
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.diagnosis.stream import Stream

ALIKE_DENSITY = float(np.log(1.05))
"""Noise densities of one phone on two days differ by some per cent with temperature and what it lies on."""

SILENT = 1e-12
"""Density below which samples have no noise at all, only rounding of double precision, as simulations may."""

NONE_ERROR = 0.15
"""Standard deviation of the logarithm of a density that is as good as none."""

ALIKE_CUTOFF = 0.05
"""Relative difference of two cutoffs that is none: they depend on the shape that is fitted."""

BENEATH_STEPS = float(np.log(1.5))
"""Standard deviation of the logarithm of a density beneath steps of 2.2 to 3.5 times a sample's: up to
half as much again is seen of it, or less, by where between two steps the values lie."""

NONE_AT_ALL = "it has no noise at all"
SHAKEN = "what shakes its other sensor at rest shakes this one too"
HIDDEN = "a dead zone hides what it reads at rest"
BLURRED = "its values come in steps larger than the noise"
UNSTEADY = "its noise differs between rests by more than chance: heavy tails, or something shakes the phone"
TOO_SLOW = "its rate is too low to show it"
REPEATED = "many of its values repeat the one before, and their spectrum is not that of the noise"

LOW_PASS = "bandwidth"
LEVEL, UNEQUAL = OF_DENSITY = ("noise_level", "noise_unequal_axes")
"""Names of a difference between two densities of white noise: on any axes, or on one beside the others."""


def of_both(exams: Sequence[Examination]) -> list[dict[Key, Quantity]]:
    """Return white noise and low-pass of each sensor in two recordings, by effect and sensor, where shown.

    How little of either one of them has may be known only beside the other.
    """
    sides: list[dict[Key, Quantity]] = [{}, {}]
    for streams in zip(*(exam.streams for exam in exams), strict=False):
        low_passes = _low_passes(streams)
        for shown in (_levels(_as_sure(streams, low_passes)), low_passes):
            for side, quantity in zip(sides, shown, strict=True):
                if quantity is not None:
                    side[quantity.effect, quantity.sensor] = quantity
    return sides


def density(stream: Stream) -> Quantity | None:
    """Return the white noise by axis, log of densities in unit/sqrt(Hz); None where it is not shown.

    What is louder than any sensor's noise is a difference too, if it is as white and as strong in all rests.
    Beneath steps larger than it, it is known roughly (`BENEATH_STEPS`): rests differ by where between two
    steps they lie.
    """
    if stream.hidden or stream.shaken:
        return None
    if stream.silent:
        return _density(stream, np.full(3, SILENT))
    levels = stream.levels
    if levels is not None and levels.white and stream.steps.blurs_level():
        power = levels.pieces**2
        mean = np.maximum(power.mean(axis=0), SILENT**2)
        return _density(stream, np.sqrt(mean), np.hypot(BENEATH_STEPS, power.std(axis=0) / mean / 2.0))
    if levels is None or not levels.alike:
        return None
    return _density(stream, np.maximum(levels.values(), SILENT), levels.errors())


def _density(stream: Stream, values: Array, errors: Array | None = None) -> Quantity:
    """Return densities (3,) with their relative errors (3,); None where there are none above them."""
    return Quantity(
        LEVEL,
        stream.sensor,
        (Part("density", f"{UNIT[stream.sensor]}/sqrt(Hz)", 3),),
        np.log(values),
        np.diag((np.full(3, NONE_ERROR) if errors is None else errors) ** 2),
        np.full(3, TIMES),
        np.full(3, ALIKE_DENSITY),
        np.arange(3),
        logarithmic=True,
        where=Where(*stream.span, (0.0, stream.still.rate / 2.0), AT_REST),
        none=errors is None,
        error=SILENT * NONE_ERROR if errors is None else 0.0,
    )


def _as_sure(streams: Sequence[Stream], low_passes: Sequence[Quantity | None]) -> list[Stream]:
    """Return streams without a low-pass that one of two recordings alone shows, and not surely.

    Nor is it sure where the other may have it as well. What it takes off the noise would be a difference of
    the noise before it.
    """
    nats = of_one_alone(low_passes)
    every = zip(streams, low_passes, reversed(low_passes), strict=True)
    in_both = any(own is None and _within(stream, other) for stream, own, other in every)
    if in_both or (nats is not None and nats <= CERTAIN_NATS):
        return [stream.without_low_pass() for stream in streams]
    return list(streams)


def of_one_alone(low_passes: Sequence[Quantity | None]) -> float | None:
    """Return the nats for a low-pass that one of two recordings has and the other has not.

    None where both have one, or neither, or one of the two does not tell.
    """
    own, other = low_passes
    if own is None or other is None or own.none == other.none:
        return None
    return subtract(own, other).log_bayes_factor


def _levels(streams: Sequence[Stream]) -> list[Quantity | None]:
    """Return the white noise of one sensor in two recordings; None where it is not shown."""
    both = [density(stream) for stream in streams]
    every = zip(streams, both, reversed(both), strict=True)
    return [_beneath_steps(stream, other) if own is None else own for stream, own, other in every]


def _beneath_steps(stream: Stream, other: Quantity | None) -> Quantity | None:
    """Return no white noise where values at rest stay on one step, and would not with the other's noise."""
    if other is None or other.none or not stream.still.pieces or not stream.steps.still_at_rest():
        return None
    least = stream.steps.most_hidden() * np.sqrt(2.0 / stream.still.rate)
    return _density(stream, np.full(3, SILENT)) if (np.exp(other.value) > least).all() else None


def imbalance(quantity: Quantity, axis: str) -> Measured:
    """Return how an axis' density stands to that of the other two, as the logarithm of the ratio."""
    return odd_one_out(quantity.value, np.hypot(quantity.sigma, quantity.tolerance), AXES.index(axis))


def shown_ratios(quantity: Quantity, axis: str) -> tuple[Array, Array]:
    """Return densities over the geometric mean of the two axes but this one, and their errors, (3,) each."""
    logs, errors = ratios_to_others(quantity.value, quantity.sigma, AXES.index(axis))
    return np.exp(logs), np.exp(logs) * errors


def unequal(difference: Difference, axes: Sequence[str]) -> Relation | None:
    """Return how the imbalance of a simulation's axes stands to the recording's.

    axes: those on which the densities differ. None where that is not one axis alone, beside the others.
    """
    if len(axes) != 1:
        return None
    recorded, simulated = (imbalance(q, axes[0]) for q in (difference.recorded, difference.simulated))
    apart = abs(recorded.value - simulated.value)
    shown = [abs(m.value) > AXIS_SIGMA * m.error for m in (recorded, simulated)]
    if apart <= AXIS_SIGMA * np.hypot(recorded.error, simulated.error) or not any(shown):
        return None
    if not all(shown):
        return "lacking" if shown[0] else "superfluous"
    return "too_small" if abs(simulated.value) < abs(recorded.value) else "too_large"


def alike_unequal(difference: Difference) -> bool:
    """Whether both show one and the same axis of a white noise to stand apart from the other two."""
    if difference.recorded.effect != LEVEL:
        return False
    one, other = (_odd_axis(q) for q in (difference.recorded, difference.simulated))
    return one is not None and one == other


def named_unequal(difference: Difference) -> Difference:
    """Return a difference of densities under the name of their imbalance."""
    one, other = (replace(q, effect=UNEQUAL) for q in (difference.recorded, difference.simulated))
    return replace(difference, recorded=one, simulated=other)


def _odd_axis(quantity: Quantity) -> str | None:
    """Return the axis that stands farthest from the other two, if it does so beyond its error."""
    ratios = {axis: imbalance(quantity, axis) for axis in AXES}
    farthest = max(AXES, key=lambda axis: abs(ratios[axis].value))
    return farthest if abs(ratios[farthest].value) > AXIS_SIGMA * ratios[farthest].error else None


def _low_passes(streams: Sequence[Stream]) -> list[Quantity | None]:
    """Return the low-pass of one sensor in two recordings, where one of them has any.

    Where the other does not show whether it has one, only the first has the quantity. Where they filter
    other axes, it is that of the axes that only one of them filters.
    """
    filtered = [_filtered(stream) for stream in streams]
    alone = _of_one(*filtered)
    both = [_low_pass(stream, alone) for stream in streams]
    out: list[Quantity | None] = []
    for own, other, *pair in zip(both, reversed(both), streams, reversed(streams), strict=True):
        elsewhere = other is not None and not other.none
        surely_none = elsewhere and _within(pair[0], other) and _rules_out(*pair)
        out.append(own if own is not None and (not own.none or surely_none) else None)
    return out


def _rules_out(stream: Stream, other: Stream) -> bool:
    """Whether a sensor's noise is not behind the low-pass of another recording.

    Two recordings of one sensor may be just sure of its low-pass, and just not.
    """
    found = None if other.spectra is None else other.spectra.low_pass
    if found is None or stream.spectra is None or stream.silent:
        return True
    axes = [a for a in found.axes if a not in _filtered(stream)]
    return not axes or not may_be_behind(stream.spectra, found, axes)


def _filtered(stream: Stream) -> tuple[int, ...]:
    """Return the axes of a sensor that a low-pass filters."""
    found = None if stream.spectra is None else stream.spectra.low_pass
    return () if found is None else found.axes


def _of_one(one: tuple[int, ...], other: tuple[int, ...]) -> tuple[int, ...]:
    """Return the axes that only one of two recordings filters, the first's before the second's."""
    alone = [tuple(a for a in own if a not in others) for own, others in ((one, other), (other, one))]
    return alone[0] or alone[1] or one


def of_some_axes(axes: Sequence[Any]) -> bool:
    """Whether a low-pass that filters these axes leaves others as they are; none named stand for all."""
    return 0 < len(axes) < len(AXES)


def _low_pass(stream: Stream, axes: tuple[int, ...]) -> Quantity | None:
    """Return the logarithm of the cutoff on some axes, Hz; half the rate for none; None if noise hides it.

    A sensor without any noise has none: what has to be put into it has to pass the other's.
    """
    spectra, white = stream.spectra, stream.silent or (stream.levels is not None and stream.levels.white)
    if spectra is None or (spectra.low_pass is None and not white):
        return None
    found = spectra.low_pass
    own = found if found is not None and set(axes) <= set(found.axes) else None
    relative = relative_cutoff(replace(spectra, low_pass=own))
    where = Where(*stream.span, (0.0, spectra.rate / 2.0), AT_REST)
    cutoff = Measured(relative.value + float(np.log(spectra.rate)), relative.error)
    order = None if own is None else own.order
    return cutoff_quantity(stream.sensor, where, cutoff, order, axes if of_some_axes(axes) else ())


def cutoff_quantity(
    sensor: str, where: Where, cutoff: Measured, order: int | None, axes: tuple[int, ...] = ()
) -> Quantity:
    """Return a low-pass to be compared. cutoff: logarithm of Hz; order: None for no low-pass at all."""
    return Quantity(
        LOW_PASS,
        sensor,
        (Part("cutoff", "Hz", 1),),
        np.array([cutoff.value]),
        np.array([[cutoff.error**2]]),
        np.array([TIMES]),
        np.array([ALIKE_CUTOFF]),
        np.array([-1]),
        logarithmic=True,
        reference={} if order is None else {"order": order},
        where=where,
        none=order is None,
        axes=axes,
    )


def _within(stream: Stream, found: Quantity | None) -> bool:
    """Whether a sensor's rate is high enough to show a low-pass that was found in another recording."""
    return found is not None and float(np.exp(found.value[0])) < BANDWIDTH_LIMIT * stream.still.rate


def without_repeated(sides: Sequence[Mapping[Key, Quantity]]) -> list[dict[Key, Quantity]]:
    """Return both sides without the white noise and low-pass of a sensor that repeats many more values.

    Values that are repeated for one sample have more power at low and less at high frequencies. The cutoff
    that they make goes with the sample rate: where both repeat many, that of the higher rate is left out.
    Where only one shows such a cutoff, it is left out, and so is its noise, which is that before it.
    """

    def spoiled(side: Mapping[Key, Quantity], other: Mapping[Key, Quantity], key: Key) -> bool:
        shares = (one.get(("held_samples", key[1])) for one in (side, other))
        own, others = (0.0 if q is None or q.none else float(np.exp(q.value[0])) for q in shares)
        cutoffs = [one.get((LOW_PASS, key[1])) for one in (side, other)]
        unlike = _alone(*cutoffs) or (key[0] == LOW_PASS and _of_higher_rate(*cutoffs))
        return own - others >= MANY or (own >= MANY and unlike)

    return [
        {k: q for k, q in side.items() if k[0] not in (LEVEL, LOW_PASS) or not spoiled(side, other, k)}
        for side, other in zip(sides, reversed(sides), strict=True)
    ]


def _alone(own: Quantity | None, other: Quantity | None) -> bool:
    """Whether one has a cutoff and the other has none."""
    return own is not None and other is not None and not own.none and other.none


def _of_higher_rate(own: Quantity | None, other: Quantity | None) -> bool:
    """Whether a cutoff is of a wider band than the other by more than cutoffs differ."""
    ends = [q.where.band_hz[1] for q in (own, other) if q is not None and q.where is not None]
    return len(ends) == 2 and ends[0] > (1.0 + ALIKE_CUTOFF) * ends[1]


def why_not_measured(effect: str, stream: Stream, other: Quantity | None = None) -> str:
    """Say why a stream shows no quantity of its noise. other: what another recording shows of it."""
    if effect == LOW_PASS and _low_pass(stream, ()) is not None and not stream.repeats_many:
        return "its noise may be behind it as well" if _within(stream, other) else TOO_SLOW
    return why_no_density(stream)


def why_no_density(stream: Stream) -> str:
    """Say why a stream's white noise is not shown: the first reason that applies."""
    levels = stream.levels
    reasons = (
        (stream.hidden, HIDDEN),
        (stream.silent, NONE_AT_ALL),
        (stream.shaken, SHAKEN),
        (stream.repeats_many, REPEATED),
        (levels is not None and stream.steps.blurs_level(), BLURRED),
        (levels is not None and not levels.white, "its noise at rest is not white over most of the band"),
        (levels is not None, UNSTEADY),
        (
            bool(stream.still.pieces) and stream.steps.hides_noise(),
            "its values come in steps that hide the noise",
        ),
    )
    return next((why for applies, why in reasons if applies), "too little of it is at rest")
