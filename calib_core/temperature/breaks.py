"""The regression with breaks: a bias that steps, and rests that are doubted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.temperature.regression import (
    MG,
    Fit,
    Model,
    Observations,
    Priors,
    Regression,
    Step,
)
from stillcal.calib_core.temperature.wander import Wander

MOST_BREAKS = 8
"""Steps and doubted rests that one regression allows for."""

BREAK = 5.0
"""Standard uncertainties by which a rest must miss its prediction to be one of them."""

HIDDEN = 3.0
"""A step is expected to be up to so many times what one rest shows of it. An accelerometer's rest shows the
part along gravity, which is a third or less for a third of all directions."""

_LIKELIER = 0.1
"""nats: below this, two explanations of a rest are alike."""

_LINEAR = 5 * MG
"""A bias that is so far from where a rest was made linear bends its norm by 0.013 mg: it wanders more."""

_MOST_REPEATS = 4
"""Repeats of making rests linear: each squares what is left of a step, in units of gravity."""


_BEGINNINGS = 4
"""Rests that miss their prediction at which a step is tried: its first one may show little of it."""


def learn(
    seen: Observations, model: Model, now: float, start: Wander | None = None, *, search: bool = True
) -> Fit:
    """Fit a bias by temperature and time, allowing for steps and for rests that are no rests.

    A rest that misses its prediction by more than BREAK standard uncertainties is doubted, or shows a step,
    or the bias wanders by so much: whichever is likelier. A doubt and a step at the newest rest are alike; it
    is then a step, so that a knock widens the uncertainty at once. Either is as large as the rest shows
    (HIDDEN). Rests are made linear about the bias of their own time. now: s, the time that the bias is wanted
    for. start: where the search for the wander begins; without `search` that is the wander, unless a rest
    misses its prediction. Raises ValueError where there is no rest.
    """
    if not len(seen.t):
        raise ValueError("no rests to learn from")
    fit = Regression(seen, model).fit(now, start=start, search=search)
    if not search and start is not None and _missed(fit).max() > BREAK:
        fit = Regression(seen, model).fit(now, start=start)
    for _ in range(MOST_BREAKS):
        broken = _broken(fit, now)
        if broken is None:
            break
        fit = broken
    return _linear(fit, now)


def _broken(fit: Fit, now: float) -> Fit | None:
    """Return the likeliest fit with one step or doubted rest more, None where no rest asks for one.

    Where each rest shows one direction only, a bias that steps looks like one that wanders far. So rests are
    looked at with no more wander than usual there, and what is found must be likelier than more wander, by
    the number of rests at which it might have been; or a rest misses its prediction as much with more wander.
    """
    seen, model = fit.seen, fit.model
    partly = seen.towards is not None
    usual = _usual(model.priors, fit.wander) if partly else fit.wander
    quiet = _again(fit, now, wander=usual) if partly else fit
    missed = _missed(quiet)
    row = int(missed.argmax())
    if missed[row] <= BREAK:
        return None
    shown = float(np.abs(quiet.errors[row]).max())
    size = max(model.priors.step, HIDDEN * shown if partly else shown)
    off = np.flatnonzero(missed[: row + 1] > BREAK)
    rows = {*off[:1].tolist(), *off[-_BEGINNINGS:].tolist()} if partly else {row}
    taken = {step.t for step in fit.steps}
    ways = [
        _linear(_again(fit, now, steps=(*fit.steps, step), wander=usual), now)
        for step in (Step(float(seen.t[k]), size) for k in sorted(rows))
        if step.t not in taken
    ]
    again = _again(fit, now, seen=seen.doubting(row, size), wander=usual)
    doubt = _linear(replace(again, doubted=(*fit.doubted, row)), now)
    best = max(ways, key=lambda way: way.log_likelihood, default=doubt)
    newest = row == len(missed) - 1
    if not newest and doubt.log_likelihood > best.log_likelihood + _LIKELIER:
        best = doubt
    searched = Regression(best.seen, model).fit(now, best.steps, usual)
    broken = _linear(replace(searched, doubted=best.doubted), now)
    likelier = broken.log_likelihood > fit.log_likelihood + np.log(len(seen.t))
    return broken if likelier or _missed(fit)[row] > BREAK else None


def _again(
    fit: Fit,
    now: float,
    *,
    seen: Observations | None = None,
    steps: tuple[Step, ...] | None = None,
    wander: Wander | None = None,
) -> Fit:
    """Return the fit of other observations, or with other steps or another wander, without a search."""
    regression = Regression(seen or fit.seen, fit.model)
    found = regression.fit(now, fit.steps if steps is None else steps, wander or fit.wander, search=False)
    return replace(found, doubted=fit.doubted)


def _missed(fit: Fit) -> Array:
    """Return by how many standard uncertainties each rest misses its prediction, (n,).

    It is 0 for the first and for those that are doubted.
    """
    missed = np.abs(fit.errors).max(axis=1) / fit.errors_sd
    missed[[0, *fit.doubted]] = 0.0
    return np.asarray(missed)


def _usual(priors: Priors, wander: Wander) -> Wander:
    """Return a wander without what it has more of than sensors of its kind usually have."""
    return Wander(
        min(wander.white, priors.white),
        min(wander.flicker, priors.flicker),
        min(wander.walk, priors.walk / np.sqrt(86400.0)),
        wander.declared,
    )


def _linear(fit: Fit, now: float) -> Fit:
    """Return a fit of its observations made linear about the bias that it found for each rest."""
    for _ in range(_MOST_REPEATS):
        if fit.seen.linear is None or np.abs(fit.course - fit.seen.near).max() <= _LINEAR:
            break
        fit = _again(fit, now, seen=fit.seen.about(fit.course))
    return fit
