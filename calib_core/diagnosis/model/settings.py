"""Thresholds of the diagnosis, with what set each; those of one file alone stand there."""

from __future__ import annotations

import numpy as np

SCORE = 4.0
"""Least score S of a slow finding, from tests/support/diagnosis/threshold.py (docs/diagnosis.md, 5)."""

WORTH_FITTING = 1.0
"""Hypotheses whose best case scores less than this are not fitted at all."""

MARGIN = 1.3
"""Hypotheses within this score of the winner's are indistinguishable (a likelihood ratio of about 20)."""

AXIS_SIGMA = 2.6
"""An axis is named where its parameter is this many standard errors from nothing (two-sided 1 %)."""

AXIS_SHARE = 0.05
"""An axis is named where its parameter is at least this part of the largest axis'."""

MAX_FINDINGS = 3
"""Forward steps a sensor."""

LEAST_BINS = 12
"""Fewer still bins than this carry no slow diagnosis."""

UNKNOWN_PENALTY = 0.3
"""Score that structure without a name must give away."""

UNKNOWN_MARGIN = 0.7
"""A named effect wins over structure without a name that scores better by less than this."""

MODELLED = 0.1
"""Part of a named effect, in amplitude, below which what it leaves is the error of its linear model. An
effect that is only roughly known (`Effect.rough`) may leave as much as it is rough."""

PAIRS = 5
"""Named effects that are tried two together before structure is called unknown."""

HIDDEN_SCORE = 1.0
"""Score alone of an effect that is tried beside a second one which may hide it: ten to one for it."""

WANDER_MIDDLE, WANDER_DECADES, WANDER_TAIL = 0.8, 1.5, 0.03
"""Prior of how much a bias' bins scatter by wander over white noise (log10 of variances): flicker floors of
0.03 to 3 times the white noise of a second are what phones have; the tail is for those that do not."""

DIRECT_CHECKS = 40
"""How many checks of samples, values and stamps a diagnosis makes: of the two sensors' values and noise some
seventeen each, of stamps and motion six. Before the data, one of them is expected to find something."""

STATED = 0.999
"""Posterior probability from which what samples, values and stamps show is stated: of a thousand such
findings one may be false."""

LEVEL_TOLERANCE = 0.12
"""Relative difference of noise densities, from the claim or between axes, that is no finding."""

RANDOM_WALK = {"accel": 30e-6 * 9.80665, "gyro": 1.745e-5}
"""Bias random walk that Android allows (7.3): 30 ug sqrt(Hz), 0.001 deg/s sqrt(Hz); per sqrt(s)."""

JUMP = {"accel": 5e-4, "gyro": 7.3e-5}
"""Standard deviation of a bias that is another in every rest, m/s^2 and rad/s, that is no finding: 50 ug, and
the Earth's own rate, of whose latitude and heading nothing is known."""

STATEMENTS_TRUE = 0.97
"""How often what is stated beyond doubt is true. A likelihood compares what somebody thought of, and sensors
do more: of 850 statements to which it gave above 0.99, in recordings with concealed effects, 823 were true
(docs/proof.md, 10)."""

CERTAIN = 0.95
"""Posterior probability from which a difference is stated, and one minus it from which agreement is."""

CERTAIN_NATS = float(np.log(CERTAIN / (1.0 - CERTAIN)))
"""Evidence, nats, from which even odds are certain."""

CERTAIN_NAMELESS = 0.999
"""Posterior probability of jumps or wander beyond what is allowed that makes them a finding with no name."""

BANDWIDTH_LIMIT = 0.38
"""Part of the sample rate below which a low-pass is a finding: parts come with 0.40 to 0.44 (BMI270)."""

CERTAIN_WALK = 0.99
"""Posterior probability of a random walk beyond the limit that makes it a finding."""

BANDWIDTH_GAIN = 60.0
"""Least reduction of chi-squared by a cutoff over a flat spectrum."""

LEVER_GAIN = 0.008
"""Part of the motion's power, whitened, in windows left out of the fit, that a lever arm must explain."""
