"""Whether a curve is taken up or dropped: what rests are predicted to with it, and without.

Two regressions of the same rests are compared, with a curve of temperature and without. Both predict each
rest from the rests before it. The curve is taken up where it predicts them better by more than chance, and
dropped where it predicts the newest of them worse by more than chance, by the sign-flip test of the
acceptance rule (Fisher 1935). Rests of the same hour count as one, because they share their errors.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.acceptance import (
    ENOUGH_GAIN,
    MOST_GAIN,
    beyond_doubt,
    flipped_share,
    sums_by_block,
)
from stillcal.calib_core.calibration.bias_curve.learnt import DROPPED, TAKEN_UP
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.record import Evidence
from stillcal.calib_core.temperature.regression import (
    Fit,
    Observations,
)

BLOCK_S = 3600.0
NEWEST_HOURS = 12
"""Newest hours with rests that must support a curve for it to be taken up, and that decide whether it is
dropped."""

MATTERS = 1.2
"""A curve is dropped only where it makes the errors larger by this: at one temperature it makes none."""

_BAD = 3.0
"""A rest that misses its prediction by more usual errors than these counts as one that misses by these."""

_STRICTER = 0.1
"""Of the chance at which a calibration is accepted: whether to take a curve up is judged at every check."""


def change_of(
    curved: Fit, without: Fit, seen: Observations, held: bool, settings: QualitySettings
) -> tuple[str, Evidence]:
    """Return whether the curve is to be taken up or dropped, or nothing, and the figures.

    held: whether a curve is in use. Whether one is taken up is judged by the score of a Cauchy distribution
    of the rests' own scatter, so that one bad rest weighs little; and where few hours leave no doubt, by what
    is gained at the uncertainty stated without the curve. Whether one is dropped is judged by squared errors,
    because a curve that often fails badly may be the better one in all other hours.
    """
    own = seen.variances(curved.wander)[1:, None]
    errors = [fit.errors[1:] ** 2 for fit in (without, curved)]
    gains = np.log((errors[0] + own) / (errors[1] + own)).sum(axis=1)
    _, block = np.unique(np.floor(seen.t[1:] / BLOCK_S), return_inverse=True)
    by_hour = sums_by_block(block, gains)
    evidence: Evidence = {"hours": by_hour.size, "gain": float(by_hour.sum())}
    evidence |= {
        f"typical_{name}": float(np.sqrt(np.median(e))) if e.size else None
        for name, e in zip(("without", "with"), errors, strict=True)
    }
    at_stated = (errors[0] - errors[1]).sum(axis=1) / (2.0 * without.errors_sd[1:] ** 2)
    doubtless = beyond_doubt(sums_by_block(block, at_stated)[-NEWEST_HOURS:])
    if by_hour.size < settings.held_out_rests:
        return (TAKEN_UP if doubtless and not held else ""), evidence
    if held:
        newest = block >= by_hour.size - NEWEST_HOURS
        without_curve, with_curve = (e[newest].sum(axis=1) for e in errors)
        most = _BAD**2 * without_curve.mean()
        lost = np.minimum(with_curve, most) - np.minimum(without_curve, most)
        worse = flipped_share(sums_by_block(block[newest], lost)[-NEWEST_HOURS:])
        matters = with_curve.mean() > MATTERS**2 * without_curve.mean()
        return (DROPPED if worse <= settings.chance and matters else ""), evidence | {"chance": worse}
    better, lately = flipped_share(by_hour), flipped_share(by_hour[-NEWEST_HOURS:])
    taken_up = better <= settings.chance * _STRICTER and lately <= settings.chance
    return (TAKEN_UP if taken_up or doubtless else ""), evidence | {"chance": better}


def misled(curved: Fit, without: Fit, t: Array) -> float:
    """Return how strongly the newest rests speak against the readings, nats, 0 where they do not.

    Page's test (1954, 10.1093/biomet/41.1-2.100) on the predictive density of each rest without the curve and
    with it; a step costs what it costs in the regression. Where the curve holds, the result exceeds
    ENOUGH_GAIN once in some exp(ENOUGH_GAIN) rests. t: (n,) s, of the rests.
    """
    gains = _log_density(without, t) - _log_density(curved, t)
    gains[[0, *without.doubted, *curved.doubted]] = 0.0
    against = 0.0
    for gain in np.minimum(gains, MOST_GAIN).tolist():
        against = min(max(against + gain, 0.0), 2.0 * ENOUGH_GAIN)
    return against


def _log_density(fit: Fit, t: Array) -> Array:
    """Return the log density of each rest by those before it, (n,), less the cost of a step there."""
    missed = (fit.errors / fit.errors_sd[:, None]) ** 2
    density = -0.5 * missed.sum(axis=1) - fit.errors.shape[1] * np.log(fit.errors_sd)
    stepped = np.isin(t, [step.t for step in fit.steps])
    return np.asarray(density - np.log(len(t)) * stepped)
