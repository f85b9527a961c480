"""Wander, or something nameless, that a recording and a simulation of its motion differ by: whose it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Alignment, Readings
from stillcal.calib_core.diagnosis.comparison.pair.compare import compare_in_pair
from stillcal.calib_core.diagnosis.comparison.pair.motion import left_in_motion
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.comparison.pair.stands import with_owner_of_unknown
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, subtract
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.comparison.stated import sole_discrepancy
from stillcal.calib_core.diagnosis.effects.unknown import Unknown
from stillcal.calib_core.diagnosis.model.effect import Linear, on_axes
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.wander import NO_DRIVER
from stillcal.replay.diagnosis.answer import Fit, answer_of
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.diagnosis.pair.readings import less
from stillcal.replay.formats.trace import Recording
from tests.support.diagnosis.turned_pairs import RATE, turned

SWING = np.array([3e-3, 3e-3, -3e-3])
"""rad/s to both sides of nothing."""


def level(t: Array) -> Array:
    """Return a square wave (n,) of 75 s, which jumps within turns and within rests."""
    return np.where(t % 75.0 < 37.5, 1.0, -1.0)


def swinging(seed: int, times: float) -> Recording:
    def flaw(force: Array, rate: Array) -> tuple[Array, Array]:
        return force, rate + times * np.outer(level(np.arange(len(rate)) / RATE), SWING)

    return turned(seed, flaw)


def found_in_pair(recorded: float, simulated: float) -> tuple[Comparison, SensorResiduals, Hypothesis]:
    """Return what is said where a course between two levels was found, 0 and 1, in the gyroscope."""
    real, sim = swinging(1, recorded), swinging(2, simulated)
    assert sim.gyroscope is not None
    true = Readings(sim.accelerometer, sim.gyroscope)
    bins, sensors = pair_residuals(less(real, true), true, [], 0.0)
    residuals = next(s for s in sensors if s.sensor == "gyro")
    course = Unknown("gyro", "two levels in time", Linear("amplitude", "rad/s", 3, 0.02))
    response = on_axes(0.5 + 0.5 * level(bins.t))
    hypothesis = Hypothesis(course, {}, residuals.columns_of(response))
    where = Where(*bins.span, (0.0, 0.05), "two levels in time")
    size = Parameter((2.0 * (recorded - simulated) * SWING).tolist(), None, "rad/s")
    said = Finding("unknown", "gyro", ["x"], where, {"amplitude": size}, Evidence(50.0), [], "")
    exams = [examined(one, sought=()) for one in (real, sim)]
    exam = replace(
        exams[0], bins=bins, sensors=sensors, turns=None, statements=[Stated(said, hypothesis, residuals)]
    )
    found = compare_in_pair(exam, Alignment(true, true, [], [], frozenset()))
    return with_owner_of_unknown(found, exam, *exams), residuals, hypothesis


@pytest.mark.parametrize(
    ("recorded", "simulated", "relation", "either"),
    [(1.0, 0.0, "lacking", False), (0.0, 1.0, "superfluous", False), (1.0, -1.0, "lacking", True)],
)
def test_what_has_no_name_is_of_the_one_whose_own_rests_hold_it(
    recorded: float, simulated: float, relation: str, either: bool
) -> None:
    """The difference of the readings does not tell it; the sign is that of the owner's own readings."""
    found, _, _ = found_in_pair(recorded, simulated)
    (one,) = (d for d in found.discrepancies if d.effect == "unknown")
    assert (one.relation, one.of_either) == (relation, either)
    if relation == "superfluous":
        assert one.recorded is None and one.simulated is not None
        assert one.simulated.parameters["amplitude"].value == pytest.approx(2.0 * SWING)
    told = answer_of(Comparison([one]), ("real.csv", "sim.csv"), Fit(1.0, 1.0), {}, None)
    text = told["findings"][0]["statement"]
    assert ("is not known" in text) == either
    assert text.startswith("sim.csv shows") == (relation == "superfluous")


def test_a_course_between_two_levels_about_nothing_is_no_bias() -> None:
    """Its lower level is where its form is zero, and not where the sensor has no error."""
    found, _, _ = found_in_pair(0.0, 1.0)
    assert "gyro_bias" not in {d.effect for d in found.discrepancies}


def test_the_bins_in_which_a_course_jumps_are_no_motion() -> None:
    """Their means lie between both levels, in motion as at rest."""
    _, residuals, hypothesis = found_in_pair(0.0, 1.0)
    left = left_in_motion(residuals, [hypothesis])
    assert left is not None and left.finding(residuals) is None


@pytest.mark.parametrize(("name", "driver"), [("gyro_bias_random_walk", "nothing"), ("unknown", NO_DRIVER)])
def test_wander_is_of_the_one_whose_own_rests_wander(name: str, driver: str) -> None:
    """A variance has no sign that would tell whose it is."""

    def wandering(force: Array, rate: Array) -> tuple[Array, Array]:
        steps = np.random.default_rng(3).normal(0.0, 5e-4 / np.sqrt(RATE), rate.shape)
        return force, rate + np.cumsum(steps, axis=0)

    exams = [examined(one, sought=()) for one in (turned(1), turned(2, wandering))]
    where, size = Where(0.0, 1.0, (0.0, 0.05), driver), Parameter([5e-4] * 3, None, "rad/s/sqrt(s)")
    density = "density" if name.endswith("walk") else "size"
    said = Finding(name, "gyro", ["x"], where, {density: size}, Evidence(50.0), [], "")
    pair = replace(exams[0], statements=[Stated(said)])
    found = Comparison([sole_discrepancy((said, True), 0.97)])
    (one,) = with_owner_of_unknown(found, pair, *exams).discrepancies
    assert (one.relation, one.of_either) == ("superfluous", False)
    (one,) = with_owner_of_unknown(found, pair, *exams[::-1]).discrepancies
    assert (one.relation, one.of_either) == ("lacking", False)
    (one,) = with_owner_of_unknown(found, pair, exams[0], exams[0]).discrepancies
    told = answer_of(Comparison([one]), ("real.csv", "sim.csv"), Fit(1.0, 1.0), {}, None)
    assert "is not known" in told["findings"][0]["statement"]


@pytest.mark.parametrize(
    ("own", "relation"),
    [
        ((False, True), "superfluous"),
        ((False, False), "lacking"),
        ((True, False), "lacking"),
        ((True, True), "too_large"),
    ],
)
def test_an_arm_that_the_simulation_alone_states_is_its_own(own: tuple[bool, bool], relation: str) -> None:
    """The readings differ by -30 mm, said to be the recording's; where both have one, it has less."""
    at = [0.05 if own[0] else 0.03, 0.0, 0.0]
    size = Parameter(at, [[x - 2e-3, x + 2e-3] for x in at], "m")
    said = Finding("lever_arm", "accel", ["x"], Where(0.0, 1.0, (0.0, 0.05), "turns"), {"position": size},
                   Evidence(50.0), [], "")  # fmt: skip
    alone = examined(turned(1), sought=())
    exams = [replace(alone, statements=[Stated(said)] if states else []) for states in own]
    part = (Part("position", "m", 3),)
    arm = Quantity("lever_arm", "accel", part, np.array([-0.03, 0.0, 0.0]), 1e-6 * np.eye(3), np.full(3, 0.1),
                   np.full(3, 1e-3), np.arange(3))  # fmt: skip
    apart = subtract(arm, replace(arm, value=np.zeros(3), covariance=np.zeros((3, 3))))
    found = Comparison([replace(sole_discrepancy((said, True), 0.97), difference=apart)])
    (one,) = with_owner_of_unknown(found, alone, *exams).discrepancies
    assert one.relation == relation and one.difference is not None
    assert one.of_either == (own == (False, False))
    if relation == "superfluous":
        assert one.difference.simulated.value == pytest.approx([0.03, 0.0, 0.0])
        assert not one.difference.recorded.value.any()
    if relation == "too_large":
        assert one.difference.simulated.value == pytest.approx([0.05, 0.0, 0.0])
        assert one.difference.recorded.value == pytest.approx([0.02, 0.0, 0.0])
        assert one.difference.value == pytest.approx([-0.03, 0.0, 0.0])
