"""Twelve parameters from six faces, each tilted a little, and their rotation in later calibrations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.accelerometer.known_attitudes import FACE_DIRECTIONS, six_faces
from stillcal.calib_core.accelerometer.observability import describe
from stillcal.calib_core.accelerometer.parameters import names
from stillcal.calib_core.accelerometer.six_faces import SixFaces, common_rotation, fit_six_faces
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.candidate import CalibrateSettings, fit_candidate
from stillcal.calib_core.calibration.known_faces import calibrate_faces, inherit_rotation, turned_as
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.maths import rotation
from stillcal.calib_core.static.rest import RestState

G = 9.81
SCALE = np.array([[1.01, 0.008, -0.004], [-0.002, 0.99, 0.006], [0.01, -0.012, 1.005]])
BIAS = np.array([0.3, -0.2, 0.15])


def raw_of(up: Array) -> Array:
    """Return what the sensor reads at rest under unit directions (n, 3)."""
    return G * up @ np.linalg.inv(SCALE).T + BIAS


def tilted(sd: float, rng: np.random.Generator) -> Array:
    """Return the six faces' directions, each tilted at random by `sd` rad about every axis."""
    turns = rotation.matrix(rotation.exponential(rng.normal(0.0, sd, (6, 3))))
    return np.einsum("kij,kj->ki", turns, FACE_DIRECTIONS)


def elsewhere(rng: np.random.Generator, n: int = 14) -> Array:
    """Return directions far from every face."""
    up = rng.normal(0, 1, (20 * n, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return up[np.abs(up).max(axis=1) < 0.9][:n]


def fitted(up: Array, rng: np.random.Generator) -> SixFaces:
    raw = raw_of(up) * (1.0 + rng.normal(0, 4e-4, (len(up), 1)))
    return fit_six_faces(raw, np.full(raw.shape, 1e-3), np.full(len(up), G), np.full(len(up), 500.0))


@pytest.mark.parametrize("others", [0, 14])
def test_its_intervals_hold_whatever_else_was_recorded(others: int) -> None:
    rng, inside = np.random.default_rng(1), []
    for _ in range(60):
        fit = fitted(np.vstack((tilted(np.radians(0.3), rng), elsewhere(rng, others))), rng)
        off = np.r_[fit.model.bias - BIAS, (fit.model.scale - SCALE).ravel()]
        inside.append(np.abs(off) < 1.96 * np.sqrt(np.diag(fit.covariance)))
    assert 0.9 < np.mean(inside) < 0.999
    assert np.mean(np.array(inside)[:, :3]) > 0.9


def test_tilts_are_not_taken_for_bias() -> None:
    """By 0.5 degrees a face shifts approach 2's bias by centimetres per second squared."""
    rng = np.random.default_rng(2)
    ours, theirs = [], []
    for _ in range(20):
        up = tilted(np.radians(0.5), rng)
        ours.append(np.abs(fitted(up, rng).model.bias - BIAS).max())
        theirs.append(np.abs(six_faces(raw_of(up), G).model.bias - BIAS).max())
    assert np.median(ours) < 0.01 < 0.03 < np.median(theirs)


def test_the_tilt_and_the_rotation_it_leaves_are_told() -> None:
    rng = np.random.default_rng(3)
    fits = [fitted(tilted(np.radians(0.3), rng), rng) for _ in range(30)]
    assert np.degrees(np.median([f.tilt for f in fits])) == pytest.approx(0.3, abs=0.08)
    assert np.degrees(np.median([f.rotation_sd for f in fits])) == pytest.approx(0.17, abs=0.06)


def test_a_missing_face_and_a_crooked_one_are_refused() -> None:
    rng = np.random.default_rng(4)
    with pytest.raises(NotSupported) as caught:
        fitted(FACE_DIRECTIONS[:5], rng)
    assert "5 of 6 faces" in caught.value.reason and len(caught.value.missing) == 1
    crooked = tilted(np.radians(0.1), rng)
    crooked[2] = [np.sin(0.2), -np.cos(0.2), 0.0]
    with pytest.raises(NotSupported, match="square and level") as crooked_face:
        fitted(crooked, rng)
    assert crooked_face.value.missing == tuple(describe(FACE_DIRECTIONS[k]) for k in (2, 3))


def pool_of(up: Array, t: float = 0.0) -> Pool:
    raw, sd = raw_of(up), np.full(3, 1e-3)
    rests = [
        RestState(t + 20.0 * k, t + 20.0 * k + 10, 500, frozen(f), frozen(sd), frozen(sd), 0.01)
        for k, f in enumerate(raw)
    ]
    return Pool(tuple(HeldRest(rest, Gravity(G, 0.0, "given")) for rest in rests))


def test_a_later_calibration_is_turned_as_the_known_faces_were() -> None:
    rng, gravity, settings = np.random.default_rng(5), Gravity(G, 0.0, "given"), CalibrateSettings()
    known = calibrate_faces(pool_of(tilted(1e-4, rng)), gravity, 200.0, settings)
    assert known.accelerometer is not None and known.accelerometer.parameters == 12
    assert "six known faces" in known.acceptance.reason
    assert known.accelerometer.scale == pytest.approx(SCALE, abs=1e-3)
    later = fit_candidate(pool_of(elsewhere(rng), 1000.0), gravity, 2000.0, settings).record
    turned = inherit_rotation(known, later)
    assert later.accelerometer is not None and turned.accelerometer is not None
    assert np.abs(later.accelerometer.scale - SCALE).max() > 4e-3
    assert turned.accelerometer.scale == pytest.approx(SCALE, abs=1e-3)
    assert turned.accelerometer.names == names(12) and turned.accelerometer.parameters == 12
    rest = raw_of(elsewhere(rng, 1))
    norms = [np.linalg.norm(r.accelerometer.model.apply(rest)) for r in (later, turned) if r.accelerometer]
    assert norms[0] == pytest.approx(norms[1], abs=1e-9)
    sd = turned.accelerometer.scale_uncertainty
    assert sd is not None and np.isfinite(sd).all() and sd.max() < 5e-3
    assert inherit_rotation(None, later) is later
    assert inherit_rotation(replace(known, accelerometer=later.accelerometer), later) is later


def test_faces_laid_again_turn_a_calibration_and_leave_what_rests_show_of_it() -> None:
    rng, gravity, settings = np.random.default_rng(6), Gravity(G, 0.0, "given"), CalibrateSettings()
    rough = calibrate_faces(pool_of(tilted(np.radians(0.6), rng)), gravity, 200.0, settings)
    fine = calibrate_faces(pool_of(tilted(1e-4, rng)), gravity, 400.0, settings)
    by_rests = fit_candidate(pool_of(elsewhere(rng), 1000.0), gravity, 2000.0, settings).record
    once, twice = turned_as(fine, by_rests), turned_as(fine, turned_as(rough, by_rests))
    assert once.accelerometer is not None and twice.accelerometer is not None
    assert twice.accelerometer.scale == pytest.approx(once.accelerometer.scale, abs=1e-12)
    assert twice.accelerometer.covariance == pytest.approx(once.accelerometer.covariance, rel=1e-6, abs=1e-14)


def test_the_rotation_in_a_scale_is_that_of_its_polar_decomposition() -> None:
    turn = rotation.matrix(rotation.exponential(np.array([[0.01, -0.02, 0.005]])))[0]
    assert common_rotation(turn @ np.diag([1.1, 0.9, 1.0])) == pytest.approx(turn, abs=1e-12)


def test_the_odd_one_of_six_faces_is_named_and_faces_laid_alike_are_not() -> None:
    """By the other five and by what sensors can be; with plain norms, the one opposite looks as odd."""
    rng = np.random.default_rng(5)
    named = []
    for k in range(24):
        up = tilted(np.radians(0.3), rng)
        assert fitted(up, rng).odd == []
        face, axis = k % 6, (k % 6 // 2 + 1 + k // 6 % 2) % 3
        turn = rotation.matrix(rotation.exponential(np.radians(5.0) * np.eye(3)[axis][None]))[0]
        up[face] = turn @ FACE_DIRECTIONS[face]
        (odd,) = fitted(up, rng).odd or [None]
        named.append(odd is not None and odd.face == face)
        assert odd is None or np.degrees(odd.tilt) == pytest.approx(5.0, abs=1.5)
    assert np.mean(named) > 0.9
    assert not any(fitted(tilted(np.radians(1.0), rng), rng).odd for _ in range(24))
