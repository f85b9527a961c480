"""A step of bias in a recording, in a simulation of its motion, or in both: which of them has how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.pair.compare import compare_in_pair
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.comparison.pair.stands import with_own_of_simulation
from stillcal.calib_core.diagnosis.comparison.pair.turns import Readings
from stillcal.calib_core.diagnosis.comparison.records import Discrepancy
from stillcal.calib_core.diagnosis.effects.timed import Step
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Where
from stillcal.calib_core.diagnosis.slow.findings import Stated
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.diagnosis.paired import less
from stillcal.replay.formats.trace import Recording
from tests.support.diagnosis.turned_pairs import RATE, turned

STEP = np.array([2e-3, 0.0, -1e-3])
"""rad/s"""

Steps = dict[float, float]
"""Moments, s, and how many times `STEP` the gyroscope's bias jumps by then."""


def jumping(seed: int, steps: Steps) -> Recording:
    def flaw(force: Array, rate: Array) -> tuple[Array, Array]:
        t = np.arange(len(rate)) / RATE
        return force, rate + sum(np.outer(t >= at, times * STEP) for at, times in steps.items())

    return turned(seed, flaw)


def judged(recorded: Steps, simulated: Steps) -> list[Discrepancy]:
    """Return what is said of the steps of the gyroscope, told when they are, by their moments."""
    real, sim = jumping(1, recorded), jumping(2, simulated)
    assert sim.gyroscope is not None
    true = Readings(sim.accelerometer, sim.gyroscope)
    bins, sensors = pair_residuals(less(real, true), true, [], 0.0)
    residuals = next(s for s in sensors if s.sensor == "gyro")
    stated = []
    for at in sorted({*recorded, *simulated}):
        where = Where(at, bins.span[1], (0.0, 0.05), "time")
        finding = Finding("gyro_bias_step", "gyro", ["x", "z"], where, {}, Evidence(50.0), [], "")
        stated.append(Stated(finding, residuals.measured(Step("gyro"), {"t_start": at}), residuals))
    exam = replace(examined(real, search=False), bins=bins, sensors=sensors, turns=None, statements=stated)
    found = with_own_of_simulation(compare_in_pair(exam), exam, examined(sim, search=False))
    steps = [d for d in found.discrepancies if d.effect == "gyro_bias_step"]
    return sorted(steps, key=lambda d: d.where.t_start)


@pytest.mark.parametrize(
    ("recorded", "simulated", "relations"),
    [
        ({150.0: 1.0}, {}, ["lacking"]),
        ({}, {150.0: 1.0}, ["superfluous"]),
        ({150.0: 1.0}, {150.0: 0.5}, ["too_small"]),
        ({100.0: 1.0}, {200.0: -2.0}, ["lacking", "superfluous"]),
    ],
)
def test_a_step_is_told_of_the_one_that_has_it(
    recorded: Steps, simulated: Steps, relations: list[str]
) -> None:
    found = judged(recorded, simulated)
    assert [d.relation for d in found] == relations
    for one in found:
        at = one.where.t_start
        apart = recorded.get(at, 0.0) - simulated.get(at, 0.0)
        assert one.difference is not None
        assert np.abs(one.difference.value - apart * STEP).max() < 0.1 * np.abs(STEP).max()
        had = one.difference.simulated.value
        assert np.abs(had - simulated.get(at, 0.0) * STEP).max() < 0.15 * np.abs(STEP).max()
