"""A run shows a cause or it does not: each line that is drawn, from both sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.claim import Cause, Verdict
from stillcal.replay.studies.collin2019 import bias_prediction, pedestrian_tables
from stillcal.replay.studies.grammenos2018 import classes, gravity, gyroscope_bias, homogeneity
from stillcal.replay.studies.grammenos2018.slices import WAYS, Accuracy, Roc
from stillcal.replay.studies.stisen2015 import biases, washing_machine
from stillcal.replay.studies.stisen2015.remedies import claims as remedies
from stillcal.replay.studies.stisen2015.washing_machine import Delivery

STEADY = np.array([-0.1, 0.1] * 5)
"""Scatter of ten people or folds that says little."""


@pytest.mark.parametrize("factor, shown", [(0.49, False), (0.51, True), (1.9, True), (2.1, False)])
def test_a_bias_accounts_for_what_is_half_to_twice_its_effect(factor: float, shown: bool) -> None:
    measured = np.array([1.0, 5.0, 20.0])
    assert gyroscope_bias.accounts(factor * measured, measured) is shown


def test_table_2_is_met_by_all_four_powers() -> None:
    printed = [1.00, 0.50, 0.33, 0.25]
    assert pedestrian_tables._as_table_2(printed)
    for k in range(4):
        assert not pedestrian_tables._as_table_2([p + 0.01 * (n == k) for n, p in enumerate(printed)])


def test_the_baseline_is_met_by_all_three_accuracies() -> None:
    assert classes._near_baseline(0.84, 0.88, 0.89)
    assert not any(classes._near_baseline(*figures) for figures in ((0.86, 0.92, 0.85), (0.8, 0.86, 0.85)))
    assert not classes._near_baseline(0.80, 0.92, 0.91)


def test_the_range_is_the_paper_s_at_both_ends() -> None:
    assert biases._as_printed(np.array([-0.08, 0.0, 0.07]))
    assert not biases._as_printed(np.array([-0.10, 0.0, 0.075]))
    assert not biases._as_printed(np.array([-0.085, 0.0, 0.09]))


@pytest.mark.parametrize(
    "together, shown",
    [((0.3, 0.1, 0.0), True), ((0.1, 0.3, 0.0), False), ((0.1, 0.0, 0.3), False)],
)
def test_memory_must_help_where_means_correlate(together: tuple[float, ...], shown: bool) -> None:
    sure = np.array([[1.1, 1.3], [0.9, 1.1], [0.8, 1.2]])
    found = bias_prediction.Real(np.full(3, 1.5), np.full(3, 1.2), sure, np.array(together), 600)
    cause = bias_prediction._real(found).cause
    assert cause is not None
    assert cause.shown is shown


def test_memory_that_helps_nowhere_shows_nothing() -> None:
    sure = np.array([[0.9, 1.1]] * 3)
    found = bias_prediction.Real(np.ones(3), np.ones(3), sure, np.array([0.3, 0.1, 0.0]), 600)
    assert not bias_prediction._only_where_correlated(found)


def test_groups_help_where_one_family_gains_and_none_loses() -> None:
    gain, nothing, loss = 2.0 + STEADY, 0.0 + STEADY, -2.0 + STEADY
    assert remedies._helps(np.array([gain, nothing, nothing]))
    assert not remedies._helps(np.array([nothing, nothing, nothing]))
    assert not remedies._helps(np.array([gain, loss, nothing]))


@pytest.mark.parametrize("together, shown", [(0.95, True), (0.85, False)])
def test_stamps_given_at_delivery_follow_it(together: float, shown: bool) -> None:
    good = Delivery(bulks=1.0, outages=1.0, even=0.9, together=0.1, late=10.0, interval=10.0)
    late = replace(good, even=0.5, together=together)
    even = washing_machine._claims({"a 1": good, "b 1": late})[1]
    assert even.verdict is Verdict.DIFFERS
    assert even.cause is not None
    assert even.cause.shown is shown


def traces(devices: tuple[float, ...], levelled: tuple[float, ...]) -> homogeneity.Homogeneity:
    """Return the MSE of ten people by step; people and devices together as nothing had helped."""
    people = np.ones((10, 1))
    return homogeneity.Homogeneity(people * devices, np.ones((10, 4)), people * levelled, people * levelled)


@pytest.mark.parametrize("left, shown", [(0.5, True), (0.9, False)])
def test_people_hide_what_calibration_does_to_devices(left: float, shown: bool) -> None:
    found = traces((1.0, 1.0, left, left), (1.0,) * 4)
    claim = homogeneity._moving("walk", found, "data", np.random.default_rng(0))
    assert claim.verdict is Verdict.DIFFERS
    assert claim.cause is not None
    assert claim.cause.shown is shown


@pytest.mark.parametrize(
    "smooth, alone, whole, verdict",
    [
        (0.95, 0.70, 0.68, Verdict.REPRODUCED),
        (0.76, 0.99, 0.75, Verdict.DIFFERS),  # the filter's
        (0.95, 0.50, 0.48, Verdict.DIFFERS),  # too much
    ],
)
def test_calibration_itself_must_lower_the_error(
    smooth: float, alone: float, whole: float, verdict: Verdict
) -> None:
    people = np.ones((10, 1)) * (1.0, smooth, alone, whole)
    found = homogeneity.Homogeneity(people, people, people, people)
    assert homogeneity._moving("walk", found, "data", np.random.default_rng(0)).verdict is verdict


@pytest.mark.parametrize("upright, verdict", [(1e-5, True), (1e-3, False)])
def test_norms_must_keep_a_bias_out_where_nothing_is_level(upright: float, verdict: bool) -> None:
    effect, alone = np.array([-0.002, 0.003, 0.0, 0.004, 0.001, 0.0]), np.full(6, upright)
    vertical, norm, others = pedestrian_tables._bias_claims(effect, alone)
    assert [c.verdict for c in (vertical, norm, others)] == [
        Verdict.REPRODUCED,
        Verdict.DIFFERS,
        Verdict.REPRODUCED,
    ]
    assert norm.cause is not None
    assert norm.cause.shown is verdict


@pytest.mark.parametrize("left, shown", [(1.05, True), (0.5, False)])
def test_the_level_is_the_cause_where_nothing_else_changes(left: float, shown: bool) -> None:
    rest = homogeneity.Rest(np.ones((6, 3)), 0.1 * np.ones((6, 3)), np.ones((6, 2)), 1)
    own = traces((1.0,) * 4, (1.0, 1.0, 1.0, left))
    sit = replace(own, mixed=np.ones((10, 1)) * (1.0, 1.0, 1.0, 0.5))
    claim = homogeneity._rest(rest, sit, "data", np.random.default_rng(0))
    assert claim.verdict is Verdict.DIFFERS
    assert claim.cause is not None
    assert claim.cause.shown is shown


def accuracy(**gains: float) -> Accuracy:
    """Return the accuracy of ten people by way, raw 0.8, others as they gain, points."""
    columns = [0.8 + 0.01 * gains.get(way.replace(" ", "_"), 0.0) + 0.001 * STEADY for way in WAYS]
    return Accuracy(np.stack(columns, axis=1), np.full(len(WAYS), 0.9))


def claim_of_gains(most: float) -> Cause:
    """Return the cause for the first pair where a faultless device gains so many points."""
    pair = classes.PAIRS[0]
    mixed = {(pair, name): accuracy(no_errors=most) for name in classes.LEARNERS}
    mixed[pair, "louder"] = accuracy()
    cause = classes._gains(pair, mixed, "data").cause
    assert cause is not None
    return cause


def test_no_calibration_gains_more_than_a_faultless_device() -> None:
    """Table 6 has gains of 2 points and more there."""
    assert claim_of_gains(1.5).shown
    assert not claim_of_gains(2.5).shown


def test_a_filter_that_gains_the_most_is_what_is_compared() -> None:
    def mixed(filtered: float, calibrated: float) -> dict[tuple[tuple[str, str], str], Accuracy]:
        own = accuracy(filtered=filtered, calibrated=calibrated)
        return {(pair, name): own for pair in classes.PAIRS for name in classes.LEARNERS}

    for gains, shown in (((2.0, 0.5), True), ((2.0, 1.5), False)):
        cause = classes._kalman(mixed(*gains), "data").cause
        assert cause is not None
        assert cause.shown is shown


@pytest.mark.parametrize("best, shown", [(0.0, True), (0.05, False)])
def test_curves_cannot_rise_above_those_of_a_faultless_device(best: float, shown: bool) -> None:
    areas: Array = np.stack([0.9 + 0.0 * STEADY, 0.9 + 0.0 * STEADY, 0.9 + best + 0.01 * STEADY], axis=1)
    line = (np.array([0.0, 1.0]),) * 3
    rocs = {pair: Roc(line, line, areas) for pair in classes.FIGURES}
    cause = classes._roc(rocs, "data").cause
    assert cause is not None
    assert cause.shown is shown


@pytest.mark.parametrize("as_printed, shown", [(0.06, True), (0.04, False), (0.94, True), (0.96, False)])
def test_an_order_is_chance_where_samples_of_people_have_it_both_ways(as_printed: float, shown: bool) -> None:
    """Of traces that are brought to 0 and 1."""
    up, walk = {("stairs up", "stairs down"): 0.1}, {("stairs up", "stairs down"): 0.3}
    other = {("walk", "stairs up"): 0.2, ("walk", "stairs down"): 0.05, ("sit", "stand"): 0.0}
    drawn = [(up if k < 100 * as_printed else walk) | other for k in range(100)]
    found = homogeneity.Similar(walk | other, [walk | other], walk | other, drawn)
    order = homogeneity._similar(found)[1]
    assert order.verdict is Verdict.DIFFERS
    assert order.explained is shown


@pytest.mark.parametrize("real, shown", [((99.0, 17.0), True), ((99.0, 68.0), False), ((66.0, 17.0), False)])
def test_real_rests_are_a_cause_where_the_paper_s_ratio_lies_among_theirs(
    real: tuple[float, float], shown: bool
) -> None:
    costs = gravity.Costs(np.ones((3, 2)), np.ones((3, 1)) * (265.0, 1.0), np.ones((3, 2)))
    claim = gravity._judged(costs, np.array([[ratio, 1.0] for ratio in real]))
    assert claim.verdict is Verdict.DIFFERS
    assert claim.explained is shown
    assert not gravity._judged(costs, np.empty((0, 2))).explained


def deviations(values: Array) -> biases.Deviations:
    """Return deviations of devices with six faces each, as shares of g."""
    faces, devices = np.array(biases._FACES), [f"d{k}" for k in range(len(values) // 6)]
    name = np.repeat(devices, 6)
    return biases.Deviations(biases.G * values, np.tile(faces, len(devices)), name, name)


@pytest.mark.parametrize("rare, shown", [(1, True), (39, False)])
def test_the_range_hangs_on_a_device_that_not_every_choice_has(rare: int, shown: bool) -> None:
    """Devices from -8 to +7 % of g, and one, or all but one, from -10.3 to +8 %."""
    values = np.tile([-0.08, 0.07, 0.0, 0.0, 0.0, 0.0], (40, 1))
    values[:rare, 2:4] = -0.103, 0.08
    claim = biases._range(deviations(values.ravel()))
    assert claim.verdict is Verdict.DIFFERS
    assert claim.explained is shown


@pytest.mark.parametrize("flat, shown", [(0.04, True), (0.02, False)])
def test_two_spreads_are_a_cause_of_what_no_normal_distribution_fits(flat: float, shown: bool) -> None:
    """Normal on flat faces and on edges, twice as wide on the former; alike, with tails that neither has."""
    rng = np.random.default_rng(3)
    faces = rng.normal(size=(60, 6)) * np.array([flat, flat, 0.012, 0.012, 0.012, 0.012])
    if not shown:
        faces = 0.02 * rng.standard_t(2, size=(60, 6))
    claim = biases._gaussian(deviations(faces.ravel()))
    assert claim.verdict is Verdict.DIFFERS
    assert claim.explained is shown


def test_a_classifier_that_is_not_standardised_is_a_cause_where_it_gains_more_than_each_network() -> None:
    for gain, shown in ((3.0, True), (1.0, False)):
        mixed = {(pair, name): accuracy(calibrated_and_filtered=1.0) for pair in classes.PAIRS
                 for name in classes.LEARNERS}  # fmt: skip
        plain = Accuracy(
            np.stack([0.8 + 0.0 * STEADY, 0.8 + 0.01 * gain + 0.001 * STEADY], axis=1), np.ones(2)
        )
        claim = classes._svm(mixed | {(pair, "plain"): plain for pair in classes.PAIRS}, "data")
        assert claim.verdict is Verdict.DIFFERS
        assert claim.explained is shown


@pytest.mark.parametrize("less, verdict", [(0.5, Verdict.REPRODUCED), (-0.5, Verdict.DIFFERS)])
def test_more_units_do_worse_where_a_pair_gains_less(less: float, verdict: Verdict) -> None:
    own = {"25": accuracy(calibrated_and_filtered=1.0), "50": accuracy(calibrated_and_filtered=1.0 - less)}
    own |= {"100": own["25"]}
    mixed = {(pair, name): found for pair in classes.PAIRS for name, found in own.items()}
    for units in (25, 100):
        for how in ("long", "few"):
            mixed[classes.PAIRS[2], f"{units}, {how}"] = accuracy()
    assert classes._overfit(mixed, "data").verdict is verdict
