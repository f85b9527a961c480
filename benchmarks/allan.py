"""Item 5: overlapping Allan deviation of ten million samples, beside allantools."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from peers import peer
from timing import Row, ratio, rounds

from stillcal.calib_core.noise.covariance import allan_deviations


def run(quick: bool) -> Iterator[Row]:
    """Yield the rows of item 5."""
    n = 1_000_000 if quick else 10_000_000
    values = np.random.default_rng(0).standard_normal(n)
    tools = peer("allantools")
    octave = 2 ** np.arange(int(np.log2(n / 3)) + 1)
    spaced = np.unique(np.round(np.logspace(0, np.log10(n / 3), 100)).astype(int))
    for name, factors, goal in (("octave", octave, 3.0), ("100 log-spaced", spaced, 10.0)):
        cases = {
            "ours": lambda f=factors: allan_deviations(values, f),
            "one running sum": lambda: np.cumsum(values),
        }
        if tools is not None:
            cases["allantools"] = lambda f=factors: tools.oadev(values, rate=1.0, data_type="freq", taus=f)[1]
        timed = rounds(cases, 2 if quick else 5)
        own, versus, met = timed["ours"], None, None
        sums = 1.0 / ratio(own, timed["one running sum"])[0]
        accuracy = f"{sums:.0f} times one running sum of the samples"
        if tools is not None:
            versus = ratio(own, timed["allantools"])
            apart = float(np.abs(timed["allantools"].answer / own.answer - 1.0).max())
            met = versus[0] >= goal and apart < 1e-9
            accuracy = f"apart by {apart:.0e} at most; {accuracy}"
        what = f"Allan deviation of {n:.0e} samples, {name} averaging times ({len(factors)})"
        words, margin = f"{goal:g} times, to 1e-9", versus and versus[0] / goal
        yield Row("5", what, own.spread(1.0), "s", "allantools", versus, words, met, accuracy, margin)
