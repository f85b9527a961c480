"""How much likelier a recording is with an effect than without: the Bayes factor, with the noise refitted.

Nobody knows beforehand how large an effect is: its prior is a mixture of normal distributions, from the
physically largest size down to a thousandth of it, all equally likely. It may be on all axes or on one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.diagnosis.inference.likelihood import (
    expected_information,
    gain_bound,
    log_sum,
    maximum,
)
from stillcal.calib_core.diagnosis.inference.reduction import NOTHING, Reduced

SIZES = 10.0 ** -np.arange(0.0, 3.1, 0.5)
"""Prior standard deviations, as parts of the physically largest size: the least that quiet rests show is
about a thousandth (a gyroscope's step of 2e-5 rad/s)."""

LEAST_PROBABILITY = 1e-15
"""What a sum of probabilities in double precision can tell from nothing."""

ALL_AXES = 0.5
"""Prior probability that an effect is on all axes; else it is on one, each alike."""

NEGLIGIBLE = 60.0
"""Nats below the evidence so far from which on a grid point adds nothing: 37 are all that double precision
tells, the rest is room for `gain_bound`, which is a bound but for what views share."""


def log_evidence(views: Sequence[Reduced], h: int) -> float:
    """Return the log likelihood, in nats, of hypothesis `h` with its sizes integrated out (Laplace).

    About the maximum b of likelihood times a prior of unit size the log likelihood is taken as quadratic,
    with the information J of the noise shapes' mean. Its slope there is b, so that under a prior of size s

        log evidence = L(b) - b'b - b'Jb / 2 + (b + Jb)' (J + I/s^2)^-1 (b + Jb) / 2 - log|I + s^2 J| / 2.

    What every hypothesis has besides keeps its prior of unit size.
    """
    beta, value, likely = maximum(views, h)
    information = expected_information(views, h, beta, likely)
    highest = value + 0.5 * float(beta @ beta)
    pull = beta + information @ beta
    bare = highest - float(beta @ beta) - 0.5 * float(beta @ information @ beta)
    terms = []
    for size in SIZES:
        variance = np.full(beta.size, size**2)
        variance[beta.size - views[0].shared :] = 1.0
        terms.append(
            bare
            + 0.5 * float(pull @ np.linalg.solve(information + np.diag(1.0 / variance), pull))
            - 0.5 * float(np.linalg.slogdet(np.eye(beta.size) + variance[:, None] * information)[1])
        )
    return log_sum(np.array(terms)) - float(np.log(SIZES.size))


def of_probabilities(posterior: float, prior: float) -> float:
    """Return the log Bayes factor, in nats, that takes a prior to a posterior probability."""
    sure, before = (float(np.clip(p, LEAST_PROBABILITY, 1.0 - LEAST_PROBABILITY)) for p in (posterior, prior))
    return float(np.log(sure / (1.0 - sure)) - np.log(before / (1.0 - before)))


def log_bayes_factor(views: Sequence[Reduced], hypotheses: int, multiplicity: float) -> float:
    """Return the log Bayes factor, in nats, of an effect against none, over its grid points and axes.

    views: reduced for `hypotheses` grid points, each followed by its three axes alone (`reduce_residuals`
    with parts). multiplicity: how many independent points the grid has besides these, as one of which they
    count; 1 where these are all.
    """
    single = np.log((1.0 - ALL_AXES) / 3.0)
    points = [
        (4 * i + part, np.log(ALL_AXES) if part == 0 else single)
        for i in range(hypotheses)
        for part in range(4)
        if any(v.own(4 * i + part).any() for v in views)
    ]
    most = np.array([gain_bound(views, h) for h, _ in points])
    total = -np.inf
    for at in np.argsort(-most, kind="stable"):
        # Most moments of a step, say, are far from its own.
        if most[at] < total - NEGLIGIBLE:
            break
        h, prior = points[at]
        total = float(np.logaddexp(total, log_evidence(views, h) + prior))
    tries = float(np.log(hypotheses)) + float(np.log(multiplicity))
    return total - tries - log_evidence(views, NOTHING)
