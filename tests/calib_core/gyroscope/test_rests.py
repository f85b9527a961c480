"""What rests give the gyroscope: bias with its caveats, zeroing, and the turns cut between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gyroscope.bias import bias_from_rests, rotation_admitted, update_bias
from stillcal.calib_core.gyroscope.rotation_segment import (
    NoSegment,
    RotationSegment,
    RotationSegmentSettings,
    cut_rotation_segment,
    excursion,
)
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState, directions
from stillcal.calib_core.streams.samples import Samples, Sensor

G = 9.80665
BIAS = np.array([0.02, -0.15, 0.08])


def rest(
    t: float, up: Array, rate: Array, sd: float = 1e-5, spin: float | None = 1e-3, tilt: float = 1e-5
) -> RestState:
    force = G * np.asarray(up, dtype=float) / np.linalg.norm(up)
    unit = np.ones(3)
    return RestState(
        t, t + 3.0, 300, force, 0.02 * unit, 1e-3 * unit, 0.02, rate, 3e-3 * unit, sd * unit, 3e-3, tilt, spin
    )


def rests(rng: np.random.Generator, n: int, sd: float = 1e-5, wander: float = 0.0) -> list[RestState]:
    noise = rng.normal(size=(n, 3)) * np.hypot(sd, wander)
    return [rest(10.0 * k, rng.normal(size=3), BIAS + noise[k], sd) for k in range(n)]


def test_bias_is_recovered_as_closely_as_it_says() -> None:
    """300 values: the share within 1.96 standard uncertainties has a standard error of 0.0126."""
    z = []
    for seed in range(100):
        found = bias_from_rests(rests(np.random.default_rng(seed), 12, wander=3e-5))
        z.append((found.bias - BIAS) / np.sqrt(np.diag(found.covariance)))
    assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=3 * 0.0126)


def test_wander_between_rests_is_told_from_noise() -> None:
    """Of 200 rests the scatter is known to 5 %: two standard errors are a wander of 0.45 of the noise."""
    rng = np.random.default_rng(1)
    np.testing.assert_allclose(bias_from_rests(rests(rng, 200, wander=1e-4)).wander, 1e-4, rtol=0.15)
    assert (bias_from_rests(rests(rng, 200)).wander < 0.45e-5).all()


def test_a_rest_that_spun_stands_out_against_the_others() -> None:
    rng = np.random.default_rng(2)
    all_rests = rests(rng, 10)
    up = all_rests[4].specific_force / G
    all_rests[4] = rest(40.0, up, BIAS + 0.01 * up)
    found = bias_from_rests(all_rests)
    assert found.outliers == (4,)
    np.testing.assert_allclose(found.bias, BIAS, atol=2e-5)


def test_attitudes_that_all_disagree_leave_a_bias_and_say_how_uncertain_it_is() -> None:
    """Five rests on each axis, turned about it by as much: each is far from the median on its own axis."""
    turned = [rest(10.0 * k, np.eye(3)[k % 3], BIAS + 1e-3 * np.eye(3)[k % 3]) for k in range(15)]
    turned = [structs.replace(r, rate=r.rate + 1e-7 * k) for k, r in enumerate(turned)]
    found = bias_from_rests(turned)
    assert found.outliers == () and found.n_rests == 15
    np.testing.assert_allclose(found.bias, BIAS + 1e-3 / 3, atol=1e-6)
    assert (found.wander > 3e-4).all()


def test_outliers_point_into_the_rests_given_even_where_some_have_no_rates() -> None:
    rng = np.random.default_rng(3)
    all_rests = rests(rng, 10)
    all_rests[2] = structs.replace(all_rests[2], rate=None, rate_uncertainty=None)
    all_rests[7] = rest(70.0, np.array([0, 0, 1.0]), BIAS + 0.05)
    found = bias_from_rests(all_rests)
    assert (found.outliers, found.n_rests) == ((7,), 9)


def test_one_attitude_admits_its_spin_about_the_vertical() -> None:
    up = np.array([0.0, 0.6, 0.8])
    found = bias_from_rests([rest(10.0 * k, up, BIAS, spin=2e-3) for k in range(5)])
    tilt_left = 1e-5
    expected = 2e-3 * np.abs(up)  # all five may have turned alike
    np.testing.assert_allclose(found.undetected_rotation_bound, expected, atol=2 * tilt_left)


def test_what_all_rests_of_an_attitude_share_is_within_the_bound() -> None:
    """Four attitudes of five rests, each attitude on something that turns at its own rate."""
    rng, inside = np.random.default_rng(6), []
    for _ in range(200):
        ups = directions(rng.normal(size=(4, 3)))
        spins = 1e-3 * rng.normal(size=4)
        found = bias_from_rests(
            [rest(10.0 * k, ups[k % 4], BIAS + spins[k % 4] * ups[k % 4], spin=1e-3) for k in range(20)]
        )
        sd = np.hypot(np.sqrt(np.diag(found.covariance)), found.undetected_rotation_bound)
        inside.append(np.abs(found.bias - BIAS) < 1.96 * sd)
    assert np.mean(inside) > 0.9


@pytest.mark.parametrize("spin", [0.0, 5e-4])
def test_rests_of_earlier_attitudes_bound_what_spin_moved_the_bias_by(spin: float) -> None:
    """An hour in one attitude admits its spin; against rests in others, no more than the bias has moved."""
    rng, up = np.random.default_rng(7), np.array([0.0, 0.0, 1.0])
    flat = [rest(1e4 + 60.0 * k, up, BIAS + spin * up, spin=5e-3) for k in range(60)]
    hour = bias_from_rests(flat)
    assert hour.undetected_rotation_bound[2] == pytest.approx(5e-3, rel=0.01)
    for others in (rests(rng, 40), [*rests(rng, 40), *flat]):  # the hour's own rests are no majority
        admitted = rotation_admitted(hour.bias, hour.undetected_rotation_bound, others)
        assert spin <= admitted[2] < spin + 4e-5


def test_unbounded_spin_in_one_attitude_leaves_that_axis_open() -> None:
    found = bias_from_rests([rest(10.0 * k, np.array([0, 0, 1.0]), BIAS, spin=None) for k in range(5)])
    assert np.isinf(found.undetected_rotation_bound[2])
    assert (found.undetected_rotation_bound[:2] < 2e-5).all()


def test_other_attitudes_bound_what_spin_may_have_hidden() -> None:
    ups = [np.array(u, dtype=float) for u in ((0, 0, 1), (0, 1, 0), (1, 0, 0))]
    found = bias_from_rests([rest(10.0 * k, up, BIAS, spin=None) for k, up in enumerate(ups)])
    assert (found.undetected_rotation_bound < 2e-5).all()


@given(st.permutations(range(8)))
def test_bias_does_not_depend_on_the_order_of_rests(order: list[int]) -> None:
    given_rests = rests(np.random.default_rng(4), 8)
    found, again = bias_from_rests(given_rests), bias_from_rests([given_rests[i] for i in order])
    np.testing.assert_allclose(again.bias, found.bias, atol=1e-15)
    np.testing.assert_allclose(again.undetected_rotation_bound, found.undetected_rotation_bound, rtol=1e-9)


def test_no_rates_no_bias() -> None:
    with pytest.raises(NotSupported, match="no rest has a gyroscope mean"):
        bias_from_rests([structs.replace(rest(0.0, np.array([0, 0, 1.0]), BIAS), rate=None)])


def test_zeroing_renews_the_bias_and_keeps_the_scale() -> None:
    model = SensorModel.of(np.diag([1.02, 0.98, 1.01]), BIAS + 0.01)
    renewed, estimate = update_bias(model, rests(np.random.default_rng(5), 3))
    np.testing.assert_array_equal(renewed.scale, model.scale)
    np.testing.assert_allclose(renewed.bias, BIAS, atol=5e-5)
    assert estimate.n_rests == 3


def test_zeroing_against_a_known_bias_weighs_both() -> None:
    rng = np.random.default_rng(6)
    known = bias_from_rests(rests(rng, 40))
    poor = [rest(500.0, np.array([0, 0, 1.0]), known.bias + 1e-3, sd=1e-3)]
    renewed, estimate = update_bias(SensorModel.identity(), poor, known)
    assert (np.abs(renewed.bias - known.bias) < 1e-5).all()
    assert (np.diag(estimate.covariance) <= np.diag(known.covariance + np.diag(known.wander**2))).all()
    good = [rest(500.0, np.array([0, 0, 1.0]), known.bias + 1e-3, sd=1e-6)]
    drifting = replace(known, wander=np.full(3, 1e-3))
    renewed, _ = update_bias(SensorModel.identity(), good, drifting)
    np.testing.assert_allclose(renewed.bias, known.bias + 1e-3, atol=1e-5)


def gyro(t: Array, rate: float = 1.0) -> Samples:
    """Rate about x between 3 and 5 s, bias elsewhere."""
    turning = ((t > 3.0) & (t < 5.0)) * rate
    return Samples.checked(Sensor.GYROSCOPE, t, BIAS + turning[:, None] * np.array([1.0, 0, 0]))


BEFORE, AFTER = rest(0.0, np.array([0, 0, 1.0]), BIAS), rest(5.0, np.array([0, 1.0, 0]), BIAS)
STAMPS = np.arange(0.0, 8.0, 0.01)


def test_a_turn_reaches_from_within_one_rest_to_within_the_next() -> None:
    turn = cut_rotation_segment(BEFORE, AFTER, gyro(STAMPS))
    assert isinstance(turn, RotationSegment)
    assert turn.t_start == pytest.approx(2.9, abs=0.011)
    assert turn.t_end == pytest.approx(5.1, abs=0.011)
    assert turn.rates.shape == (turn.t.size, 3)
    assert excursion(turn.t, turn.rates - BIAS) == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize(
    ("before", "after", "samples", "why"),
    [
        (AFTER, BEFORE, gyro(STAMPS), NoSegment.DISORDERED),
        (structs.replace(BEFORE, rate=None), AFTER, gyro(STAMPS), NoSegment.NO_RATES),
        (BEFORE, AFTER, gyro(STAMPS[(STAMPS < 3.5) | (STAMPS > 3.7)]), NoSegment.GAP),
        (BEFORE, AFTER, gyro(STAMPS[STAMPS > 3.5]), NoSegment.NOT_COVERED),
        (BEFORE, AFTER, gyro(STAMPS[STAMPS < 4.5]), NoSegment.NOT_COVERED),
        (BEFORE, AFTER, Samples.empty(Sensor.GYROSCOPE), NoSegment.NOT_COVERED),
        (
            BEFORE,
            structs.replace(AFTER, t_start=500.0, t_end=503.0),
            gyro(np.arange(0, 600, 0.01)),
            NoSegment.TOO_LONG,
        ),
        (BEFORE, AFTER, gyro(STAMPS, rate=0.1), NoSegment.TOO_SMALL),
    ],
    ids=lambda v: v.name if isinstance(v, NoSegment) else "",
)
def test_no_turn_says_why(before: RestState, after: RestState, samples: Samples, why: NoSegment) -> None:
    assert cut_rotation_segment(before, after, samples) is why


def test_turning_there_and_back_is_a_turn() -> None:
    rates = np.where(STAMPS < 4.0, 1.0, -1.0) * ((STAMPS > 3.0) & (STAMPS < 5.0))
    there_and_back = Samples.checked(Sensor.GYROSCOPE, STAMPS, BIAS + rates[:, None] * np.array([0, 1.0, 0]))
    assert isinstance(cut_rotation_segment(BEFORE, AFTER, there_and_back), RotationSegment)


@pytest.mark.parametrize(
    "change", [{"margin": -0.1}, {"max_duration": 0.0}, {"max_gap": -1.0}, {"min_angle": 0.0}]
)
def test_settings_out_of_range_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        RotationSegmentSettings(**change)
