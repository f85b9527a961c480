"""Every threshold of the diagnosis, with what set it. Nothing else in the package decides what is alarming."""

from __future__ import annotations

SCORE = 4.0
"""Least score S of a slow finding: to be set by tests/core/misfit/calibrate.py."""

WORTH_FITTING = 1.0
"""Hypotheses whose best case scores less than this are not fitted at all."""

MARGIN = 1.3
"""Hypotheses within this score of the winner's are indistinguishable (a likelihood ratio of about 20)."""

AXIS_SIGMA = 2.6
"""An axis is named where its parameter is this many standard errors from nothing (two-sided 1 %)."""

MAX_FINDINGS = 3
"""Forward steps a sensor."""

LEAST_BINS = 12
"""Fewer still bins than this carry no slow diagnosis."""
