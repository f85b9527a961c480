"""Effects of the rate of turn, estimated about the rate without them.

What a nonlinear gyroscope adds goes with powers of the true rate, and the search takes the rate that was read
for it: where an effect is a twentieth of the rate, its cube is larger by a sixth there, and the size found
as much too small. Here the effect is taken off the rates, what is left of it is estimated, and so again until
nothing is left (Gauss-Newton).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.moments import turning
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned
from stillcal.calib_core.diagnosis.segments.turns import Rates
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, estimate, parameters
from stillcal.calib_core.diagnosis.slow.statement import Stated, sentence
from stillcal.calib_core.streams.samples import Samples

ROUNDS = 10
"""Most times that what is left is estimated; each leaves a fifth, or less, of what the one before left."""

SETTLED = 0.1
"""Standard errors by which sizes still change that are no change."""

HALVINGS = 12
"""Half-steps to the rate that, with the effect at that rate, is the one read: an effect a third as large as
the rate itself is still followed."""


@dataclass(frozen=True, slots=True, eq=False)
class OffTurns:
    """The gyroscope's samples without effects of the rate itself.

    rates: what else is taken off; affine: the bias and the mapping that make a rate of what is left;
    residuals: the turns; found, values: the effects, and the sizes (k,) of each, SI.
    """

    rates: Rates
    affine: Aligned
    residuals: SensorResiduals
    found: Sequence[Hypothesis]
    values: Sequence[Array]

    def __call__(self, samples: Samples) -> Array:
        """Return the rate (n, 3) of some of the gyroscope's samples, rad/s.

        OverflowError: where no rate with the effect at that rate is the one read.
        """
        read = self.rates(samples)
        error = np.zeros_like(read)
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(HALVINGS):
                true = (read - self.affine.bias - error) @ self.affine.mapping.T
                error = 0.5 * (error + self._error(samples.t, true))
        if not np.isfinite(error).all():
            raise OverflowError("an effect of the rate is larger than the rate itself")
        return np.asarray(read - error)

    def _error(self, t: Array, rate: Array) -> Array:
        """Return what the effects add (n, 3) at a true rate (n, 3)."""
        known, warm = self.residuals.moments, 0.0
        if known.temperature is not None and known.history.reference_c is not None:
            warm = float(np.interp(t, known.t, known.temperature).mean()) + known.history.reference_c
        during = turning(known, t, rate, warm)
        sums = (h.effect.response(during, h.grid) @ v for h, v in zip(self.found, self.values, strict=True))
        return np.asarray(sum(sums))


@dataclass(frozen=True, slots=True, eq=False)
class AboutTurns:
    """The turns without named effects of the rate: what a linear fit of large ones must be made about.

    affine: both sensors' parameters there; residuals: the turns; found, values: the effects that were taken
    off the rates, and by how much (k,) each, SI.
    """

    affine: Aligned
    residuals: SensorResiduals
    found: Sequence[Hypothesis]
    values: Sequence[Array]


def about_effects(
    stated: Sequence[Stated],
    start: tuple[Aligned, SensorResiduals],
    rates: Rates,
    again: Callable[[Rates], tuple[Aligned, SensorResiduals | None]],
) -> tuple[list[Stated], AboutTurns | None]:
    """Return the statements of turns with the sizes of named effects estimated about these effects.

    With them come the turns without these effects; None where none has a name, or one is so large that
    nothing is left to estimate it about.

    start: the sensors' parameters and the turns that they were found in; rates: what was taken off the rates
    there; again: makes both of other rates.
    """
    named = [s for s in stated if s.finding.effect != "unknown" and s.hypothesis is not None]
    found = [s.hypothesis for s in named if s.hypothesis is not None]
    if not found:
        return list(stated), None
    others = [s.hypothesis for s in stated if s.hypothesis is not None and s not in named]
    values = taken = [s.sizes for s in named]
    estimates: list[Estimate] = []
    (affine, residuals), known = start, start[1]
    for _ in range(ROUNDS):
        try:
            affine, made = again(OffTurns(rates, affine, known, found, values))
        except OverflowError:
            return list(stated), None
        if made is None:
            return list(stated), None
        residuals, taken = made, values
        own = [residuals.hypothesis(h.effect, h.grid) for h in found]
        beside = [residuals.hypothesis(h.effect, h.grid) for h in others]
        estimates = [estimate(residuals, one, [h for h in [*own, *beside] if h is not one]) for one in own]
        values = [v + e.value for v, e in zip(values, estimates, strict=True)]
        if all((np.abs(e.value) <= SETTLED * e.sigma).all() for e in estimates):
            break
    whole = (replace(e, value=v) for e, v in zip(estimates, values, strict=True))
    sized = {id(s): _with_sizes(s.finding, e) for s, e in zip(named, whole, strict=True)}
    about = AboutTurns(affine, residuals, found, taken)
    return [replace(s, finding=sized.get(id(s), s.finding)) for s in stated], about


def _with_sizes(finding: Finding, found: Estimate) -> Finding:
    """Return a finding with the sizes of an estimate."""
    said = sentence(found, finding.axes, finding.alternatives)
    return replace(finding, parameters=parameters(found), statement=said)
