"""A step, a settling or a misalignment in a recording, in a simulation of its motion, or in both: whose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Alignment, Readings
from stillcal.calib_core.diagnosis.comparison.pair.compare import compare_in_pair
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.comparison.pair.stands import with_own_of_simulation
from stillcal.calib_core.diagnosis.comparison.records import Discrepancy
from stillcal.calib_core.diagnosis.effects.timed import Step
from stillcal.calib_core.diagnosis.effects.warmup import Warmup
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Where
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.diagnosis.pair.readings import less
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


def judged(real: Recording, sim: Recording, effect: Effect, grids: Sequence[Grid]) -> list[Discrepancy]:
    """Return what is said of a pair of which it is known what the gyroscopes differ by: an effect's grids."""
    assert sim.gyroscope is not None
    true = Readings(sim.accelerometer, sim.gyroscope)
    bins, sensors = pair_residuals(less(real, true), true, [], 0.0)
    residuals = next(s for s in sensors if s.sensor == "gyro")
    stated = []
    for grid in grids:
        where = Where(grid.get("t_start", bins.span[0]), bins.span[1], (0.0, 0.05), "time")
        finding = Finding(effect.name, "gyro", ["x", "z"], where, {}, Evidence(50.0), [], "")
        stated.append(Stated(finding, residuals.measured(effect, grid), residuals))
    exam = replace(examined(real, sought=()), bins=bins, sensors=sensors, turns=None, statements=stated)
    alike = Alignment(true, true, [], [], frozenset())
    found = with_own_of_simulation(
        compare_in_pair(exam, alike),
        exam,
        (examined(real, sought=()), examined(sim, sought=())),
        ("real", "sim"),
    )
    return sorted(found.discrepancies, key=lambda d: d.where.t_start)


@pytest.mark.slow
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
    grids = [{"t_start": at} for at in sorted({*recorded, *simulated})]
    found = judged(jumping(1, recorded), jumping(2, simulated), Step("gyro"), grids)
    assert [d.relation for d in found] == relations
    for one in found:
        at = one.where.t_start
        apart = recorded.get(at, 0.0) - simulated.get(at, 0.0)
        assert one.difference is not None
        assert np.abs(one.difference.value - apart * STEP).max() < 0.1 * np.abs(STEP).max()
        had = one.difference.simulated.value
        assert np.abs(had - simulated.get(at, 0.0) * STEP).max() < 0.15 * np.abs(STEP).max()


def test_a_settling_of_the_simulation_is_counted_from_the_bias_that_both_have_in_the_end() -> None:
    """Counted from the start, its amplitude would be told again, as a difference of the bias."""

    def settling(force: Array, rate: Array) -> tuple[Array, Array]:
        return force, rate + np.outer(np.exp(-np.arange(len(rate)) / RATE / 60.0), 5.0 * STEP)

    (one,) = judged(turned(1), turned(2, settling), Warmup("gyro"), [{"tau_s": 60.0}])
    assert (one.effect, one.relation) == ("gyro_warmup", "superfluous")
    assert one.difference is not None and one.difference.recorded.reference["settled"] == 1.0
    # From the settled bias a settling is less its amplitude times what is left of it.
    assert np.abs(one.difference.simulated.value + 5.0 * STEP).max() < 0.15 * 5.0 * np.abs(STEP).max()


def test_a_misalignment_of_the_simulation_alone_is_all_its_own() -> None:
    """Its rests tell half of what y adds to x: the other half is a turn of all axes."""
    mixed = np.array([[1.0, 0.01, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])

    def misaligned(force: Array, rate: Array) -> tuple[Array, Array]:
        return force @ mixed.T, rate

    (one,) = judged(turned(1), turned(2, misaligned), Step("gyro"), [])
    assert (one.effect, one.relation) == ("accel_scale", "superfluous")
    assert one.difference is not None
    assert one.difference.simulated.value.reshape(3, 3)[0, 1] == pytest.approx(-0.01, abs=5e-4)
