"""Both sides of each line that the fit draws; its covariance, weights and counts by plain formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer import observability
from stillcal.calib_core.accelerometer.equations import Solution, pooling
from stillcal.calib_core.accelerometer.fit import AccelerometerSettings, AttitudesMissing, task_of
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.levenberg_marquardt import Damping

G = 9.81
SCALE = np.array([[1.02, 0.004, -0.006], [0.004, 0.985, 0.003], [-0.006, 0.003, 1.01]])
BIAS = np.array([0.3, -0.2, 0.5])
FACES = np.vstack((np.eye(3), -np.eye(3)))
EDGES = np.array([[1, 1, 0], [1, 0, 1], [0, 1, 1], [1, -1, 0]]) / np.sqrt(2)


def directions(n, seed=0):
    up = np.random.default_rng(seed).normal(size=(n, 3))
    return up / np.linalg.norm(up, axis=1, keepdims=True)


def raw_of(up, scale=SCALE, bias=BIAS):
    return G * up @ np.linalg.inv(scale).T + bias


def fitted(raw, sd=None, parameters=9, **changes):
    sds = None if sd is None else np.broadcast_to(sd, raw.shape)
    return accelerometer.fit(raw, sds, G, parameters=parameters, settings=AccelerometerSettings(**changes))


# Settings


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("attitude_angle", 0.0, 1.0),
        ("max_amplification", 1.0, np.inf),
        ("max_norm_sd", 0.0, np.inf),
        ("spare_attitudes", 0, 100),
        ("outlier_level", 0.0, 0.5),
        ("max_outliers", 0.0, 0.5),
        ("max_bias", 0.0, np.inf),
        ("max_scale_error", 0.0, 1.0),
        ("rounds", 1, 1000),
    ],
)
def test_settings_are_taken_up_to_their_limits(name, low, high):
    for value in (low, high):
        assert getattr(AccelerometerSettings(**{name: value}), name) == value
    beyond = [low - 1e-9, np.nan] + ([high + 1e-9] if np.isfinite(high) else [])
    for value in beyond:
        with pytest.raises(ValueError, match=f"{name} = "):
            AccelerometerSettings(**{name: value})


def test_rests_within_five_degrees_share_an_attitude():
    assert np.degrees(AccelerometerSettings().attitude_angle) == pytest.approx(5.0, abs=1e-3)
    up = directions(20)
    for degrees, states in ((4.9, 20), (5.1, 21)):
        axis = np.cross(up[0], [0.0, 0.0, 1.0])
        axis /= np.linalg.norm(axis)
        angle = np.radians(degrees)
        turned = up[0] * np.cos(angle) + np.cross(axis, up[0]) * np.sin(angle)
        assert fitted(G * np.vstack([up, turned])).n_states == states


# What the attitudes support


def test_auto_takes_nine_parameters_from_ten_attitudes_on():
    """Nine and one to spare, so that the fit can be checked at all."""
    ten = np.vstack([FACES, EDGES])
    assert observability.amplification(ten[:9], 9) < 5.0
    six = np.diag(np.diag(SCALE))
    for n, spare, parameters in ((10, 1, 9), (9, 1, 6), (9, 0, 9)):
        settings = AccelerometerSettings(spare_attitudes=spare)
        assert accelerometer.fit(raw_of(ten[:n], six), None, G, settings=settings).parameters == parameters


def test_the_worst_direction_may_be_known_so_much_worse_than_a_rest():
    up = directions(12, seed=4)
    limit = observability.amplification(up, 9)
    assert fitted(G * up, max_amplification=limit * 1.001).parameters == 9
    with pytest.raises(AttitudesMissing, match="too similar") as refusal:
        fitted(G * up, max_amplification=limit * 0.999)
    assert f"{limit:.3g}" in refusal.value.reason and len(refusal.value.attitudes) > 0


def test_too_few_attitudes_are_counted_and_nothing_more_is_said():
    with pytest.raises(AttitudesMissing) as refusal:
        fitted(raw_of(directions(8)))
    assert refusal.value.reason == "8 distinct attitudes do not support 9 parameters"
    with pytest.raises(AttitudesMissing, match=r"^5 distinct attitudes do not support 6 parameters; needed"):
        fitted(raw_of(FACES[:5]), parameters=6)


def test_just_enough_attitudes_that_lie_badly_are_said_to() -> None:
    nine = np.vstack([FACES, EDGES[:3]])
    with pytest.raises(AttitudesMissing, match="too similar"):
        fitted(raw_of(nine), max_amplification=1.5)


def test_twelve_parameters_are_symmetric_whatever_form_is_asked_for() -> None:
    raw = raw_of(directions(20))
    for form, symmetric in (("symmetric", True), ("triangular", True)):
        fit = accelerometer.fit(raw, None, G, parameters=12, form=form)
        assert np.allclose(fit.model.scale, fit.model.scale.T) == symmetric
        assert fit.form == "symmetric" and len(fit.names) == 12
    assert accelerometer.fit(raw, None, G, parameters=9, form="triangular").form == "triangular"


def test_what_the_fit_would_leave_open_is_limited():
    raw = raw_of(directions(15))
    worst = fitted(raw, 0.05, max_norm_sd=np.inf).worst_norm_uncertainty
    assert fitted(raw, 0.05, max_norm_sd=worst * 1.001).parameters == 9
    with pytest.raises(AttitudesMissing, match="along the worst direction") as refusal:
        fitted(raw, 0.05, max_norm_sd=worst * 0.999)
    assert len(refusal.value.attitudes) == 1 and f"{worst:.2g}" in refusal.value.reason


# What is no phone's accelerometer


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_bias_of_five_is_the_largest_taken(axis, sign):
    up = directions(30)
    for bias, taken in ((4.99, True), (5.01, False)):
        raw = raw_of(up, np.eye(3), sign * bias * np.eye(3)[axis])
        if taken:
            assert fitted(raw).model.bias[axis] == pytest.approx(sign * bias, abs=1e-6)
        else:
            with pytest.raises(NotSupported, match="no phone's accelerometer"):
                fitted(raw)


@pytest.mark.parametrize(("scale", "taken"), [(1.299, True), (1.301, False), (0.701, True), (0.699, False)])
def test_a_scale_error_of_thirty_per_cent_is_the_largest_taken(scale, taken):
    raw = raw_of(directions(40), np.diag([1.0, scale, 1.0]), np.zeros(3))
    if taken:
        assert fitted(raw, max_amplification=50.0).model.scale[1, 1] == pytest.approx(scale, abs=1e-6)
    else:
        with pytest.raises(NotSupported, match="no phone's accelerometer"):
            fitted(raw, max_amplification=50.0)


def test_a_fit_that_did_not_converge_is_refused():
    with pytest.raises(NotSupported, match="did not converge"):
        fitted(raw_of(directions(20)), damping=Damping(iterations=1), rounds=1)


@pytest.mark.parametrize(("norm", "multiples"), [(0.49, False), (0.51, True), (1.99, True), (2.01, False)])
def test_forces_of_about_one_are_taken_for_multiples_of_g(norm, multiples):
    with pytest.raises(NotSupported) as refusal:
        fitted(norm * directions(20))
    assert ("multiples of g" in refusal.value.reason) == multiples


def test_empty_lists_are_no_rest_and_no_error():
    with pytest.raises(AttitudesMissing, match="there is no rest"):
        accelerometer.fit([], [], G)


def test_arrays_are_checked_for_shape_and_sign():
    raw = raw_of(directions(20))
    assert accelerometer.fit(raw, np.zeros((20, 3)), G, 0.0).parameters == 9
    for bad in (
        {"uncertainties": np.full((20, 3), -1e-9)},
        {"uncertainties": np.full((20, 3), np.inf)},
        {"gravity": 0.0},
        {"gravity": np.inf},
        {"gravity_uncertainty": -1e-9},
    ):
        given = {"uncertainties": None, "gravity": G, "gravity_uncertainty": 0.0} | bad
        with pytest.raises(ValueError, match=r"uncertainties must be|gravity must be"):
            accelerometer.fit(raw, **given)


# Weights and covariance


def norm_slopes(raw):
    """Derivatives of the calibrated norm, m/s^2, by bias and the six elements of a symmetric scale."""

    def norms(v):
        s = np.array([[v[3], v[6], v[7]], [v[6], v[4], v[8]], [v[7], v[8], v[5]]])
        return np.linalg.norm((raw - v[:3]) @ s.T, axis=1)

    at = np.r_[BIAS, np.diag(SCALE), SCALE[0, 1], SCALE[0, 2], SCALE[1, 2]]
    return np.column_stack([(norms(at + d) - norms(at - d)) / 2e-6 for d in 1e-6 * np.eye(9)])


def own_variances(raw, sd):
    """Variance of each norm, of a rest's own mean: along gravity, through the scale."""
    calibrated = (raw - BIAS) @ SCALE.T
    along = calibrated / np.linalg.norm(calibrated, axis=1, keepdims=True) @ SCALE
    return ((along * sd) ** 2).sum(axis=1)


def test_covariance_is_that_of_weighted_least_squares_where_declared_errors_explain_all():
    """Without scatter nothing is added to what is declared; rests of one attitude count as their mean."""
    rng = np.random.default_rng(2)
    up = np.vstack([directions(20), directions(20)[:2], directions(20)[:1]])
    raw = raw_of(up)
    sd = 0.01 * np.exp(rng.uniform(-1, 1, raw.shape))
    fit = fitted(raw, sd)
    slopes = norm_slopes(raw)
    expected = np.linalg.inv(slopes.T @ (slopes / own_variances(raw, sd)[:, None]))
    np.testing.assert_allclose(fit.covariance, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())
    assert (fit.n_rests, fit.n_states) == (23, 20)
    assert (fit.excess_rest, fit.excess_attitude) == (0.0, 0.0)
    assert fit.degrees_of_freedom == np.inf
    assert fit.iterations > 0


def test_a_rest_that_says_it_is_uncertain_hardly_counts():
    raw, sd = raw_of(directions(25)), np.full((25, 3), 1e-3)
    raw[0] *= 1.02
    sd[0] = 20.0
    fit = fitted(raw, sd, outlier_level=0.0)
    np.testing.assert_allclose(fit.model.bias, BIAS, atol=1e-4)
    assert fit.residuals[0] == pytest.approx(0.02 * G, rel=0.1)


def test_rests_that_claim_to_be_exact_are_fitted_like_any():
    fit = fitted(raw_of(directions(20)), 0.0)
    assert np.isfinite(fit.covariance).all() and (np.diag(fit.covariance) > 0).all()
    np.testing.assert_allclose(fit.model.scale, SCALE, atol=1e-9)


def test_scatter_between_attitudes_leaves_as_many_degrees_as_attitudes_beyond_parameters():
    rng = np.random.default_rng(5)
    raw = raw_of(directions(20)) + 0.01 * rng.normal(size=(20, 3))
    fit = fitted(raw, 1e-3)
    assert fit.degrees_of_freedom == 20 - 9
    assert 0.5 < fit.excess_attitude / 0.01 < 1.8  # an sd on 11 degrees of freedom: 21 %
    assert fit.excess_rest == 0.0
    six = fitted(
        raw_of(directions(20), np.diag(np.diag(SCALE))) + 0.01 * rng.normal(size=(20, 3)), parameters=6
    )
    assert six.degrees_of_freedom == 20 - 6


def test_scatter_within_attitudes_alone_leaves_rests_less_attitudes():
    """Pairs of rests 0.04 longer and shorter than they should be, along gravity: their means are exact."""
    up = np.repeat(directions(20), 2, axis=0)
    off = 0.04 * np.tile([1.0, -1.0], 20)[:, None]
    raw = raw_of(up) + off * up @ np.linalg.inv(SCALE).T
    fit = fitted(raw, 1e-3, outlier_level=0.0, max_norm_sd=1.0)
    assert (fit.n_rests, fit.n_states, fit.degrees_of_freedom) == (40, 20, 20.0)
    assert fit.repeatability == pytest.approx(0.04 * np.sqrt(2), rel=0.01)
    assert fit.excess_rest == pytest.approx(0.04 * np.sqrt(2), rel=0.01)
    assert fit.excess_attitude == 0.0
    assert fit.rms_residual == pytest.approx(0.04, rel=0.01)


def test_within_an_attitude_rests_count_by_their_uncertainty():
    """Beside each exact rest lies one that is 0.09 off and says 0.1: the attitude's mean is the exact one."""
    rng = np.random.default_rng(6)
    up = np.repeat(directions(20), 2, axis=0)
    raw = raw_of(up)
    raw[1::2] += (0.09 * rng.choice([-1.0, 1.0], 20))[:, None] * up[1::2]
    sd = np.tile([[1e-3], [0.1]], (20, 3))
    fit = fitted(raw, sd, outlier_level=0.0, max_norm_sd=1.0)
    assert np.abs(fit.residuals[::2]).max() < 1e-3
    assert np.abs(fit.residuals[1::2]).min() > 0.08
    np.testing.assert_allclose(fit.model.bias, BIAS, atol=1e-3)


def test_pooling_takes_weighted_means_over_each_attitude():
    matrix = pooling(np.array([0, 1, 0, 2]), np.array([1.0, 5.0, 3.0, 2.0]))
    np.testing.assert_allclose(matrix, [[0.25, 0, 0.75, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def test_what_is_reported_is_in_metres_and_of_all_rests():
    raw = raw_of(directions(25))
    raw[7] *= 1.04
    fit = fitted(raw, 1e-3)
    (dropped,) = fit.dropped
    assert dropped.row == 7 and fit.n_rests == 25 and fit.n_states == 24
    assert fit.used.sum() == 24 and not fit.used[7]
    true = np.linalg.norm((raw[7] - BIAS) @ SCALE.T) - G
    assert fit.residuals[7] == pytest.approx(true, abs=1e-6)
    assert dropped.reason == f"its norm is {true:+.3g} m/s^2 off what the other rests agree on"
    assert fit.rms_residual == pytest.approx(true / 5.0, rel=1e-3)
    assert fit.gravity == G and fit.repeatability is None


# Outliers


def test_as_many_rests_are_dropped_as_the_settings_allow():
    """Three bad rests of forty: a fortieth part allows one to be dropped, a tenth allows all three."""
    raw = raw_of(directions(40)) + 1e-3 * np.random.default_rng(3).normal(size=(40, 3))
    raw[[3, 8, 15]] *= 1.05
    assert {d.row for d in fitted(raw, 1e-3, max_outliers=0.1).dropped} == {3, 8, 15}
    assert len(fitted(raw, 1e-3, max_outliers=0.04, max_norm_sd=1.0).dropped) <= 1
    for none in ({"max_outliers": 0.0}, {"outlier_level": 0.0}):
        assert fitted(raw, 1e-3, max_norm_sd=1.0, **none).dropped == ()


@pytest.mark.parametrize(("fitted_rests", "free"), [(20, 11), (10, 1), (9, 1)])
@pytest.mark.parametrize(("share", "explained"), [(0.999, True), (1.001, False)])
def test_a_rest_is_explained_within_students_quantile_of_the_fits_own_scatter(
    share, explained, fitted_rests, free
):
    """A hundredth over 25 rests and two sides, on rests - 9 degrees of freedom; the model known exactly."""
    raw = raw_of(directions(25))
    task = task_of(raw, np.zeros_like(raw), G, 0.0, 9, "symmetric", AccelerometerSettings())
    v = np.linalg.lstsq(task.norms.matrix, np.r_[BIAS / G, SCALE.ravel()], rcond=None)[0]
    sd = 1e-5
    limit = student.ppf(1 - 0.01 / (2 * 25), free)
    length = 1.0 + share * limit * sd
    raw[4] = raw_of(directions(25)[4:5] * np.sqrt(2 * length - 1))[0]  # Eq. 4: (norm^2 - 1) / 2
    task = task_of(raw, np.zeros_like(raw), G, 0.0, 9, "symmetric", AccelerometerSettings())
    solution = Solution(v, np.zeros((9, 9)), 0.6 * sd**2, 0.4 * sd**2, 3, True)
    found = accelerometer._explained(task, solution, fitted_rests)
    assert bool(found[4]) is explained and found.sum() == 24 + explained
