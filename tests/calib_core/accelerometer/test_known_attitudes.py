"""Phones laid on their faces: the choice of method and refusals."""

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
