"""What is left of a pair where it moves: nothing of what is alike there, all of what is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.pair.measured import _constants
from stillcal.calib_core.diagnosis.comparison.pair.motion import Motion, left_in_motion
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import _of_steps, pair_residuals
from stillcal.calib_core.diagnosis.comparison.pair.search import _searched
from stillcal.calib_core.diagnosis.inference.likelihood import Fit, fit_hypothesis
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.slow.search import reduce_residuals
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.diagnosis.pair.paired import noise_at_rest, rounding
from stillcal.replay.diagnosis.pair.readings import less, mean_readings
from stillcal.replay.formats.trace import Recording
from tests.support.diagnosis.turned_pairs import RATE, REST, Flaw, perfect, turned

SCALE = np.eye(3) + np.array([[0.01, 0.004, 0.0], [0.0, -0.02, 0.0], [0.003, 0.0, 0.01]])


def by_sensor(
    flaw: Flaw = perfect, seed: int = 1, *, mismatch: float = 0.0, rest: float = REST
) -> list[SensorResiduals]:
    real, simulated = turned(seed, flaw, rest=rest), turned(100 + seed, rest=rest)
    true = mean_readings(real, [simulated])
    return pair_residuals(less(real, true), true, [], mismatch)[1]


def judged(residuals: SensorResiduals) -> Motion:
    found = left_in_motion(residuals)
    assert found is not None
    return found


def other_gain_for_positive_rates(force: Array, rate: Array) -> tuple[Array, Array]:
    return force, rate + 0.015 * np.maximum(rate, 0.0)


def rate_in_force(force: Array, rate: Array) -> tuple[Array, Array]:
    return force + 0.15 * rate[:, [1, 2, 0]], rate


def of_scale_and_bias(force: Array, rate: Array) -> tuple[Array, Array]:
    return force @ SCALE.T + 0.05, rate @ SCALE.T + 0.002


@pytest.mark.parametrize("flaw", [perfect, of_scale_and_bias])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_bias_scale_and_noise_do_leaves_nothing(flaw: Flaw, seed: int) -> None:
    for residuals in by_sensor(flaw, seed):
        assert judged(residuals).finding(residuals) is None


@pytest.mark.parametrize(
    ("flaw", "flawed"), [(other_gain_for_positive_rates, "gyro"), (rate_in_force, "accel")]
)
def test_what_no_scale_explains_is_found_and_is_the_bins_that_move(flaw: Flaw, flawed: str) -> None:
    for residuals in by_sensor(flaw):
        said = judged(residuals).finding(residuals)
        if residuals.sensor != flawed:
            assert said is None
            continue
        assert said is not None
        assert (said.effect, said.where.driver, said.axes) == ("unknown", "motion", ["x", "y", "z"])
        moving = residuals.views[0].moving
        assert moving is not None
        for view, size in zip(residuals.views, np.asarray(said.parameters["rms"].value), strict=True):
            left = view.left()[moving > 0.0]
            assert 0.5 < size / np.sqrt((left**2).mean()) < 2.0


def test_an_excess_is_taken_for_what_chance_left_only_below_its_own_noise() -> None:
    """Added to the bins in motion: a third of their noise is chance, three times their noise is not."""
    (_, residuals) = by_sensor()
    rng = np.random.default_rng(5)
    for part, stated in ((0.3, False), (3.0, True)):
        for view in residuals.views:
            assert view.moving is not None
            away = rng.normal(size=view.t.size) * view.moving * np.sqrt(view.variance)
            view.y[0] += part * away
        assert (judged(residuals).finding(residuals) is not None) is stated


def test_motion_is_not_judged_without_rests_and_not_of_a_witness() -> None:
    assert all(left_in_motion(residuals) is None for residuals in by_sensor(mismatch=0.01))
    assert all(
        left_in_motion(residuals) is None for residuals in by_sensor(other_gain_for_positive_rates, rest=1.0)
    )


def hovering(force: Array, rate: Array) -> tuple[Array, Array]:
    """Return the force of a level device that sways slowly over a few coarse steps."""
    t, moves = np.arange(len(force)) / RATE, np.linalg.norm(rate, axis=1) > 0.05
    sway = 0.3 * moves[:, None] * np.sin(2.0 * np.pi * t[:, None] / np.array([11.0, 13.0, 17.0]))
    return sway + np.array([0.02, -0.03, 9.81]), rate


def hovering_with_bias(force: Array, rate: Array) -> tuple[Array, Array]:
    force, rate = hovering(force, rate)
    return force + np.array([0.02, -0.02, 0.02]), rate


def in_steps(recording: Recording, step: float) -> Recording:
    own = recording.accelerometer
    return replace(recording, accelerometer=replace(own, xyz=frozen(np.rint(own.xyz / step) * step)))


def test_what_coarse_steps_leave_of_a_motion_is_no_difference_of_the_sensors() -> None:
    both = [in_steps(turned(seed, flaw), 0.08) for seed, flaw in ((1, hovering_with_bias), (101, hovering))]
    true = mean_readings(both[0], both[1:])
    apart = less(both[0], true)
    steps = rounding([examined(one, sought=()) for one in both])
    for known, stated in ((steps, False), (None, True)):
        (accel, _) = pair_residuals(apart, true, [], 0.0, rounding=known)[1]
        assert (judged(accel).finding(accel) is not None) is stated


def test_the_noise_of_what_stands_for_the_true_input_is_that_of_its_rests() -> None:
    known = noise_at_rest(examined(turned(1), sought=()))
    assert known["accel"] == pytest.approx(np.full(3, 0.008**2), rel=0.1)
    assert known["gyro"] == pytest.approx(np.full(3, 5e-4**2), rel=0.1)


def test_more_than_coarse_steps_leave_is_found_on_its_axes() -> None:
    (accel, _) = by_sensor(rate_in_force)
    sizes = np.sqrt(judged(accel).variance)
    limits = sizes * np.array([0.5, 2.0, 0.5])
    said = judged(accel).finding(replace(accel, bins=replace(accel.bins, force_rounding=limits)))
    assert said is not None
    assert said.axes == ["x", "z"]
    of_filters = judged(accel).finding(replace(accel, unsure=limits))
    assert of_filters is not None and said is not None and of_filters.axes == said.axes
    all_lower = replace(accel, bins=replace(accel.bins, force_rounding=2.0 * sizes))
    assert judged(accel).finding(all_lower) is None


def test_bins_that_read_one_code_at_rest_are_not_known_better_than_the_steps_of_single_samples() -> None:
    """Steps of 0.45 m/s^2 hide a noise of 0.008: at rest both read the same, and in motion they never do."""
    both = [in_steps(turned(seed), 0.45) for seed in (1, 101)]
    steps = rounding([examined(one, sought=()) for one in both])
    true = mean_readings(both[0], both[1:])
    (accel, _) = pair_residuals(less(both[0], true), true, [], 0.0, rounding=steps)[1]
    samples = RATE * accel.views[0].duration
    for axis, view in enumerate(accel.views):
        of_steps = 0.45**2 / 6.0 / samples
        assert (view.variance >= 0.999 * of_steps).all(), "of both, step^2 / 12 each"
        moving = view.moving is not None and view.moving > 0.0
        np.testing.assert_allclose(view.variance[~moving], of_steps[~moving], rtol=0.5)
        assert np.mean(view.y[0, moving] ** 2 / view.variance[moving]) < 2.0, axis
    assert judged(accel).finding(accel) is None
    bare = pair_residuals(less(both[0], true), true, [], 0.0)[1][0]
    assert (bare.views[0].variance < 1e-9).any()


@pytest.mark.parametrize("both_coarse", [True, False])
def test_what_steps_leave_of_a_rest_is_one_error_of_all_its_bins(both_coarse: bool) -> None:
    """A bias of 0.1 m/s^2 in steps of 0.45: each rest is off by its own part of a step, long or short."""
    one = in_steps(turned(1, lambda force, rate: (force + 0.1, rate)), 0.45)
    other = in_steps(turned(101), 0.45) if both_coarse else turned(101)
    steps = rounding([examined(each, sought=()) for each in (one, other)])
    true = mean_readings(one, [other])
    (accel, gyro) = pair_residuals(less(one, true), true, [], 0.0, rounding=steps)[1]
    assert gyro.views[0].shared == ()
    for axis, view in enumerate(accel.views):
        (columns,) = view.shared
        group = columns.argmax(axis=1)
        assert view.moving is not None
        still = view.moving == 0.0
        of_each = steps["accel"][axis] * np.where(still, 1.0, np.sqrt(2.0))
        np.testing.assert_allclose(columns.sum(axis=1), of_each)
        rests, moved = set(group[still]), group[~still]
        assert len(set(moved)) == moved.size
        assert not rests & set(moved)
        off = np.array([view.y[0, group == k].mean() - view.y[0, still].mean() for k in rests])
        within = np.concatenate([view.y[0, group == k] - view.y[0, group == k].mean() for k in rests])
        assert 0.5 < np.sqrt((off**2).mean()) / steps["accel"][axis] < 1.5
        assert np.sqrt((within**2).mean()) < 0.2 * steps["accel"][axis]


def test_all_bins_of_a_gyroscope_share_an_error_of_steps_besides() -> None:
    """It reads its bias in each rest, which steps put on one value: that was told as another bias."""
    moving = np.array([0.0, 0.0, 1.0, 1.0, 0.0])
    own, common = _of_steps("gyro", moving, 2.0)
    assert own.tolist() == (2.0 * np.eye(4)[[0, 0, 1, 2, 3]]).tolist()
    assert common.tolist() == [[2.0]] * 5
    assert len(_of_steps("accel", moving, 2.0)) == 1
    assert _of_steps("gyro", moving, 0.0) == ()


def _of_constants(residuals: SensorResiduals) -> tuple[Fit, Array]:
    """Return the fit of biases and gains, and the sizes of its unit."""
    views = tuple(replace(v, absorbed=None, baseline=v.baseline[:, :, :0]) for v in residuals.views)
    constants = _constants(residuals)
    return fit_hypothesis(reduce_residuals(replace(residuals, views=views), [constants]), 0), constants.sizes


@pytest.mark.parametrize("step", [0.15, 0.3, 0.45])
def test_scales_in_steps_that_hide_the_noise_are_off_by_their_errors(step: float) -> None:
    """They were by 1.3 to 1.7: steps that leave nothing within rests were taken for smaller ones."""
    off = []
    for motion in range(8):
        one = in_steps(turned(1, lambda force, rate: (1.01 * force, rate), motion=motion), step)
        other = in_steps(turned(101, motion=motion), step)
        true, rounded = mean_readings(one, [other]), {"accel": np.full(3, step / np.sqrt(6.0))}
        (accel, _) = pair_residuals(less(one, true), true, [], 0.0, rounding=rounded)[1]
        fit, sizes = _of_constants(accel)
        away = fit.beta * sizes - np.append(np.zeros(3), 0.01 * np.eye(3))
        off.append(away / (np.sqrt(fit.covariance.diagonal()) * sizes))
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.15


def test_a_gyroscopes_scale_shows_in_spite_of_steps_that_motion_dithers() -> None:
    """Were the error of its steps known as the accelerometer's is, 2 % would be lost in it."""

    def in_steps_of_rate(recording: Recording) -> Recording:
        assert recording.gyroscope is not None
        xyz = frozen(0.02 * np.rint(recording.gyroscope.xyz / 0.02))
        return replace(recording, gyroscope=replace(recording.gyroscope, xyz=xyz))

    scaled = turned(1, lambda force, rate: (force, 1.02 * rate))
    both = [in_steps_of_rate(r) for r in (scaled, turned(101))]
    true, rounded = mean_readings(both[0], both[1:]), {"gyro": np.full(3, 0.02 / np.sqrt(6.0))}
    (_, gyro) = pair_residuals(less(both[0], true), true, [], 0.0, rounding=rounded)[1]
    fit, sizes = _of_constants(gyro)
    errors = np.sqrt(fit.covariance.diagonal()) * sizes
    gains, errors = (fit.beta * sizes)[[3, 7, 11]], errors[[3, 7, 11]]
    assert ((gains / errors) ** 2).sum() > 16.3, "chance exceeds it once in 1000"


TO_GRAVITY = 1e-4 * np.array([[0.2, 3.0, -4.0], [-3.0, -6.0, -5.0], [3.0, 1.5, -1.0]])
"""(rad/s)/(m/s^2), of a gyroscope that is sensitive to gravity."""


def sensitive_to_gravity(force: Array, rate: Array) -> tuple[Array, Array]:
    return force, rate + force @ TO_GRAVITY.T


def three_times_as_sensitive(force: Array, rate: Array) -> tuple[Array, Array]:
    return force, rate + 3.0 * force @ TO_GRAVITY.T


def of_gravity(rest: float, turns: int) -> SensorResiduals:
    """Return the gyroscope's residuals where the other one is three times as sensitive to gravity."""
    real = turned(1, sensitive_to_gravity, rest=rest, turns=turns)
    simulated = turned(101, three_times_as_sensitive, rest=rest, turns=turns)
    true = mean_readings(real, [simulated])
    return pair_residuals(less(real, true), true, [], 0.0)[1][1]


def test_what_a_gyroscope_reads_at_rest_is_no_input() -> None:
    residuals = of_gravity(REST, 6)
    rate, moving = residuals.bins.rate, residuals.views[0].moving
    assert rate is not None and moving is not None
    assert not rate[moving == 0.0].any()
    assert np.linalg.norm(rate[moving == 1.0], axis=1).max() > 0.1


@pytest.mark.slow
def test_errors_at_rest_that_differ_by_a_factor_are_no_scale() -> None:
    """Every rest here fits a scale of a third, and there are many for each turn."""
    _, stated = _searched(of_gravity(60.0, 8))
    assert [s.finding.effect for s in stated] == ["gyro_g_sensitivity"]
    matrix = np.asarray(stated[0].finding.parameters["matrix"].value)
    assert np.abs(matrix + 2.0 * TO_GRAVITY).max() < 5e-5


@pytest.mark.slow
def test_bins_in_motion_tell_once_what_they_differed_by_is_found() -> None:
    """The noise of the rests alone looks like a saw here."""
    _, stated = _searched(of_gravity(REST, 12))
    assert [s.finding.effect for s in stated] == ["gyro_g_sensitivity"]
