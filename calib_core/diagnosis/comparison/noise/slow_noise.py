"""Slow noise of a recording, the wander of a bias at rest, as a quantity; and what hides it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import BLURRED
from stillcal.calib_core.diagnosis.comparison.quantity import TIMES, Difference, Part, Quantity, subtract
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.likelihood import joint, log_terms, reduce_residuals
from stillcal.calib_core.diagnosis.inference.noise_models import AVERAGED, families
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.diagnosis.noise.noise_level import Levels
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.diagnosis.slow.wander import WALK

ALIKE_WANDER = float(np.log(1.4))
"""Slow noise of one phone on two days: an Allan deviation of a process with such power at low frequency."""

NEAR_LAG = (60.0, 160.0)
"""s: lags that count as `AVERAGED`, the averaging time at which slow noise is compared."""

FEWEST_PAIRS = 6
"""Pairs of bins below which their mean says little: a variance of six has a relative error of 0.6."""

MOVED, SHAKEN = 4.0, 100.0
"""How many times the variance of its bin a mean has where what it lies on moves, and how many times that of
the sensor's own white noise: no wander is ten times as loud within 2 s."""

BARELY = 2.0
"""Times the variance of white noise below which no other noise is beside it."""

OF_NO_NAME = "what has no name is most of it, and its form is known to a tenth"
KNOWN_FORM = float(np.log(10.0))
"""Of what has no name less than a tenth may be left because its form is not quite right, and is no noise."""

Pairs = tuple[NDArray[np.int64], NDArray[np.int64]]
SAME_ATTITUDE = 0.9
"""Least correlation of a bias in two bins (cosine of the angle between attitudes) to compare them."""

LEAST_SPREAD = 0.15
"""The strengths of wander are tried a quarter decade of variance apart: no deviation is known better (ln)."""


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


def by_name(difference: Difference, exams: Sequence[Examination]) -> Difference:
    """Return a difference of slow noise as one of random walks, where the recording that has more states one.

    Where the two agree both have to. One that states none, and has less than a third, is as good as without.
    """
    own, other = difference.recorded, difference.simulated
    if not isinstance(own, SlowNoise) or not isinstance(other, SlowNoise):
        return difference
    stated = [_states_walk(exam, own.sensor) for exam in exams]
    if not (all(stated) if difference.agrees else stated[int(difference.value.sum() < 0.0)]):
        return difference
    recorded, simulated = _as_walk(own), _as_walk(other)
    apart = recorded.value - simulated.value
    least = abs(float(apart.mean())) > TIMES
    return replace(
        difference,
        recorded=replace(recorded, none=recorded.none or (least and not stated[0])),
        simulated=replace(simulated, none=simulated.none or (least and not stated[1])),
        value=apart,
        covariance=recorded.covariance + simulated.covariance,
    )


def _states_walk(exam: Examination, sensor: str) -> bool:
    """Whether a recording by itself shows a random walk of a sensor's bias, under that name."""
    return any(s.finding.effect == f"{sensor}{WALK}" for s in exam.statements)


def _as_walk(seen: SlowNoise) -> Quantity:
    """Return the density of the random walk with this slow noise, on each axis.

    The Allan variance at tau of a walk of density N is N^2 tau / 3 (IEEE Std 952-1997, Annex C). That of
    white noise is beside it, and is never taken for more than nine tenths of what is seen.
    """
    whole = np.exp(2.0 * seen.value)
    own = np.maximum(whole - seen.white, 0.1 * whole)
    value, spread = 0.5 * np.log(3.0 * own / AVERAGED), seen.sigma * whole / own
    covariance = np.diag(spread**2)
    if value.size == 1:
        value, covariance = np.full(3, value[0]), np.full((3, 3), covariance[0, 0])
    return Quantity(
        f"{seen.sensor}{WALK}",
        seen.sensor,
        (Part("density", f"{UNIT[seen.sensor]}/sqrt(s)", 3),),
        value,
        covariance,
        np.full(3, TIMES),
        np.full(3, ALIKE_WANDER),
        np.arange(3),
        logarithmic=True,
        where=seen.where,
        none=seen.none,
    )


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
    own = [r for r in exam.sensors if r.sensor == sensor and len(r.bins)]
    return any(hidden_by_motion(r, levels) or r.bins.swings for r in own)


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
    """Return what was found in a sensor's residuals, what is the error of a name's model with it."""
    return [h for s in exam.statements if s.residuals is residuals for h in s.fitted]


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
