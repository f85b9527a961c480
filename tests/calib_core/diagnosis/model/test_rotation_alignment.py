"""Affine parameters of both sensors from few attitudes: turns tell what gravity's norm does not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.residuals import Norms, fit_baseline, linearised, rest_courses
from stillcal.calib_core.diagnosis.model.rotation_alignment import _apart, _nominal, aligned, tilted
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.diagnosis.segments.turns import cuts
from stillcal.calib_core.diagnosis.slow.turns.turn_residuals import telling, turn_residuals
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.support.diagnosis.turning import lively, ups

RATE, G = 50.0, 9.80665
SCALE = np.array([[1.02, 0.0, 0.0], [0.0, 0.985, 0.0], [0.0, 0.0, 1.01]])
BIAS = np.array([0.12, -0.2, 0.3])
GYRO = np.array([[1.02, 0.004, 0.0], [-0.006, 0.99, 0.003], [0.0, 0.002, 1.015]])


@cache
def day(seed: int = 2, rests: int = 40) -> tuple[Samples, Samples, Array]:
    """Return rests of 25 s in eight attitudes, a turn of 4 s between; and gravity (n, 3)."""
    rng = np.random.default_rng(seed)
    places = [Rotation.from_rotvec(v) for v in rng.normal(0.0, 0.8, (8, 3))]
    rates, n = [], round(25 * RATE)
    now = places[0]
    for _ in range(rests):
        target = places[rng.integers(8)]
        swell = np.sin(np.pi * (np.arange(round(4 * RATE)) + 0.5) / (4 * RATE)) ** 2
        turn = (now.inv() * target).as_rotvec()
        rates += [np.zeros((n, 3)), swell[:, None] / swell.sum() * RATE * turn]
        now = target
    rate = np.concatenate(rates)
    up = ups(places[0], rate, RATE)
    t = np.arange(len(rate)) / RATE
    force = (G * up) @ np.linalg.inv(SCALE).T + BIAS + rng.normal(0, 0.01, up.shape)
    spin = rate @ GYRO.T + 0.005 + rng.normal(0, 1e-3, up.shape)
    return (
        Samples.checked(Sensor.ACCELEROMETER, t, force),
        Samples.checked(Sensor.GYROSCOPE, t, spin),
        up,
    )


def test_few_attitudes_and_turns_tell_gravity_and_the_gyroscope() -> None:
    accelerometer, gyroscope, up = day()
    bins = cut(accelerometer, gyroscope)
    made = aligned(gyroscope, bins, G)
    norm_alone = fit_baseline(bins.force, bins.force_variance, bins.rest, G)
    truth = up[np.searchsorted(accelerometer.t, bins.t)]
    errors = []
    for up_of in (made.baseline.up, norm_alone.up):
        turn, _ = Rotation.align_vectors(truth, up_of)
        errors.append(float(np.sqrt(((turn.apply(up_of) - truth) ** 2).sum(axis=1).mean())))
    assert errors[0] < 1e-3 and errors[0] < errors[1] / 3.0, errors
    rotation, _ = Rotation.align_vectors(truth, made.baseline.up)
    frame = rotation.as_matrix()
    assert np.abs(made.mapping @ GYRO @ frame.T - frame.T).max() < 3e-3
    assert max(float(np.linalg.norm(t.miss)) for t in made.turns) < 5e-3


def test_what_few_turns_leave_unknown_of_the_gyroscopes_scale_holds_what_they_miss() -> None:
    """They missed by 2.8 times their error: what a fit of nine numbers leaves is less than the noise."""
    missed = []
    for seed in range(16):
        accelerometer, gyroscope, _ = day(seed, 13)
        made = aligned(gyroscope, cut(accelerometer, gyroscope), G)
        if made.errors is not None and len(made.turns) <= 12:
            error = np.diag(made.mapping @ GYRO - np.eye(3))
            missed.append(error / np.linalg.norm(made.errors[[9, 13, 17]], axis=1))
    assert len(missed) > 10
    assert 0.7 < np.sqrt(np.mean(np.square(missed))) < 1.4


@pytest.mark.parametrize("factor", [0.25, 8.0])
def test_rates_of_another_range_have_their_scale(factor: float) -> None:
    """A fit about the rates as read went nowhere: a scale of 2 was 1.4 with a tenth of every angle left."""
    accelerometer, gyroscope, _ = day()
    wrong = Samples.checked(Sensor.GYROSCOPE, gyroscope.t, factor * gyroscope.xyz)
    made = aligned(wrong, cut(accelerometer, wrong), G)
    usual = aligned(gyroscope, cut(accelerometer, gyroscope), G)
    np.testing.assert_allclose(factor * made.mapping, usual.mapping, atol=2e-3)


@pytest.mark.parametrize("change", [np.diag([1.05, 0.95, 1.1]), np.eye(3)[[1, 0, 2]]])
def test_what_is_no_other_range_is_fitted_about_the_rates_as_read(change: Array) -> None:
    """Scales of a part, and axes in another order, which no factor makes fit."""
    accelerometer, gyroscope, _ = day()
    other = Samples.checked(Sensor.GYROSCOPE, gyroscope.t, gyroscope.xyz @ change)
    bins = cut(accelerometer, other)
    parameters = fit_baseline(bins.force, bins.force_variance, bins.rest, G).parameters
    assert _nominal(cuts(other, bins), rest_courses(bins.force, bins.rest), parameters) == 1.0


@cache
def about_the_vertical(rests: int = 16) -> tuple[Samples, Samples]:
    """Return rests of 45 s in one attitude, and turns of 5 s by half a circle about the vertical between."""
    rng, place = np.random.default_rng(5), Rotation.from_rotvec([0.4, -0.7, 0.2])
    up = place.as_matrix()[2]
    swell = np.sin(np.pi * (np.arange(round(5 * RATE)) + 0.5) / (5 * RATE)) ** 2
    turn = swell[:, None] / swell.sum() * RATE * np.pi * up
    still = np.zeros((round(45 * RATE), 3))
    rate = np.concatenate([still, *[part for _ in range(rests - 1) for part in (turn, still)]])
    t = np.arange(len(rate)) / RATE
    wander = np.cumsum(rng.normal(0.0, 5e-6, rate.shape), axis=0)
    force = G * up + wander + rng.normal(0.0, 0.01, rate.shape)
    return (
        Samples.checked(Sensor.ACCELEROMETER, t, force),
        Samples.checked(Sensor.GYROSCOPE, t, rate + rng.normal(0.0, 1e-3, rate.shape)),
    )


def test_a_smaller_scale_is_no_better_fit_for_making_the_noise_smaller() -> None:
    """One attitude: a bias of -0.6 m/s^2, and the scale that makes up for it, shrank the noise by 7 %."""
    bins = cut(*about_the_vertical())
    made = fit_baseline(bins.force, bins.force_variance, bins.rest, G)
    assert abs(float(made.bias @ made.up[0])) < 0.1, made.parameters


def test_the_noise_of_a_corrected_norm_is_that_of_what_was_read_along_gravity() -> None:
    """A scale of one half on x halves the noise where x is up, and does nothing to it where z is."""
    norms = Norms(G * np.eye(3)[[0, 2]], np.array([100.0, 100.0]), G)
    weight, away = norms._weighed(linearised(norms.force, np.array([0.0, 0.0, 0.0, -0.5, *np.zeros(5)])))
    np.testing.assert_allclose(weight, [200.0, 100.0])
    np.testing.assert_allclose(away, [100.0 * G, 0.0], atol=1e-9)


def test_a_factor_of_the_rates_is_taken_from_three_turns_that_move_gravity_and_no_fewer() -> None:
    """One may fit any factor by chance."""
    accelerometer, gyroscope, _ = day()
    bins = cut(accelerometer, gyroscope)
    halved = Samples.checked(Sensor.GYROSCOPE, gyroscope.t, 0.25 * gyroscope.xyz)
    steady, x = rest_courses(bins.force, bins.rest), np.zeros(9)
    up, _ = tilted(steady, x)
    moved = [c for c in cuts(halved, bins) if _apart(up[c.first], up[c.first + 1]) > 1.0]
    assert [_nominal(moved[:n], steady, x) > 2.0 for n in (1, 2, 3)] == [False, False, True]


def test_turns_about_the_vertical_tell_neither_a_factor_nor_the_scale() -> None:
    """Gravity stays: rates of nothing fitted them, whatever its direction was taken to be."""
    accelerometer, gyroscope = about_the_vertical()
    bins = cut(accelerometer, gyroscope)
    found, steady = cuts(gyroscope, bins), rest_courses(bins.force, bins.rest)
    assert len(found) >= 9
    assert _nominal(found, steady, np.array([0.8, 1.5, -0.8, *np.zeros(6)])) == 1.0
    assert telling(aligned(gyroscope, bins, G)) == 0
    assert turn_residuals(aligned(gyroscope, bins, G), bins, G) is None


def test_turns_between_attitudes_tell_the_scale() -> None:
    accelerometer, gyroscope, _ = day()
    made = aligned(gyroscope, cut(accelerometer, gyroscope), G)
    assert telling(made) > 0.9 * len(made.turns)


@pytest.mark.parametrize(("errors", "told"), [(2.0, False), (4.0, True)])
def test_a_turn_tells_the_scale_where_its_axis_lies_off_gravity_by_three_errors(
    errors: float, told: bool
) -> None:
    accelerometer, gyroscope, _ = day()
    made = aligned(gyroscope, cut(accelerometer, gyroscope), G)
    turn = made.turns[0]
    turned = np.linalg.norm(np.einsum("nij,nj->i", turn.carried, turn.rate))
    off = np.linalg.norm(turn.by_scale()) / turned
    direction = np.sqrt(((turn.ends[1] @ made.unsure) ** 2).sum())
    unsure = made.unsure * off / (errors * direction)
    assert telling(replace(made, turns=[turn], unsure=unsure)) == told


def test_a_turn_that_reaches_the_limit_is_left_out_whatever_is_known_of_its_rate() -> None:
    """What is taken off a rate that stopped at the limit does not make it one that was measured."""
    _, gyroscope, _ = day()
    bins = cut(*day()[:2])
    limit = 0.9 * float(np.abs(gyroscope.xyz).max())
    fewer = cuts(gyroscope, bins, limit)
    assert 0 < len(fewer) < len(cuts(gyroscope, bins))
    assert len(cuts(gyroscope, bins, limit, lambda samples: 0.8 * samples.xyz)) == len(fewer)


def test_a_turn_of_which_the_end_was_not_recorded_is_left_out() -> None:
    """A long recording keeps the samples of some motion only: what was missing counted as no turn at all."""
    _, gyroscope, _ = day()
    bins = cut(*day()[:2])
    whole = cuts(gyroscope, bins)
    for t in (whole[3].t[0], whole[3].t[-1]):
        there = np.abs(gyroscope.t - t) > 1.0
        fewer = cuts(gyroscope[np.flatnonzero(there)], bins)
        assert [c.first for c in fewer] == [c.first for c in whole if c.first != whole[3].first]


def test_the_scale_holds_where_25_samples_a_second_do_not_tell_all_of_a_turn() -> None:
    """Without what is between samples it was off by 0.0021, twice its error, which is a quarter now."""
    off, errors = [], []
    for seed in range(6):
        force, spin = lively(seed)
        made = aligned(spin, cut(force, spin), G)
        assert made.errors is not None
        off.append(made.mapping - np.eye(3))
        errors.append(np.linalg.norm(made.errors[9:], axis=1).reshape(3, 3))
    assert np.max(errors) < 1e-3
    assert np.sqrt(np.mean(np.square(np.divide(off, errors)))) < 2.0
