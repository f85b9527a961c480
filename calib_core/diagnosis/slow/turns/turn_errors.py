"""Turns that no affine gyroscope explains: gravity before and after says one rotation, the rate another.

What a sound gyroscope leaves of a turn comes from the noise of both sensors, from bias that is not quite
known, from what happens between two samples, and from its own departures from a straight line, which are a
small part of the angle. Where turns are off by more, and no effect with or without a name explains it, that
is stated without saying more than that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.model.rotation_alignment import GYRO_SCALE_SIZE, Aligned
from stillcal.calib_core.diagnosis.model.sound_phones import log_mean_exp
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.turns.turn_residuals import turn_view

DRIVER = "turns from rest to rest"

SOUND, FAULTY = (1e-4, 6e-3), (6e-3, 0.5)
"""Parts of the angle turned through by which gravity is missed: those of sound phones and of faulty ones.

Of two real units turned by hand an Xsens (imu_tk) has less than 0.0010, an MPU-9150 (mikoff) less than 0.0024
(95 %); sound is up to more than twice that.
"""

FEWEST = 5
"""Turns from which they are judged: with fewer a scale and misalignment as phones have them explain most."""

STEPS = 24
"""Parts of the angle that are tried in either range, evenly on a logarithmic scale."""


@dataclass(frozen=True, slots=True, eq=False)
class Missed:
    """What turns are off by. y: (k, 2) rad across gravity; variance: (k,) of a component, of what is known.

    free: (k, 2, p) what unknown numbers do to it, a column a standard deviation; angle: (k,) rad.
    """

    y: Array
    variance: Array
    free: Array
    angle: Array

    def log_likelihood(self, part: float) -> float:
        """Return the log density of what is missed, with a normal error of this part of the angle in it."""
        sd = np.repeat(np.sqrt(self.variance + (part * self.angle) ** 2), 2)
        y, free = self.y.ravel() / sd, self.free.reshape(sd.size, -1) / sd[:, None]
        inner = np.eye(free.shape[1]) + free.T @ free
        pulled = free.T @ y
        power = float(y @ y - pulled @ np.linalg.solve(inner, pulled))
        return -0.5 * (power + float(np.linalg.slogdet(inner)[1])) - float(np.log(sd).sum())

    def without(self, k: int) -> Missed:
        """Return all turns but one."""
        kept = np.arange(self.angle.size) != k
        return Missed(self.y[kept], self.variance[kept], self.free[kept], self.angle[kept])

    def nats(self) -> float:
        """Return the evidence for a faulty gyroscope against a sound one; every size is as likely."""
        means = (
            log_mean_exp(np.array([self.log_likelihood(p) for p in np.geomspace(*between, STEPS)]))
            for between in (FAULTY, SOUND)
        )
        return next(means) - next(means)

    def part(self) -> tuple[float, float, float]:
        """Return the likeliest part of the angle, and its 95 % interval."""
        tried = np.geomspace(SOUND[0], FAULTY[1], 8 * STEPS)
        told = np.array([self.log_likelihood(float(p)) for p in tried])
        share = np.cumsum(np.exp(told - told.max()))
        low, high = (float(tried[np.searchsorted(share / share[-1], q)]) for q in (0.025, 0.975))
        return float(tried[np.argmax(told)]), low, high


def missed_turns(made: Aligned, bins: Bins, gravity: float, found: Sequence[Hypothesis]) -> Missed | None:
    """Return what turns are off by, with all that a sound phone may do to them; None with too few turns.

    The other parameters are those of `turn_errors`.
    """
    if len(made.turns) < FEWEST or bins.rate is None or bins.rate_variance is None:
        return None
    view = turn_view(made, bins)
    residuals = SensorResiduals("gyro", bins, (view,), gravity, None, tuple(made.turns))
    free = [GYRO_SCALE_SIZE * view.baseline[0], *view.shared]
    free += [] if view.absorbed is None else [view.absorbed]
    free += [h.sizes * residuals.hypothesis(h.effect, h.grid).columns[0][0] for h in found]
    k = len(made.turns)
    return Missed(
        view.y[0].reshape(k, 2),
        view.variance[::2],
        np.hstack(free).reshape(k, 2, -1),
        np.array([t.angle for t in made.turns]),
    )


def turn_errors(
    made: Aligned, bins: Bins, gravity: float, found: Sequence[Hypothesis] = ()
) -> Finding | None:
    """State turns that are off by more than a sound gyroscope's, whatever does it.

    found: named effects of the rate, whose sizes are unknown here. Evidence is that of all turns but the one
    that speaks most for it: a single one may be anything. On a ship that rolls, gravity is where the deck is.
    On a chest that breathes it is elsewhere at the end of a rest than in its middle.
    """
    missed = None if bins.swings or bins.breathes else missed_turns(made, bins, gravity, found)
    if missed is None or not DirectEvidence(missed.nats()).stated:
        return None
    size = (missed.y**2).sum(axis=1) / (missed.variance + (SOUND[1] * missed.angle) ** 2)
    seen = DirectEvidence(missed.without(int(np.argmax(size))).nats())
    part, low, high = missed.part()
    say = (
        f"Over {missed.angle.size} turns gravity is not where the gyroscope takes it, by {100.0 * part:.2g} %"
        " of the angle turned through; no scale, misalignment or known effect of the rate explains it."
    )
    where = Where(*bins.span, SLOW_BAND, DRIVER)
    sizes = {"part_of_angle": Parameter(part, [low, high], "1")}
    return direct_finding("unknown", "gyro", [], where, sizes, statement=say, seen=seen)
