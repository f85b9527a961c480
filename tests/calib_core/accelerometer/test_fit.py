"""The accelerometer's fit: models, forms, refusals, records; exact on data without noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.calib_core import codec
from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer import observability
from stillcal.calib_core.accelerometer.equations import Norms
from stillcal.calib_core.accelerometer.fit import AccelerometerFit, AccelerometerSettings, AttitudesMissing
from stillcal.calib_core.accelerometer.parameters import basis, names
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths import levenberg_marquardt as damped
from stillcal.calib_core.maths import random_effects
from stillcal.calib_core.static import rest

G = 9.81
SCALE = np.array([[1.02, 0.004, -0.006], [0.004, 0.985, 0.003], [-0.006, 0.003, 1.01]])
BIAS = np.array([0.3, -0.2, 0.5])
FACES = np.vstack((np.eye(3), -np.eye(3)))


def directions(n, seed=0):
    up = np.random.default_rng(seed).normal(size=(n, 3))
    return up / np.linalg.norm(up, axis=1, keepdims=True)


def raw_of(up, scale=SCALE, bias=BIAS, gravity=G):
    return np.asarray(gravity)[..., None] * up @ np.linalg.inv(scale).T + bias


@pytest.mark.parametrize("form", ["symmetric", "triangular"])
@pytest.mark.parametrize("parameters", [6, 9])
def test_recovers_truth_without_noise(parameters, form):
    scale = SCALE if form == "symmetric" else np.tril(SCALE)
    scale = np.diag(np.diag(scale)) if parameters == 6 else scale
    fit = accelerometer.fit(raw_of(directions(20), scale), None, G, parameters=parameters, form=form)
    assert np.abs(fit.model.scale - scale).max() < 1e-10
    assert np.abs(fit.model.bias - BIAS).max() < 1e-9
    assert fit.names == names(parameters, form)
    assert fit.values == pytest.approx(np.linalg.pinv(basis(parameters, form)) @ np.r_[BIAS, scale.ravel()])


def test_zero_parameters_settle():
    """Eq. 8 as printed divides by a parameter's own mean, which is nought for a perfect sensor."""
    fit = accelerometer.fit(G * directions(20), None, G, parameters=9)
    assert np.abs(fit.model.bias).max() < 1e-10
    assert fit.iterations < 20


def test_twelve_parameters_are_the_symmetric_nine_and_say_what_cannot_be_seen():
    rng = np.random.default_rng(4)
    raw = raw_of(directions(25)) + 1e-3 * rng.normal(size=(25, 3))
    nine, twelve = (accelerometer.fit(raw, None, G, parameters=p) for p in (9, 12))
    assert twelve.model.scale == pytest.approx(nine.model.scale, abs=1e-12)
    assert twelve.covariance.shape == (12, 12)
    assert np.linalg.matrix_rank(twelve.covariance, tol=1e-12) == 9
    assert twelve.coverage.unobservable == ("rotation common to all axes",)
    assert nine.coverage.unobservable == ()
    assert twelve.sensor_covariance == pytest.approx(nine.sensor_covariance, abs=1e-15)


def test_twelve_free_entries_reach_no_lower_cost_than_nine():
    """Left to itself a full scale ends at the same residuals, a rotation away."""
    rng = np.random.default_rng(6)
    raw = (raw_of(directions(25)) + 1e-2 * rng.normal(size=(25, 3))) / G
    ends = []
    for parameters in (9, 12):
        norms = Norms(raw, np.zeros_like(raw), np.ones(25), np.arange(25), basis(parameters))
        ends.append(damped.minimise(norms.residuals, norms.start(), damped.Damping(tolerance=1e-9)))
    nine, twelve = (float(e.residuals @ e.residuals) for e in ends)
    assert twelve == pytest.approx(nine, rel=1e-6)


def test_triangular_and_symmetric_agree_on_every_norm():
    rng = np.random.default_rng(7)
    raw = raw_of(directions(25)) + 1e-3 * rng.normal(size=(25, 3))
    one, two = (accelerometer.fit(raw, None, G, parameters=9, form=f) for f in ("symmetric", "triangular"))
    # each weighs rests alike and only the turn of the frame differs
    assert np.abs(one.residuals - two.residuals).max() < 1e-8
    assert two.model.scale[0, 1] == two.model.scale[0, 2] == two.model.scale[1, 2] == 0.0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_jacobian_is_the_derivative(seed):
    rng = np.random.default_rng(seed)
    raw = rng.normal(size=(5, 3))
    norms = Norms(raw, np.zeros((5, 3)), rng.uniform(0.9, 1.1, 5), np.arange(5), basis(9))
    v = norms.start() + 0.1 * rng.normal(size=9)
    step = 1e-6
    numeric = [(norms.residuals(v + d)[0] - norms.residuals(v - d)[0]) / (2 * step) for d in step * np.eye(9)]
    assert norms.residuals(v)[1] == pytest.approx(np.array(numeric).T, abs=1e-8)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000))
def test_order_of_rests_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    raw = raw_of(directions(20)) + 1e-3 * rng.normal(size=(20, 3))
    order = rng.permutation(20)
    one = accelerometer.fit(raw, np.full((20, 3), 1e-3), G, parameters=9)
    two = accelerometer.fit(raw[order], np.full((20, 3), 1e-3), G, parameters=9)
    assert two.values == pytest.approx(one.values, abs=1e-6)
    assert two.residuals == pytest.approx(one.residuals[order], abs=1e-6)


def test_gravity_of_each_place_is_used():
    local = np.linspace(9.78, 9.83, 20)
    fit = accelerometer.fit(raw_of(directions(20), gravity=local), None, local, parameters=9)
    assert np.abs(fit.model.scale - SCALE).max() < 1e-10
    assert fit.rms_residual < 1e-9


def test_gravity_uncertainty_widens_the_common_scale_only():
    raw = raw_of(directions(30)) + 1e-3 * np.random.default_rng(0).normal(size=(30, 3))
    sure = accelerometer.fit(raw, None, G, parameters=9)
    unsure = accelerometer.fit(raw, None, G, 0.0133, parameters=9)
    assert unsure.common_scale_uncertainty == pytest.approx(0.0133 / G)
    width = [np.diff(f.interval(), axis=1)[:, 0] for f in (sure, unsure)]
    assert width[1][:3] == pytest.approx(width[0][:3])
    assert (width[1][3:6] > 2.0 * width[0][3:6]).all()
    force = raw_of(np.array([0.0, 0.0, 1.0]))
    assert unsure.uncertainty(force)[2] == pytest.approx(
        np.hypot(sure.uncertainty(force)[2], 0.0133), rel=1e-3
    )


def test_auto_takes_nine_where_attitudes_allow_and_six_on_faces_alone():
    assert accelerometer.fit(raw_of(directions(30)), None, G).parameters == 9
    assert accelerometer.fit(raw_of(FACES), np.full((6, 3), 1e-3), G).parameters == 6


def test_auto_wants_a_spare_attitude():
    """Nine attitudes fit nine parameters whatever the data are; auto then stays with six."""
    nine = np.vstack((FACES, np.array([[1, 1, 0], [1, 0, 1], [0, 1, 1]]) / np.sqrt(2)))
    assert observability.amplification(nine, 9) < 5.0
    assert accelerometer.fit(raw_of(nine), None, G, parameters=9).parameters == 9
    assert accelerometer.fit(raw_of(nine, np.diag(np.diag(SCALE))), None, G).parameters == 6


@pytest.mark.parametrize("face", range(6))
def test_missing_face_is_named(face):
    held = np.delete(FACES, face, axis=0)
    tilted = np.vstack((held, rest.directions(held[:2] + 0.15)))
    with pytest.raises(AttitudesMissing) as refusal:
        accelerometer.fit(raw_of(tilted), None, G)
    wanted = refusal.value.attitudes[0]
    assert wanted.up == pytest.approx(FACES[face])
    assert wanted.words == refusal.value.missing[0]
    assert isinstance(refusal.value, NotSupported)
    assert "do not support 6 parameters" in refusal.value.reason


def test_adding_what_is_missing_is_enough():
    held = directions(5, seed=3)
    with pytest.raises(AttitudesMissing) as refusal:
        accelerometer.fit(raw_of(held), None, G, parameters=9)
    added = np.vstack([held, *(a.up for a in refusal.value.attitudes)])
    assert accelerometer.fit(raw_of(added), None, G, parameters=9).parameters == 9


def test_no_rest_at_all():
    with pytest.raises(AttitudesMissing, match="there is no rest") as refusal:
        accelerometer.fit(np.empty((0, 3)), None, G)
    assert len(refusal.value.attitudes) == 6


def test_noise_too_large_for_the_outcome_is_refused():
    raw = raw_of(directions(15)) + 0.3 * np.random.default_rng(1).normal(size=(15, 3))
    with pytest.raises(AttitudesMissing, match="along the worst direction"):
        accelerometer.fit(raw, None, G)


def test_multiples_of_g_are_recognised():
    with pytest.raises(NotSupported, match="multiples of g"):
        accelerometer.fit(directions(20), None, G)


def test_what_is_no_phone_is_refused():
    with pytest.raises(NotSupported, match="no phone's accelerometer"):
        accelerometer.fit(raw_of(directions(20), np.diag([1.6, 1.0, 1.0])), None, G, parameters=9)


@pytest.mark.parametrize(
    ("forces", "sd", "gravity", "match"),
    [
        (np.ones((4, 2)), None, G, "expected"),
        (np.ones((4, 3)), np.ones((3, 3)), G, "uncertainties have shape"),
        (np.full((4, 3), np.nan), None, G, "finite"),
        (np.ones((4, 3)), -np.ones((4, 3)), G, "negative"),
        (np.ones((4, 3)), None, -1.0, "gravity must be positive"),
    ],
)
def test_arrays_that_do_not_fit(forces, sd, gravity, match):
    with pytest.raises(ValueError, match=match):
        accelerometer.fit(forces, sd, gravity)


@pytest.mark.parametrize("field", ["max_amplification", "max_outliers", "rounds", "attitude_angle"])
def test_settings_name_field_and_range(field):
    with pytest.raises(ValueError, match=f"{field} = -1: must lie between"):
        AccelerometerSettings(**{field: -1})


def test_settings_come_from_plain_values():
    made = codec.from_plain({"max_outliers": 0.1, "damping": {"start": 0.01}}, AccelerometerSettings)
    assert made.max_outliers == 0.1
    assert made.damping.start == 0.01


def test_fit_survives_the_codec():
    raw = raw_of(directions(20)) + 1e-3 * np.random.default_rng(0).normal(size=(20, 3))
    raw[3] *= 1.05
    fit = accelerometer.fit(raw, np.full((20, 3), 1e-3), G)
    back = codec.unpacked(codec.packed(fit), AccelerometerFit)
    assert back.dropped == fit.dropped
    assert np.array_equal(back.used, fit.used)
    assert np.array_equal(back.interval(), fit.interval())
    assert codec.plain(fit)["coverage"]["weakest"]["words"] == fit.coverage.weakest.words


def test_excess_variance_is_unbiased():
    """400 trials of 20 rows, 9 parameters: mean of the estimate within 4 % (its sd 2.1 %) of truth."""
    rng = np.random.default_rng(0)
    design = rng.normal(size=(20, 9))
    own = rng.uniform(0.1, 0.4, 20)
    draws = rng.normal(size=(400, 20)) * np.sqrt(own + 4.0)
    found = [random_effects.excess_variance(row, design, own) for row in draws]
    assert np.mean(found) == pytest.approx(4.0, rel=0.08)


def test_extreme_deviates_do_not_hide_each_other_and_rarely_cry_wolf():
    rng = np.random.default_rng(1)
    design = np.column_stack((np.ones(20), np.arange(20.0)))
    clean = [random_effects.outliers(rng.normal(size=20), design, np.ones(20), 4, 0.05) for _ in range(400)]
    assert sum(bool(c) for c in clean) / 400 < 0.05 + 3 * 0.011  # 0.011: sd of a 5 % share of 400
    twins = rng.normal(size=20)
    twins[[4, 5]] += 30.0
    assert set(random_effects.outliers(twins, design, np.ones(20), 4, 0.05)) == {4, 5}
