"""What one recording alone has is stated by its own evidence, unless left-out parts speak against it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, subtract, weighed
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.comparison.stated import concluded
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Where

NAMES = ("real.csv", "sim.csv")


def judged(nats: float, gain: float, *, of_recording: bool = True) -> Comparison:
    """Return the conclusion of two recordings of which one alone has something unknown."""
    evidence = Evidence(nats, heldout_log_score_gain=gain, folds=5)
    where = Where(0.0, 1200.0, (0.0, 0.05), "rate of heating")
    alone = Finding("unknown", "accel", ["z"], where, {}, evidence, [], "Unknown effect.")
    return concluded([], [(alone, of_recording)], [], NAMES, among=4, checks=10)


@pytest.mark.parametrize(("of_recording", "relation"), [(True, "lacking"), (False, "superfluous")])
def test_a_small_gain_in_what_was_left_out_does_not_hide_what_is_sure(
    of_recording: bool, relation: str
) -> None:
    (found,) = judged(15.5, 0.6, of_recording=of_recording).discrepancies
    assert (found.effect, found.relation, found.log_bayes_factor) == ("unknown", relation, 15.5)
    assert found.probability > 0.999


def test_what_left_out_parts_contradict_is_undecided_and_says_why() -> None:
    said = judged(15.5, -0.6)
    assert said.discrepancies == []
    (undecided,) = said.undecided
    assert "does not predict the parts of the recording" in undecided.reason


@pytest.mark.parametrize(("of_recording", "who"), [(True, "real.csv"), (False, "sim.csv")])
def test_what_is_not_sure_is_undecided_with_its_probability(of_recording: bool, who: str) -> None:
    (undecided,) = judged(2.0, 2.0, of_recording=of_recording).undecided
    assert undecided.reason.startswith(f"{who} does not decide it: probability 0.")


def slope(value: float, error: float) -> Quantity:
    """Return a slope in temperature as one recording shows it, rad/s/K."""
    one = np.ones(1)
    return Quantity(
        "gyro_bias_temperature", "gyro", (Part("slope", "rad/s/K", 1),), value * one, np.array([[error**2]]),
        2e-3 * one, 1e-9 * one, np.zeros(1, dtype=np.int64),
        where=Where(0.0, 600.0, (0.0, 0.05), "temperature"),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("recorded", "simulated", "reason"),
    [
        (slope(4e-4, 1e-5), slope(-1e-4, 4e-4), "sim.csv: it does not tell whether it has it, as real.csv"),
        (slope(-1e-4, 4e-4), slope(4e-4, 1e-5), "real.csv: it does not tell whether it has it, as sim.csv"),
        (slope(4e-4, 1e-5), slope(4.1e-4, 1e-5), None),
    ],
)
def test_an_effect_that_only_one_of_the_two_shows_is_no_agreement(
    recorded: Quantity, simulated: Quantity, reason: str | None
) -> None:
    """The difference is within its error: an interval that holds no slope as well says nothing."""
    (pair,) = weighed([subtract(recorded, simulated)], 20)
    assert pair.agrees
    said = concluded([pair], [], [], NAMES, among=20, checks=20, had={("gyro_bias_temperature", "gyro")})
    assert said.discrepancies == []
    assert len(said.agreed) == (reason is None)
    assert [one.reason.startswith(reason or "") for one in said.undecided] == [True] * (reason is not None)


def test_what_only_the_simulation_has_is_where_the_simulation_shows_it() -> None:
    recorded, simulated = slope(0.0, 1e-5), slope(4e-4, 1e-5)
    its_own = Where(5000.0, 5300.0, (0.0, 0.05), "temperature")
    pairs = weighed([subtract(recorded, replace(simulated, where=its_own))], 20)
    said = concluded(pairs, [], [], NAMES, among=20, checks=20, had={("gyro_bias_temperature", "gyro")})
    (found,) = said.discrepancies
    assert (found.relation, found.where) == ("superfluous", its_own)


def densities(*value: float) -> Quantity:
    """Return densities of an accelerometer's white noise as one recording shows them."""
    return Quantity(
        "noise_level", "accel", (Part("density", "m/s^2/sqrt(Hz)", 3),), np.log(value), 1e-4 * np.eye(3),
        np.full(3, 1.0), np.full(3, 0.02), np.arange(3), logarithmic=True,
        where=Where(0.0, 600.0, (0.0, 50.0), "noise at rest"),
    )  # fmt: skip


def test_the_evidence_of_a_noise_that_differs_on_one_axis_has_the_name_of_its_statement() -> None:
    """What could not be put in counts in neither p by that name: noise on one axis alone counted in both."""
    pairs = weighed([subtract(densities(1e-3, 1e-3, 1e-3), densities(1e-3, 2.5e-3, 1e-3))], 20)
    said = concluded(pairs, [], [], NAMES, among=20, checks=20)
    (found,) = said.discrepancies
    assert found.effect == "noise_unequal_axes"
    assert said.p() < 1e-6 and said.p([found.effect]) == 1.0
