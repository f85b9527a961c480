"""Noise and stamps of one recording as quantities that do not depend on its rate or length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.quantity import (
    Difference,
    Key,
    Part,
    Quantity,
    Relation,
    subtract,
)
from stillcal.calib_core.diagnosis.direct.repeated_values import MANY
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.likelihood import joint, log_terms, reduce_residuals
from stillcal.calib_core.diagnosis.inference.noise_models import AVERAGED, families
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import Measured, mean_of
from stillcal.calib_core.diagnosis.model.records import AXES, Where
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.diagnosis.model.settings import AXIS_SIGMA, BANDWIDTH_LIMIT
from stillcal.calib_core.diagnosis.noise.low_pass import relative_cutoff
from stillcal.calib_core.diagnosis.noise.noise_level import Levels, odd_one_out, ratios_to_others
from stillcal.calib_core.diagnosis.segments.sample_period import bunched, sample_period
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.diagnosis.stamps.timestamps import Grid
from stillcal.calib_core.diagnosis.stream import Stream
from stillcal.calib_core.streams.samples import Samples

TIMES = float(np.log(3.0))
"""Prior size of how far a simulation's noise may be off: a factor of three, as datasheets and parts are."""

ALIKE_DENSITY = float(np.log(1.05))
"""Noise densities of one phone on two days differ by some per cent with temperature and what it lies on."""

ALIKE_WANDER = float(np.log(1.4))
"""Slow noise of one phone on two days: an Allan deviation of a process with such power at low frequency."""

NEAR_LAG = (60.0, 160.0)
"""s: lags that count as `AVERAGED`, the averaging time at which slow noise is compared."""

FEWEST_PAIRS = 6
"""Pairs of bins below which their mean says little: a variance of six has a relative error of 0.6."""

SILENT = 1e-12
"""Density below which samples have no noise at all, only rounding of double precision, as simulations may."""

ALIKE_CUTOFF = 0.05
"""Relative difference of two cutoffs that is none: they depend on the shape that is fitted."""

LOW_PASS = "bandwidth"
MOVED, SHAKEN = 4.0, 100.0
"""How many times the variance of its bin a mean has where what it lies on moves, and how many times that of
the sensor's own white noise: no wander is ten times as loud within 2 s."""

BARELY = 2.0
"""Times the variance of white noise below which no other noise is beside it."""

NONE_AT_ALL = "it has no noise at all"
BLURRED = "its values come in steps larger than the noise"
REPEATED = "many of its values repeat the one before, and their spectrum is not that of the noise"
OF_NO_NAME = "what has no name is most of it, and its form is known to a tenth"
KNOWN_FORM = float(np.log(10.0))
"""Of what has no name less than a tenth may be left because its form is not quite right, and is no noise."""

LEVEL, UNEQUAL = OF_DENSITY = ("noise_level", "noise_unequal_axes")
"""Names of a difference between two densities of white noise: on any axes, or on one beside the others."""

Pairs = tuple[NDArray[np.int64], NDArray[np.int64]]
SAME_ATTITUDE = 0.9
"""Least correlation of a bias in two bins (cosine of the angle between attitudes) to compare them."""

LEAST_SPREAD = 0.15
"""The strengths of wander are tried a quarter decade of variance apart: no deviation is known better (ln)."""

ALIKE_RATE = 2e-3
"""Relative difference of sample rates that two recordings of one phone may have: nominal rates are round."""

PIECES = 40
LEAST_RATE_ERROR = 1e-6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SlowNoise(Quantity):
    """Slow noise as one recording shows it. white: (k,) what white noise makes of its variance."""

    white: Array

    def beside(self, other: SlowNoise) -> SlowNoise:
        """Return it as it would be with as much white noise as another recording has, if that has more."""
        own = np.exp(2.0 * self.value)
        all_of_it = own + np.maximum(other.white - self.white, 0.0)
        part = own / all_of_it
        return replace(self, value=0.5 * np.log(all_of_it), covariance=self.covariance * np.outer(part, part))


def difference_of(recorded: Quantity, simulated: Quantity) -> Difference:
    """Return the difference of one quantity in two recordings.

    That of slow noise is judged beside the larger of their white noises, of which it is a part: a simulation
    without any noise lacks the white noise alone, if the recording has no more.
    """
    own = subtract(recorded, simulated)
    if not isinstance(recorded, SlowNoise) or not isinstance(simulated, SlowNoise):
        return own
    fair = subtract(recorded.beside(simulated), simulated.beside(recorded))
    return replace(own, log_bayes_factor=fair.log_bayes_factor, of_usual_size=fair.of_usual_size)


def density(stream: Stream) -> Quantity | None:
    """Return the white noise by axis, log of densities in unit/sqrt(Hz); None where it is not shown."""
    if not stream.silent and (stream.levels is None or not stream.levels.own):
        return None
    values = np.full(3, SILENT) if stream.levels is None else stream.levels.values()
    errors = np.full(3, LEAST_SPREAD) if stream.levels is None else stream.levels.errors()
    return Quantity(
        LEVEL,
        stream.sensor,
        (Part("density", f"{UNIT[stream.sensor]}/sqrt(Hz)", 3),),
        np.log(np.maximum(values, SILENT)),
        np.diag(errors**2),
        np.full(3, TIMES),
        np.full(3, ALIKE_DENSITY),
        np.arange(3),
        logarithmic=True,
        where=Where(*_span(stream.samples), (0.0, stream.still.rate / 2.0), "noise at rest"),
        none=stream.silent,
    )


def densities(exam: Examination) -> dict[Key, Quantity]:
    """Return the white noise of each sensor that shows it, by effect and sensor."""
    shown = (density(stream) for stream in exam.streams)
    return {(level.effect, level.sensor): level for level in shown if level is not None}


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


def low_passes(exams: Sequence[Examination]) -> list[dict[Key, Quantity]]:
    """Return the low-pass of each sensor in two recordings, by effect and sensor, where one of them has any.

    Where the other does not show whether it has one, only the first has the quantity.
    """
    sides: list[dict[Key, Quantity]] = [{}, {}]
    for streams in zip(*(exam.streams for exam in exams), strict=False):
        both = [_low_pass(stream) for stream in streams]
        for side, own, other, stream in zip(sides, both, both[::-1], streams, strict=True):
            elsewhere = other is not None and not other.none
            seen = own is not None and (not own.none or (elsewhere and _within(stream, other)))
            if own is not None and seen:
                side[LOW_PASS, stream.sensor] = own
    return sides


def _low_pass(stream: Stream) -> Quantity | None:
    """Return the logarithm of the cutoff, Hz; half the rate where there is none; None if noise hides it."""
    spectra = stream.spectra
    if spectra is None or (spectra.low_pass is None and (stream.levels is None or not stream.levels.white)):
        return None
    cutoff = relative_cutoff(spectra)
    return Quantity(
        LOW_PASS,
        stream.sensor,
        (Part("cutoff", "Hz", 1),),
        np.array([cutoff.value + np.log(spectra.rate)]),
        np.array([[cutoff.error**2]]),
        np.array([TIMES]),
        np.array([ALIKE_CUTOFF]),
        np.array([-1]),
        logarithmic=True,
        reference={} if spectra.low_pass is None else {"order": spectra.low_pass.order},
        where=Where(*_span(stream.samples), (0.0, spectra.rate / 2.0), "noise at rest"),
        none=spectra.low_pass is None,
    )


def without_repeated(sides: Sequence[Mapping[Key, Quantity]]) -> list[dict[Key, Quantity]]:
    """Return both sides without the white noise and low-pass of a sensor that repeats many more values.

    Values that are repeated for one sample have more power at low and less at high frequencies.
    """

    def more(side: Mapping[Key, Quantity], other: Mapping[Key, Quantity], sensor: str) -> bool:
        shares = (one.get(("held_samples", sensor)) for one in (side, other))
        own, others = (0.0 if q is None or q.none else float(np.exp(q.value[0])) for q in shares)
        return own - others >= MANY

    return [
        {k: q for k, q in side.items() if k[0] not in (LEVEL, LOW_PASS) or not more(side, other, k[1])}
        for side, other in zip(sides, reversed(sides), strict=True)
    ]


def _within(stream: Stream, found: Quantity | None) -> bool:
    """Whether a sensor's rate is high enough to show a low-pass that was found in another recording."""
    return found is not None and float(np.exp(found.value[0])) < BANDWIDTH_LIMIT * stream.still.rate


def why_not_measured(effect: str, stream: Stream) -> str:
    """Say why a stream shows no quantity of its noise."""
    if effect == LOW_PASS and _low_pass(stream) is not None and not stream.repeats_many:
        return "its rate is too low to show it"
    return why_no_density(stream)


def why_no_density(stream: Stream) -> str:
    """Say why a stream's white noise is not shown."""
    if stream.silent:
        return NONE_AT_ALL
    if stream.repeats_many:
        return REPEATED
    if stream.levels is not None and stream.steps.blurs_level():
        return BLURRED
    if stream.levels is not None and not stream.levels.white:
        return "its noise at rest is not white over most of the band"
    if stream.levels is not None:
        return (
            "its noise is louder than any sensor's, or differs between rests by more than chance:"
            " heavy tails, or something shakes the phone"
        )
    if stream.still.pieces and stream.steps.hides_noise():
        return "its values come in steps that hide the noise"
    return "too little of it is at rest"


def why_no_slow_noise(exam: Examination, residuals: SensorResiduals) -> str | None:
    """Say what hides a sensor's wander at rest; None where nothing does.

    Steps larger than the noise leave errors in means.
    """
    if any(s.sensor == residuals.sensor and s.steps.blurs_level() for s in exam.streams):
        return BLURRED
    if moves(exam, residuals.sensor):
        return "what it lies on moves"
    found = _found(exam, residuals)
    named = [h for h in found if h.effect.name != "unknown"]
    if len(named) == len(found):
        return None
    left, whole = (_deviations(residuals, known) for known in (found, named))
    hidden = any(b[0] - a[0] > KNOWN_FORM for a, b in zip(left, whole, strict=True))
    return OF_NO_NAME if hidden else None


def moves(exam: Examination, sensor: str) -> bool:
    """Whether what the phone lies on moves more than a sensor's bias may wander."""
    levels = next((s.levels for s in exam.streams if s.sensor == sensor), None)
    return any(hidden_by_motion(r, levels) for r in exam.sensors if r.sensor == sensor and len(r.bins))


def hidden_by_motion(residuals: SensorResiduals, levels: Levels | None = None) -> bool:
    """Whether motion of what the phone lies on makes most of the variance of a sensor's means.

    It is known as the support's, or is far above what the sensor's noise, `levels`, makes of a mean.
    """
    bins = residuals.bins
    seen = bins.rate_variance if residuals.sensor == "gyro" else bins.force_variance
    assert seen is not None, "a sensor that was recorded"
    largest = seen.max(axis=1)
    if levels is not None and levels.own:
        white = 0.5 * float(levels.values().max()) ** 2 / bins.duration
        if float(np.median(largest / white)) > SHAKEN:
            return True
    return any(
        float(np.median(v.variance)) > MOVED * float(np.median(largest[v.bins]))
        for v in residuals.views
        if v.name != "tangent"
    )


def slow_noise(
    exam: Examination, residuals: SensorResiduals, asked: Sequence[Hypothesis] = ()
) -> SlowNoise | None:
    """Return the Allan deviation of the bias at `AVERAGED`, logarithms; None without rests that long.

    None as well where something hides it (`why_no_slow_noise`). A sensor without any noise has no slow noise
    where it is that of the white noise which was added.

    It is averaged over the noise shapes by their posterior, the effects that were found and those `asked` for
    taken out first.
    """
    if why_no_slow_noise(exam, residuals):
        return None
    explained = _found(exam, residuals)
    own = {h.effect.name for h in explained}
    explained += [h for h in asked if h.effect.name not in own]
    views = [view for view in residuals.views if view.name != "tangent"]
    shown = _deviations(residuals, explained)
    if len(shown) < len(views):
        return None
    value, error = np.array(shown).T
    white = np.array([_white(view) for view in views])
    silent = any(s.silent for s in exam.streams if s.sensor == residuals.sensor)
    return SlowNoise(
        f"{residuals.sensor}_slow_noise",
        residuals.sensor,
        (Part("allan_deviation_100s", UNIT[residuals.sensor], value.size),),
        value,
        np.diag(error**2),
        np.full(value.size, TIMES),
        np.full(value.size, ALIKE_WANDER),
        np.arange(3) if value.size == 3 else np.array([-1]),
        logarithmic=True,
        reference={"averaging_s": AVERAGED},
        where=Where(*residuals.bins.span, (0.0, 1.0 / AVERAGED), "nothing"),
        none=silent and bool((np.exp(2.0 * value) < BARELY * white).all()),
        white=white,
    )


def _found(exam: Examination, residuals: SensorResiduals) -> list[Hypothesis]:
    """Return what was found in a sensor's residuals."""
    own = (s for s in exam.statements if s.residuals is residuals)
    return [s.hypothesis for s in own if s.hypothesis is not None]


def _deviations(residuals: SensorResiduals, explained: Sequence[Hypothesis]) -> list[tuple[float, float]]:
    """Return mean and standard deviation of the log of the Allan deviation of each view that shows it."""
    reduced = reduce_residuals(residuals, found=explained)
    _, weights = joint(reduced, [log_terms(v, v.left) for v in reduced])
    every = zip(residuals.views, reduced, weights, strict=True)
    shown = (_deviation(v, sums, weight) for v, sums, weight in every if v.name != "tangent")
    return [deviation for deviation in shown if deviation is not None]


def _deviation(view: View, sums: Reduced, weight: Array) -> tuple[float, float] | None:
    """Return mean and standard deviation of the log of the Allan deviation, over the shapes (G,)."""
    pairs = _pairs(view)
    if pairs is None:
        return None
    moved = float(np.mean(view.rest[pairs[0]] != view.rest[pairs[1]]))
    variances = [_white(view) + family.allan + moved * family.jump for family in families(view)]
    scale = (sums.known + sums.left) / max(sums.dof - 2.0, 1.0)
    logs = 0.5 * np.log(np.concatenate(variances) * scale)
    middle = float(weight @ logs)
    return middle, float(np.hypot(np.sqrt(weight @ (logs - middle) ** 2), LEAST_SPREAD))


def _white(view: View) -> float:
    """Return the variance of a mean over `AVERAGED` by white noise alone."""
    return float(np.median(view.variance * view.duration)) / AVERAGED


def _pairs(view: View) -> Pairs | None:
    """Return the pairs of bins that are `AVERAGED` apart and see the same bias; None where they are few."""
    lag = view.t[None, :] - view.t[:, None]
    alike = np.broadcast_to(view.coupling, lag.shape) > SAME_ATTITUDE
    rows = np.argwhere((lag > NEAR_LAG[0]) & (lag < NEAR_LAG[1]) & alike)
    first, second = rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64)
    return (first, second) if first.size >= FEWEST_PAIRS else None


def rate(samples: Samples) -> Quantity:
    """Return the logarithm of the sensor's rate.

    Samples that are missing count, for they were measured; stamps in bursts are counted over time.
    """
    if bunched(samples.t):
        pieces = [p for p in np.array_split(samples.t, PIECES) if p.size > 1 and p[-1] > p[0]]
        mean = mean_of(-np.log([sample_period(p) for p in pieces]), LEAST_RATE_ERROR)
    else:
        grid = Grid.of(samples.t, sample_period(samples.t))
        mean = grid.mean_rate(min(PIECES, len(samples) - 1), LEAST_RATE_ERROR)[0]
    return Quantity(
        "sample_rate",
        "timing",
        (Part("rate", "Hz", 1),),
        np.array([mean.value]),
        np.array([[mean.error**2]]),
        np.array([TIMES]),
        np.array([ALIKE_RATE]),
        np.array([-1]),
        logarithmic=True,
        where=Where(*_span(samples), (0.0, 0.0), "time stamps"),
    )


def exactly_even(t: Array) -> bool:
    """Whether stamps t (n,) are multiples of one interval to rounding: computed, not taken from a clock."""
    steps = np.diff(t)
    return bool(np.ptp(steps) < 1e-9 * max(float(np.abs(t).max()), 1.0))


def _span(samples: Samples) -> tuple[float, float]:
    return float(samples.t[0]), float(samples.t[-1])
