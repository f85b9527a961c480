"""Phones laid on their faces: the choice of method, refusals, and the real still experiment."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.accelerometer.known_attitudes import (
    FACE_DIRECTIONS,
    Broken,
    FaceSettings,
    Method,
    calibrate_faces,
)
from stillcal.calib_core.errors import NotSupported
from stillcal.replay.formats import hhar_still as survey

G = 9.80665
SCALE = np.diag([1.01, 0.99, 1.005])
BIAS = np.array([0.1, -0.2, 0.5])
SPREAD = np.full((6, 3), 0.02)
SURE = np.full((6, 3), 1e-3)


def faces(tilt=0.0, seed=0):
    up = FACE_DIRECTIONS + tilt * np.random.default_rng(seed).normal(size=(6, 3))
    return G * up / np.linalg.norm(up, axis=1, keepdims=True) @ np.linalg.inv(SCALE).T + BIAS


def test_exact_faces_are_taken_as_known():
    found = calibrate_faces(faces(1e-3), SPREAD, SURE, G)
    assert found.method == Method.KNOWN_FACES
    assert found.model.scale == pytest.approx(SCALE, abs=5e-3)
    assert found.model.bias == pytest.approx(BIAS, abs=0.02)


def test_crooked_faces_are_used_for_their_norm_only():
    found = calibrate_faces(faces(0.03), SPREAD, SURE, G)
    assert found.method == Method.SIX_PARAMETERS
    assert found.tilt > 0.01
    assert found.model.scale == pytest.approx(SCALE, abs=1e-6)
    assert found.model.bias == pytest.approx(BIAS, abs=1e-6)


@pytest.mark.parametrize("face", range(6))
def test_the_missing_face_is_named(face):
    rows = np.arange(6) != face
    with pytest.raises(NotSupported, match="5 of 6 faces") as refusal:
        calibrate_faces(faces()[rows], SPREAD[rows], SURE[rows], G)
    assert len(refusal.value.missing) == 1
    assert f"{'xyz'[face // 2]} axis {'up' if face % 2 else 'down'}" in refusal.value.missing[0]


def test_a_recording_in_motion_is_no_face():
    spread = SPREAD.copy()
    spread[5] = 2.0
    with pytest.raises(NotSupported, match="1 recordings were not at rest"):
        calibrate_faces(faces(), spread, SURE, G)


def test_a_frozen_sensor_is_broken():
    with pytest.raises(Broken, match="frozen"):
        calibrate_faces(faces(), np.zeros((6, 3)), SURE, G)


def test_a_norm_far_off_is_broken():
    with pytest.raises(Broken, match="off gravity"):
        calibrate_faces(faces() * 1.4, SPREAD, SURE, G)


def test_settings_name_field_and_range():
    with pytest.raises(ValueError, match="max_tilt"):
        FaceSettings(max_tilt=0.0)


@pytest.fixture(scope="module")
def outcomes(data_dir):
    return survey.survey(survey.read(data_dir / "hhar_still"))


def test_real_devices_are_calibrated_refused_or_broken(outcomes):
    by_name = {f"{o.recordings.model} {o.recordings.device}": o for o in outcomes}
    assert len(by_name) == len(outcomes)
    for outcome in outcomes:
        assert (outcome.calibration is None) == bool(outcome.reason)
    assert by_name["Samsung-Galaxy-Tab10.1 SamsungGalaxyTab10.1"].broken
    one_face_twice = by_name["Samsung-Galaxy-S3 it-101"]  # labelled left and right, both with x up
    assert "right edge (x axis down)" in one_face_twice.reason
    assert not one_face_twice.broken


def test_real_calibrations_are_plausible_and_help(outcomes):
    """Every calibrated device's norms come nearer to g; the reference is better than most."""
    done = [o for o in outcomes if o.calibration is not None]
    assert len(done) >= 10
    for outcome in done:
        before = np.sqrt(np.mean((np.linalg.norm(outcome.recordings.means, axis=1) - G) ** 2))
        assert outcome.calibration.rms_residual < before / 2
        assert np.abs(outcome.calibration.model.bias).max() < 2.0
        assert np.abs(np.diag(outcome.calibration.model.scale) - 1.0).max() < 0.03
    size = {o.recordings.device: np.abs(o.calibration.model.bias).max() for o in done}
    assert size["xsens"] < np.median(list(size.values()))


def test_page_and_figure_are_written(outcomes, tmp_path):
    text = survey.page(outcomes, G)
    assert text.count("approach 2 |") == sum(
        o.calibration is not None and o.calibration.method == Method.KNOWN_FACES for o in outcomes
    )
    pytest.importorskip("matplotlib")
    survey.draw(outcomes, tmp_path / "figures" / "still.png")
    assert (tmp_path / "figures" / "still.png").stat().st_size > 10_000
