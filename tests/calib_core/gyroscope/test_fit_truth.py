"""Gyroscope from rest to rest against known truth: recovery, honest intervals, gross errors, bad turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from scipy.spatial.transform import Rotation

from stillcal.calib_core.codec import packed, plain, unpacked
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.gyroscope.fit import GyroscopeFit, GyroscopeSettings, Parameters
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.gyroscope.solver import Problem
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState
from tests.support.turned_phones import ACCEL, G, recorded, recording, some_phone


@pytest.mark.parametrize("rate_hz", [25.0, 50.0, 100.0, 200.0])
def test_truth_is_recovered_within_stated_uncertainties(rate_hz: float) -> None:
    trip = recording(1, n=30, rate_hz=rate_hz)
    fitted = trip.fit()
    assert fitted.parameters is Parameters.FULL9
    assert fitted.missing == ()
    assert fitted.rejected == ()
    assert np.abs(trip.z(fitted)).max() < 4.0
    assert np.abs(fitted.model.scale - trip.phone.scale).max() < 5e-4
    bias_sd = np.sqrt(np.diag(fitted.covariance)[9:])
    assert (np.abs(fitted.model.bias - trip.phone.bias) < 4.0 * bias_sd).all()
    assert fitted.rms_after < fitted.rms_before / 50
    assert fitted.gravity_rms_after == pytest.approx(G * fitted.rms_after)


def coverage(seeds: range, n: int, **changes: object) -> tuple[float, float]:
    """Share of scale elements and of biases whose 95 % interval holds the truth."""
    inside, bias_inside = [], []
    for seed in seeds:
        trip = recording(seed, n, **changes)
        fitted = trip.fit()
        inside.append(np.abs(trip.z(fitted)) < 1.96)
        sd = np.sqrt(np.diag(fitted.covariance)[9:])
        bias_inside.append(np.abs(fitted.model.bias - trip.phone.bias) < 1.96 * sd)
    return float(np.mean(inside)), float(np.mean(bias_inside))


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """80 phones, 720 scale elements, 240 biases: two standard errors are 0.016 and 0.028 about 0.95."""
    scale, bias = coverage(range(100, 180), n=16)
    assert 0.93 <= scale <= 0.98
    assert 0.91 <= bias <= 0.99


@pytest.mark.slow
def test_intervals_hold_with_g_sensitivity_and_wandering_bias() -> None:
    """60 phones whose bias follows force (0.1 deg/s per g) and walks 2e-4 rad/s from rest to rest."""
    sensitivity = np.random.default_rng(7).normal(size=(3, 3)) * 1.8e-4
    scale, _ = coverage(range(200, 260), n=20, sensitivity=sensitivity, wander=2e-4)
    assert 0.92 <= scale <= 0.985


def test_g_sensitivity_is_found_and_taken_off() -> None:
    sensitivity = np.random.default_rng(8).normal(size=(3, 3)) * 1.8e-4
    trip = recording(9, n=30, sensitivity=sensitivity)
    fitted = trip.fit()
    z = (fitted.g_sensitivity - sensitivity) / fitted.g_sensitivity_uncertainty
    assert np.abs(z).max() < 4.0
    assert np.abs(trip.z(fitted)).max() < 4.0
    blind = trip.fit(settings=GyroscopeSettings(g_sensitivity=1e-9))
    assert fitted.rms_after < blind.rms_after / 2


@pytest.mark.parametrize("gross", [0.8, 0.87, 1.15, 1.31])
def test_a_grossly_wrong_nominal_scale_is_found(gross: float) -> None:
    rng = np.random.default_rng(10)
    phone = some_phone(rng)
    trip = recorded(rng, replace(phone, scale=gross * phone.scale), 24)
    fitted = trip.fit()
    assert np.abs(trip.z(fitted)).max() < 4.5
    assert fitted.iterations < 20


@pytest.mark.parametrize("bad", [0, 7, 13])
def test_one_bad_turn_is_left_out(bad: int) -> None:
    """The phone was turned by 0.2 rad while the gyroscope was clipped: gravity arrives elsewhere."""
    trip = recording(11, n=20)
    turn = trip.turns[bad]
    clipped = replace(turn, rates=np.clip(turn.rates, *np.quantile(turn.rates, (0.1, 0.9), axis=0)))
    spoilt = [*trip.turns[:bad], clipped, *trip.turns[bad + 1 :]]
    fitted = replace(trip, turns=spoilt).fit()
    assert fitted.rejected == (bad,)
    assert np.abs(trip.z(fitted)).max() < 4.5
    assert fitted.rms_after < 1e-3


def test_coning_at_25_hz_leaves_nothing_of_its_own() -> None:
    """Without noise the integrator's own error is left: below a tenth of a real gyroscope's noise."""
    trip = recording(12, n=20, rate_hz=25.0, density=1e-9, force_density=1e-9)
    fitted = trip.fit()
    assert fitted.rms_after < 3e-5
    assert np.abs(fitted.model.scale - trip.phone.scale).max() < 2e-5


def test_slopes_agree_with_numeric_differences() -> None:
    trip = recording(13, n=6, rate_hz=200.0, sensitivity=np.full((3, 3), 1e-4))
    problem = Problem.of(trip.turns, ACCEL, GyroscopeSettings())
    theta = np.concatenate((trip.phone.scale.ravel(), (1e-3, -2e-3, 1e-3)))
    slopes = problem.at(theta, 0.0).slopes
    for i in range(12):
        step = np.zeros(12)
        step[i] = 1e-6
        ahead, behind = (problem.at(theta + d, 0.0).propagated.residuals for d in (step, -step))
        np.testing.assert_allclose(slopes[..., i], (ahead - behind) / 2e-6, atol=1e-3)


def test_the_frame_is_the_accelerometers() -> None:
    """An accelerometer model turned by Q turns the gyroscope's by Q: only together do they mean anything."""
    trip = recording(14, n=16)
    q = Rotation.from_rotvec([0.02, -0.01, 0.015]).as_matrix()
    turned = gyroscope.fit(trip.turns, SensorModel.of(q, np.zeros(3)), G)
    np.testing.assert_allclose(turned.model.scale, q @ trip.fit().model.scale, atol=1e-6)


def test_the_order_of_turns_does_not_matter() -> None:
    trip = recording(15, n=16)
    backwards = gyroscope.fit(trip.turns[::-1], ACCEL, G)
    np.testing.assert_allclose(backwards.model.scale, trip.fit().model.scale, atol=1e-9)


def test_held_out_turns_are_judged_like_fitted_ones() -> None:
    trip = recording(16, n=40)
    fitted = trip.fit()
    np.testing.assert_allclose(
        gyroscope.residuals(trip.turns, ACCEL, fitted.model.scale, fitted.shift), fitted.after, atol=2e-6
    )
    half = gyroscope.fit(trip.turns[::2], ACCEL, G)
    held_out = gyroscope.residuals(trip.turns[1::2], ACCEL, half.model.scale, half.shift)
    degrees = 1.0 - 12 / (2 * len(half.after))
    assert np.sqrt(np.mean(held_out**2)) < 1.3 * half.rms_after / np.sqrt(degrees)


def test_rests_that_claim_no_noise_do_not_break_the_fit() -> None:
    """Coarse steps can make a rest's samples all alike: its claimed uncertainty is then zero."""
    trip = recording(23, n=16, density=1e-9, force_density=1e-9)
    none = np.zeros(3)

    def silent(rest: RestState) -> RestState:
        return structs.replace(
            rest, force_uncertainty=none, rate_uncertainty=none, force_sd=none, rate_sd=none
        )

    turns = [replace(turn, before=silent(turn.before), after=silent(turn.after)) for turn in trip.turns]
    np.testing.assert_allclose(gyroscope.fit(turns, ACCEL, G).model.scale, trip.phone.scale, atol=2e-5)


def test_turns_and_fits_survive_storing() -> None:
    trip = recording(21, n=12)
    again = [unpacked(packed(turn), RotationSegment) for turn in trip.turns]
    fitted = gyroscope.fit(again, ACCEL, G)
    assert plain(fitted) == plain(trip.fit())
    assert plain(unpacked(packed(fitted), GyroscopeFit)) == plain(fitted)
