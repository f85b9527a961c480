"""The acceptance rule: a new calibration against the old one on held-out rests."""

from __future__ import annotations

import tracemalloc
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from stillcal.calib_core.calibration.acceptance import (
    Comparison,
    compare_on_held_out_rests,
    compare_residuals,
    decide,
    flipped_share,
    with_decision,
)
from stillcal.calib_core.calibration.candidate import CalibrateSettings, Candidate, fit_candidate
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState

SETTINGS = QualitySettings()


def test_a_better_calibration_wins_and_an_equal_one_seldom() -> None:
    rng = np.random.default_rng(3)
    sd = np.full(20, 0.01)
    wins = 0
    for _ in range(400):
        noise = rng.normal(0, 0.01, 20)
        wins += compare_residuals(
            noise + rng.normal(0, 0.003, 20), noise + rng.normal(0, 0.003, 20), sd, SETTINGS
        ).better
    # The test's own 2.5 %; 400 trials, three standard errors either way.
    assert abs(wins / 400 - 0.025) < 3 * np.sqrt(0.025 * 0.975 / 400)
    drifted = compare_residuals(rng.normal(0.05, 0.01, 20), rng.normal(0, 0.01, 20), sd, SETTINGS)
    assert drifted.better and drifted.rms_new < drifted.rms_old


def test_too_few_held_out_rests_decide_nothing() -> None:
    few = compare_residuals(np.full(3, 0.1), np.zeros(3), np.full(3, 0.01), SETTINGS)
    assert not few.better and few.rests == 3
    one_sided = compare_residuals(np.full(6, 0.1), np.zeros(6), np.full(6, 0.01), SETTINGS)
    assert one_sided.better and one_sided.chance == 2.0**-6
    assert not compare_residuals(np.empty(0), np.empty(0), np.empty(0), SETTINGS).better


# The sign-flip test, against all sign patterns written out


def share_by_hand(gains: list[float]) -> float:
    """Return the share of all sign patterns whose sum is at least that of the gains."""
    sums = [
        sum(s * g for s, g in zip(signs, gains, strict=True)) for signs in product((1, -1), repeat=len(gains))
    ]
    return float(np.mean([total >= sum(gains) - 1e-9 for total in sums]))


def with_gains(gains: list[float]) -> Comparison:
    """Compare residuals that give these log scores: old^2 - new^2 = 2 sd^2 gain."""
    sd = np.full(len(gains), 0.5)
    old = np.sqrt(np.maximum(np.array(gains), 0.0) * 2 * sd**2)
    new = np.sqrt(np.maximum(-np.array(gains), 0.0) * 2 * sd**2)
    return compare_residuals(old, new, sd, SETTINGS)


@pytest.mark.parametrize(
    "gains",
    [
        [1.0],
        [1.0, 2.0, 4.0],
        [1.0, -2.0, 4.0, 0.5],
        [-1.0, 2.0, 0.5, -0.75],
        [1.0] * 6,
        [3.0, 1.0, 1.0, 1.0, 1.0, 1.0, -0.5],
        [0.3, 0.1, 0.7, -0.2, 0.9, 0.4, 0.8, -0.6, 0.5, 1.1, 0.2, 0.05],
    ],
)
def test_the_chance_is_the_share_of_swaps_that_gain_as_much(gains: list[float]) -> None:
    found = with_gains(gains)
    assert found.chance == pytest.approx(share_by_hand(gains), abs=1e-12)
    assert found.gain == pytest.approx(np.mean(gains))
    assert found.rests == len(gains)


def test_up_to_twelve_attitudes_all_patterns_are_tried_and_from_thirteen_4096_are_drawn() -> None:
    """All gains alike: only the unchanged pattern gains as much, the one that is always among the drawn."""
    assert with_gains([1.0] * 12).chance == 2.0**-12
    drawn = with_gains([1.0] * 13).chance * 4097  # half a pattern drawn is the unchanged one, on average
    assert drawn == pytest.approx(round(drawn)) and 1 <= round(drawn) <= 5
    assert with_gains([1.0] * 30).chance == pytest.approx(1 / 4097)


def test_drawn_patterns_estimate_the_share_of_all() -> None:
    """Standard error of a share of 4096 drawn patterns: sqrt(p (1 - p) / 4096), 0.0034 at 0.05."""
    rng = np.random.default_rng(8)
    for _ in range(5):
        gains = rng.normal(0.4, 1.0, 14).tolist()
        true = share_by_hand(gains)
        found = with_gains(gains).chance
        assert abs(found - true) < 5 * np.sqrt(true * (1 - true) / 4096) + 1 / 4097
        assert found == with_gains(gains).chance  # drawn by a fixed seed


def test_the_residuals_roots_and_the_gain_are_those_of_the_definitions() -> None:
    found = compare_residuals(np.array([0.3, -0.4]), np.array([0.1, 0.0]), np.array([0.1, 0.2]), SETTINGS)
    assert found.rms_old == pytest.approx(np.sqrt((0.09 + 0.16) / 2))
    assert found.rms_new == pytest.approx(np.sqrt(0.01 / 2))
    assert found.gain == pytest.approx(((0.09 - 0.01) / 0.02 + 0.16 / 0.08) / 2)
    nothing = compare_residuals(np.empty(0), np.empty(0), np.empty(0), SETTINGS)
    assert (nothing.rests, nothing.gain, nothing.chance) == (0, 0.0, 1.0)
    assert (nothing.rms_old, nothing.rms_new) == (0.0, 0.0)


@pytest.mark.parametrize(("chance", "better"), [(2.0**-6, True), (2.0**-6 - 1e-9, False)])
def test_a_chance_equal_to_the_settings_is_enough(chance: float, better: bool) -> None:
    settings = QualitySettings(chance=0.025, held_out_rests=6)
    object.__setattr__(settings, "chance", chance)  # six rests alone could not be asked for less
    found = compare_residuals(np.ones(6), np.zeros(6), np.ones(6), settings)
    assert found.chance == 2.0**-6 and found.better is better


def test_as_many_attitudes_as_the_settings_ask_for_decide() -> None:
    asking = QualitySettings(held_out_rests=8)
    for n, better in ((7, False), (8, True)):
        assert compare_residuals(np.ones(n), np.zeros(n), np.ones(n), asking).better is better


# The rule on whole candidates

G = 9.80665
TRUE = np.diag([1.02, 0.99, 1.01])
BIAS = np.array([0.3, -0.2, 0.1])
X = np.array([1.0, 0.0, 0.0])


def pool(attitudes: int, start: float, seed: int, bias: NDArray[np.float64] = BIAS, each: int = 1) -> Pool:
    """Rests in random attitudes, `each` so many, every 100 s from `start` on, with noise of 1 mm/s^2."""
    rng = np.random.default_rng(seed)
    up = np.repeat(rng.normal(size=(attitudes, 3)), each, axis=0)
    force = G * up / np.linalg.norm(up, axis=1, keepdims=True) @ np.linalg.inv(TRUE).T + bias
    sd = np.full(3, 1e-3)
    rests = [
        RestState(start + 100.0 * k, start + 100.0 * k + 10.0, 500, f + rng.normal(0, 1e-3, 3), sd, sd, 1e-3)
        for k, f in enumerate(force)
    ]
    return Pool(tuple(HeldRest(rest, Gravity(G, 0.0, "given")) for rest in rests))


def candidate(gathered: Pool, t: float = 1e5) -> Candidate:
    return fit_candidate(gathered, Gravity(G, 0.0, "given"), t, CalibrateSettings())


def old_record(bias: NDArray[np.float64], fitted_at: float | None = 0.0) -> CalibrationRecord:
    part = AccelerometerRecord(scale=TRUE, bias=bias, parameters=9, gravity=G)
    return CalibrationRecord(accelerometer=part, gyroscope=None, fitted_at=fitted_at)


def test_a_first_calibration_is_accepted() -> None:
    new = candidate(pool(20, 0.0, 1))
    gyroscope = GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3)
    bare = CalibrationRecord(accelerometer=None, gyroscope=gyroscope)
    for old in (None, bare):
        decision = decide(new, old, False, SETTINGS)
        assert decision.accepted and decision.settled and decision.reason == "the first calibration"
        assert decision.evidence == {"rms_residual": new.accelerometer.rms_residual}


def test_a_better_one_replaces_and_an_equal_one_does_not() -> None:
    new = candidate(pool(20, 0.0, 1))
    wrong = decide(new, old_record(BIAS + 0.1 * X), False, SETTINGS)
    assert wrong.accepted and wrong.reason.startswith("better by more than chance: held-out rms ")
    assert wrong.evidence["held_out_rests"] == 20 and wrong.evidence["held_out_better"] is True
    true = decide(new, old_record(BIAS), False, SETTINGS)
    assert not true.accepted and true.settled
    assert true.reason.startswith("not better by more than chance: held-out rms ")


@pytest.mark.parametrize(("fresh", "settled"), [(5, False), (6, True)])
def test_an_old_one_that_stays_is_sound_where_six_attitudes_were_held_out(fresh: int, settled: bool) -> None:
    gathered = pool(20, 0.0, 1)
    since = gathered.held[20 - fresh].rest.t_start
    decision = decide(candidate(gathered), old_record(BIAS, since), False, SETTINGS)
    assert decision.evidence["held_out_rests"] == fresh
    assert (decision.accepted, decision.settled) == (False, settled)


def test_a_rest_counts_as_held_out_from_the_second_of_the_old_fit_on() -> None:
    gathered = pool(20, 0.0, 1)
    t = gathered.held[10].rest.t_start
    new, settings = candidate(gathered), SETTINGS
    old = SensorModel.of(TRUE, BIAS)
    assert compare_on_held_out_rests(new, old, t, settings).rests == 10
    assert compare_on_held_out_rests(new, old, np.nextafter(t, 1e9), settings).rests == 9
    assert compare_on_held_out_rests(new, old, None, settings).rests == 20


def test_rests_of_one_attitude_count_once_as_their_mean() -> None:
    new = candidate(pool(20, 0.0, 1, each=3))
    found = compare_on_held_out_rests(new, SensorModel.of(TRUE, BIAS), None, SETTINGS)
    assert found.rests == 20
    assert found.rms_old == pytest.approx(1e-3 / np.sqrt(3), rel=0.4)  # sd of an sd on 20 values: 16 %


def test_after_a_failed_check_the_new_one_only_has_to_be_no_worse() -> None:
    """Four attitudes held out decide nothing by chance; a degraded calibration goes all the same."""
    gathered = pool(20, 0.0, 1)
    since = gathered.held[16].rest.t_start
    new, drifted = candidate(gathered), old_record(BIAS + 0.05 * X, since)
    assert not decide(new, drifted, False, SETTINGS).accepted
    degraded = decide(new, drifted, True, SETTINGS)
    assert degraded.accepted and degraded.reason.startswith("the old one failed its check: ")
    exact = old_record(BIAS, since)
    truth = decide(new, exact, True, SETTINGS)
    assert truth.accepted == (
        truth.evidence["held_out_rms_new"] < truth.evidence["held_out_rms_old"]  # type: ignore[operator]
    )
    nothing = decide(new, old_record(BIAS + 0.05 * X, 1e9), True, SETTINGS)
    assert (nothing.accepted, nothing.settled, nothing.evidence["held_out_rests"]) == (False, False, 0)


def test_a_candidate_is_judged_on_rests_it_was_not_fitted_to() -> None:
    """One rest in a wrong place: fitted to it the candidate would look better than it is."""
    gathered = pool(11, 0.0, 5)
    new = candidate(gathered)
    found = compare_on_held_out_rests(new, SensorModel.of(TRUE, BIAS), None, SETTINGS)
    assert found.rms_new > 1.3 * new.accelerometer.rms_residual  # 11 attitudes, 9 parameters


def test_the_reason_and_the_figures_go_into_the_record() -> None:
    new = candidate(pool(20, 0.0, 1))
    decision = decide(new, old_record(BIAS), False, SETTINGS)
    record = with_decision(new, decision, "hourly check")
    assert record.acceptance is not None and record.acceptance.reason == decision.reason
    assert record.acceptance.evidence == {"occasion": "hourly check", **decision.evidence}
    assert record.accelerometer is new.record.accelerometer


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_unchanged_pattern_is_among_those_that_reach_the_sum(sign: float) -> None:
    """All gains of one sign: one pattern in 2^n reaches the sum from above, and all of them from below."""
    gains = sign * np.array([0.1, 0.2, 0.3, 0.7, 0.9])
    assert flipped_share(gains) == (1 / 32 if sign > 0 else 1.0)


def test_the_signs_of_a_months_hours_take_little_memory() -> None:
    gains = np.random.default_rng(0).normal(0.2, 1.0, 700)
    drawn = np.random.default_rng(700).integers(0, 2, (4096, 700))
    signs = np.vstack((np.ones(700, dtype=np.int64), 1 - 2 * drawn))
    tracemalloc.start()
    share = flipped_share(gains)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert share == np.mean(signs @ gains >= gains.sum() - 1e-9)
    assert peak < 4e6
