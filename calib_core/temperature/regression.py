"""Regression of a bias on temperature and time: a polynomial of temperature, and a bias that wanders.

bias(T, t) = b + c1 u + c2 u^2 + c3 u^3 + w(t), u = (T - reference) / 10 K

The coefficients have a Gaussian prior, so that a curve stays near a line until the rests say otherwise. w is
flicker (a bank of Gauss-Markov processes) and a random walk, whose sizes are those of greatest likelihood
under weak priors. This is Gaussian-process regression (Rasmussen and Williams 2006, sections 2.2 and 2.7).
Its Cholesky factor holds, for each rest, the error of predicting it from the rests before it: the evidence
for the curve is taken from these errors.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.temperature.wander import Spans, Wander

UNIT_K = 10.0
"""K: coefficients count from the reference in units of this."""

POWERS = 3


@dataclass(frozen=True, slots=True)
class Priors:
    """What is known of a kind of sensor before its rests, in its unit.

    curve: standard deviations of c1, c2, c3. white, flicker, walk: medians of the scatter of single rests, of
    each process of the flicker's bank, and of the walk of a day; `spread` is their standard deviation in
    natural logarithms. step: standard deviation of a step, as a knock leaves it, before any rest shows more.
    """

    curve: tuple[float, float, float]
    white: float
    flicker: float
    walk: float
    step: float
    spread: float = 1.5


MG, DEG = STANDARD / 1000, np.pi / 180
ACCELEROMETER = Priors((8 * MG, 1.5 * MG, 0.5 * MG), 0.05 * MG, 0.03 * MG, 0.1 * MG, 10 * MG)
GYROSCOPE = Priors((0.3 * DEG, 0.05 * DEG, 0.02 * DEG), 5e-4 * DEG, 1.5e-3 * DEG, 5e-3 * DEG, 0.3 * DEG)
"""Data sheets of phones' parts: 0.2 to 1 mg/K, 0.01 to 0.03 deg/s/K (Bosch BMI160, BMI270; InvenSense)."""


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Rests as a regression sees them, oldest first.

    t: (n,) s. celsius: (n,) degC, NaN where unknown. value: (n, k), k biases that share one model, or k = 1
    where each rest shows only the component along `towards` (n, 3). sd: (n,), as the rests state it. level:
    (n, p) what is unknown besides, the bias first, with prior standard deviations level_sd (p,). more: (n,)
    uncertainty beyond that of the rest itself. near: (n, 3) biases about which rests were made
    linear. linear: makes value, level and towards for other ones, None where nothing needs it.
    """

    t: Array
    celsius: Array
    value: Array
    sd: Array
    level: Array
    level_sd: Array
    towards: Array | None = None
    more: Array | float = 0.0
    linear: Callable[[Array], tuple[Array, Array, Array]] | None = None
    near: Array | float = 0.0
    spans: Spans | None = None

    def about(self, biases: Array) -> Observations:
        """Return the observations made linear about biases (n, 3), one for each rest."""
        if self.linear is None:
            return self
        value, level, towards = self.linear(biases)
        return replace(self, value=value, level=level, towards=towards, near=biases)

    def less(self, offset: Array) -> Observations:
        """Return the observations of the bias without an offset (n, 3) that is known."""
        linear, towards = self.linear, self.towards
        if linear is None or towards is None:
            return replace(self, value=self.value - offset)

        def without(biases: Array) -> tuple[Array, Array, Array]:
            value, level, along = linear(biases + offset)
            return value - (offset * along).sum(axis=1)[:, None], level, along

        value = self.value - (offset * towards).sum(axis=1)[:, None]
        return replace(self, value=value, linear=without, near=self.near - offset)

    def wider(self, more: Array) -> Observations:
        """Return the observations with rests uncertain by `more` (n,) beyond what they state."""
        return replace(self, more=np.hypot(self.more, more))

    def doubting(self, row: int, sd: float) -> Observations:
        """Return the observations with one rest uncertain by `sd` more."""
        return self.wider(np.where(np.arange(len(self.sd)) == row, sd, 0.0))

    def variances(self, wander: Wander) -> Array:
        """Return the variance of each rest about the wandering bias, (n,)."""
        return np.asarray((wander.declared * self.sd) ** 2 + np.square(self.more) + wander.white**2)


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the bias. t: s, of the first rest after it. sd: its standard deviation by axis."""

    t: float
    sd: float


@dataclass(frozen=True, slots=True)
class Model:
    """What is to be fitted.

    reference: degC, from which the curve counts. with_curve: whether there is a curve.
    priors: of the kind of sensor.
    """

    priors: Priors
    reference: float
    with_curve: bool


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A regression's result.

    seen: the observations that it is of, made linear and with its doubts. model: what was fitted. wander:
    that of greatest likelihood. log_likelihood: of it, prior included. errors: (n, k), of predicting each
    rest from those before it, and errors_sd (n,). level: (p, k) what is unknown besides the curve, its bias
    as it is now; curve: (3, 3) c1, c2, c3 by axis. covariance: of level and then the curve, axes innermost.
    course: (n, 3) the bias at every rest, in excess of what the values count from; empty where each rest
    shows all of it. steps: where the bias stepped. doubted: rows of rests that disagree with those before
    and after them.
    """

    seen: Observations
    model: Model
    wander: Wander
    log_likelihood: float
    errors: Array
    errors_sd: Array
    level: Array
    curve: Array
    covariance: Array
    course: Array = field(default_factory=lambda: frozen(np.empty((0, 3))))
    steps: tuple[Step, ...] = ()
    doubted: tuple[int, ...] = ()

    @property
    def bias(self) -> Array:
        """The bias at the reference temperature now, (3,), in excess of what the values count from."""
        return frozen(self.level[0] if self.level.shape[1] == 3 else self.level[:3, 0])

    @property
    def bias_covariance(self) -> Array:
        """The covariance (12, 12) of bias and curve, axes innermost."""
        if self.level.shape[1] == 3:
            return frozen(np.kron(self.covariance, np.eye(3)))
        p = len(self.level)
        rows = np.r_[0:3, p : len(self.covariance)]
        return frozen(self.covariance[np.ix_(rows, rows)])


def curve_basis(celsius: Array, reference: float) -> Array:
    """Return u, u^2, u^3 at temperatures (n,), degC: (n, 3); zero where the temperature is unknown."""
    u = np.nan_to_num((celsius - reference) / UNIT_K)
    return np.column_stack([u**power for power in range(1, POWERS + 1)])


def _shapes() -> tuple[Array, ...]:
    """Return the shapes of a wander that are tried, (3, 3) each, in units of one that is alike on all axes.

    After the one that is alike on all axes come those mostly along one line: 20 lines spread evenly over a
    half sphere (Fibonacci's spiral), three sizes of each.
    """
    k = np.arange(20)
    z, turn = (k + 0.5) / 20, np.pi * (1.0 + np.sqrt(5.0)) * (k + 0.5)
    level = np.sqrt(1.0 - z * z)
    lines = np.column_stack((level * np.cos(turn), level * np.sin(turn), z))
    along = [0.1 * np.eye(3) + 2.7 * np.outer(line, line) for line in lines]
    return (np.eye(3), *(size**2 * shape for size in (1.0, 2.0, 4.0) for shape in along))


_SHAPES = _shapes()
_EVEN = _SHAPES[0]
_LEAST_WEIGHT = 1e-3
"""Shapes of a smaller weight than this are left out."""

_USUALLY_DECLARED, _DECLARED_SPREAD = 0.75, 0.4
"""Median of Wander.declared, and its standard deviation in natural logarithms."""

_BORDER = 1e30
"""Any number above the sum of squares of whitened values."""


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    """A wander with its score and what it was judged by.

    factor: (n, n) the Cholesky factor L of the covariance of all values, None where that has none; whitened:
    (n, k) L^-1 value.
    """

    wander: Wander
    score: float
    factor: Array | None
    whitened: Array


class Regression:
    """The regression of one set of observations, with or without a curve of temperature."""

    def __init__(self, seen: Observations, model: Model) -> None:
        self._spans = seen.spans or Spans(seen.t)
        self._seen, self._priors, self._model = seen, model.priors, model
        basis = curve_basis(seen.celsius, model.reference)
        if seen.towards is not None:
            basis = (basis[:, :, None] * seen.towards[:, None, :]).reshape(len(basis), -1)
        axes = 1 if seen.towards is None else 3
        prior = np.repeat(model.priors.curve, axes) * float(model.with_curve)
        self._design = np.hstack((seen.level, basis))
        self._prior = np.concatenate((seen.level_sd, prior)) ** 2
        self._fixed = (self._design * self._prior) @ self._design.T
        self._shared = 1.0 if seen.towards is None else seen.towards @ seen.towards.T
        self._start = float(seen.t[0])
        self._flicker = self._spans.flicker * self._shared
        self._walk = self._spans.walk * self._shared
        self._room = np.empty_like(self._walk)
        self._axes = axes

    def fit(
        self,
        now: float,
        steps: tuple[Step, ...] = (),
        start: Wander | None = None,
        search: bool = True,
    ) -> Fit:
        """Fit, with the bias stepping at times `steps`.

        now: s, the time that the bias is wanted for. start: where the search for the wander begins; without
        a search, that is the wander.
        """
        best = self._likeliest(steps, start) if search or start is None else self._judged(start, steps)
        if best.factor is None:
            raise np.linalg.LinAlgError("the covariance of the rests is not positive definite")
        wander, factor, whitened = best.wander, best.factor, best.whitened
        diagonal = np.diag(factor)
        mean, covariance = self._present(best, _EVEN, now, steps)
        p = self._seen.level.shape[1]
        return Fit(
            self._seen,
            self._model,
            wander,
            best.score,
            frozen(whitened * diagonal[:, None]),
            frozen(diagonal),
            frozen(mean[:p]),
            frozen(mean[p:].reshape(-1, 3)),
            frozen(covariance),
            self._course(wander, factor, whitened, steps),
            steps,
        )

    def averaged(self, fit: Fit, now: float) -> Fit:
        """Return a fit of rests that show one direction each, as `averaged` does. now: s."""
        seen = self._seen
        likely = [(w, *self._present(*own, now, fit.steps)) for w, own in self._likely_shapes(fit)]
        mean = np.sum([weight * at for weight, at, _ in likely], axis=0)
        spread = [weight * (own + (at - mean) @ (at - mean).T) for weight, at, own in likely]
        covariance = np.sum(spread, axis=0)
        p = seen.level.shape[1]
        return replace(
            fit, level=frozen(mean[:p]), curve=frozen(mean[p:].reshape(-1, 3)), covariance=frozen(covariance)
        )

    def _likely_shapes(self, fit: Fit) -> list[tuple[float, tuple[_Judged, Array]]]:
        """Return the shapes of the wander that the rests allow, each with its weight and its factor."""
        wander, towards = fit.wander, self._seen.towards
        assert towards is not None
        moved = wander.flicker**2 * self._spans.flicker + wander.walk**2 * self._spans.walk
        without = np.empty_like(moved)
        self._fill_covariance(without, wander, fit.steps)
        without -= moved * self._shared
        tried, scores = [], []
        for shape in _SHAPES:
            with contextlib.suppress(np.linalg.LinAlgError):
                across = towards @ shape @ towards.T
                factor, whitened = _factor(without + moved * across, self._seen.value)
                likelihood = -0.5 * (whitened**2).sum() - np.log(np.diag(factor)).sum()
                scores.append(likelihood - np.log(1 if shape is _EVEN else len(_SHAPES) - 1))
                tried.append((_Judged(wander, scores[-1], factor, whitened), shape))
        weights = np.exp(np.array(scores) - max(scores))
        kept = weights >= _LEAST_WEIGHT
        weights /= weights[kept].sum()
        return [(float(w), own) for w, own, keep in zip(weights, tried, kept, strict=True) if keep]

    def log_likelihood(self, wander: Wander, steps: tuple[Step, ...]) -> float:
        """Return that of the fit with this wander and these steps, without making the fit."""
        return self._judged(wander, steps).score

    def _fill_covariance(self, total: Array, wander: Wander, steps: tuple[Step, ...]) -> None:
        """Write the covariance of all values into `total` (n, n)."""
        np.multiply(self._flicker, wander.flicker**2, out=total)
        total += self._fixed
        total += np.multiply(self._walk, wander.walk**2, out=self._room)
        for step in steps:
            after = (self._seen.t >= step.t).astype(float)
            total += step.sd**2 * np.outer(after, after) * self._shared
        np.einsum("ii->i", total)[:] += self._seen.variances(wander)

    def _course(self, wander: Wander, factor: Array, whitened: Array, steps: tuple[Step, ...]) -> Array:
        """Return the bias (n, 3) at every rest that shows one direction of it, as all rests show it."""
        seen = self._seen
        if seen.towards is None:
            return frozen(np.empty((0, 3)))
        basis = curve_basis(seen.celsius, self._model.reference) * self._model.with_curve
        shared = seen.level_sd[0] ** 2 + (basis * np.square(self._priors.curve)) @ basis.T
        shared = shared + wander.over(self._spans)
        for step in steps:
            after = (seen.t >= step.t).astype(float)
            shared = shared + step.sd**2 * np.outer(after, after)
        weights = np.linalg.solve(factor.T, whitened)
        return frozen(shared @ (weights * seen.towards))

    def _factor(self, wander: Wander, steps: tuple[Step, ...]) -> tuple[Array, Array]:
        """Return the Cholesky factor L of the covariance and L^-1 value, both from one decomposition."""
        n = len(self._seen.value)
        total = np.empty((n, n))
        self._fill_covariance(total, wander, steps)
        return _factor(total, self._seen.value)

    def _judged(self, wander: Wander, steps: tuple[Step, ...]) -> _Judged:
        """Return a wander whose score is the log likelihood of the rests plus its own log prior."""
        try:
            factor, whitened = self._factor(wander, steps)
        except np.linalg.LinAlgError:
            return _Judged(wander, -np.inf, None, np.empty((0, 0)))
        columns = whitened.shape[1]
        likelihood = -0.5 * float((whitened**2).sum()) - columns * float(np.log(np.diag(factor)).sum())
        score = float(likelihood - 0.5 * (self._places(wander) ** 2).sum())
        return _Judged(wander, score, factor, whitened)

    def _places(self, wander: Wander) -> Array:
        p = self._priors
        day = p.walk / np.sqrt(86400.0)
        ratios = np.array([wander.white / p.white, wander.flicker / p.flicker, wander.walk / day])
        declared = np.log(wander.declared / _USUALLY_DECLARED) / _DECLARED_SPREAD
        return np.append(np.log(ratios) / p.spread, declared)

    def _likeliest(self, steps: tuple[Step, ...], start: Wander | None) -> _Judged:
        """Return the wander of greatest posterior, by a search along its logarithms."""
        p = self._priors
        best = self._judged(start or Wander(p.white, p.flicker, p.walk / np.sqrt(86400.0)), steps)
        known = {best.wander}
        for factor in (2.0, 1.4) if start else (4.0, 2.0, 1.4):
            for _ in range(3):
                before = best
                for name in ("white", "flicker", "walk", "declared"):
                    for by in (factor, 1 / factor):
                        tried = replace(best.wander, **{name: getattr(best.wander, name) * by})
                        if tried.declared > 1.0 or tried in known:
                            continue
                        known.add(tried)
                        if (other := self._judged(tried, steps)).score > best.score:
                            best = other
                            break
                if best is before:
                    break
        return best

    def _present(
        self, judged: _Judged, shape: Array, now: float, steps: tuple[Step, ...]
    ) -> tuple[Array, Array]:
        """Return level now and curve, and their covariance. shape: (3, 3) of the wander, one of _SHAPES."""
        assert judged.factor is not None
        wander, factor, whitened = judged.wander, judged.factor, judged.whitened
        seen, axes, at = self._seen, self._axes, np.array([now - self._start])
        along = wander.covariance(at, seen.t - self._start)[0]
        stepped = sum((step.sd**2 * (seen.t >= step.t) for step in steps), np.zeros(len(seen.t)))
        cross = self._prior[:, None] * self._design.T
        if seen.towards is None:
            cross[:axes] += along + stepped
        else:
            cross[:axes] += along * (seen.towards @ shape).T + stepped * seen.towards.T
        prior = np.diag(self._prior)
        prior[:axes, :axes] += float(wander.covariance(at, at)[0, 0]) * shape[:axes, :axes]
        prior[:axes, :axes] += sum(step.sd**2 for step in steps) * np.eye(axes)
        gain = np.linalg.solve(factor, cross.T)
        covariance: Array = prior - gain.T @ gain
        return gain.T @ whitened, covariance


def averaged(fit: Fit, now: float) -> Fit:
    """Return a fit with level and curve averaged over the lines along which the bias may wander.

    Temperature moves a bias along one line. An attitude shows one direction of that only, so that a phone
    that always lies alike shows little of a wander that may be large. The weights are the likelihoods;
    a wander that is alike on all axes counts for one half before. now: s, as of the fit.
    """
    return fit if fit.seen.towards is None else Regression(fit.seen, fit.model).averaged(fit, now)


def _factor(total: Array, value: Array) -> tuple[Array, Array]:
    """Return the Cholesky factor L of a covariance (n, n) and L^-1 value (n, k), from one decomposition."""
    n, k = value.shape
    bordered = np.empty((n + k, n + k))
    bordered[:n, :n] = total
    bordered[:n, n:] = 0.0
    bordered[n:, :n] = value.T
    bordered[n:, n:] = _BORDER * np.eye(k)
    factor = np.linalg.cholesky(bordered)
    return factor[:n, :n], factor[n:, :n].T
