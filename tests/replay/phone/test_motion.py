"""True motion: attitude, rate, acceleration and gravity agree, and the ideal phone reports them."""

from __future__ import annotations

import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stillcal.replay.phone import Phone, Scenario, load_phone, load_scenario, simulate
from stillcal.replay.phone.motion.attitudes import SUPPORTS, attitude_with, lying, poses
from stillcal.replay.phone.motion.gravity import EARTH_RATE, gravity_at
from stillcal.replay.phone.motion.trajectory import (
    Creep,
    Glide,
    Piece,
    Sway,
    Turn,
    Waves,
    motion_of,
    rotation,
    turn_between,
)
from stillcal.replay.phone.settings import SensorSettings

LIVELY = """
{"segment": [
  {"activity": "table", "duration_s": 40.0, "rest_s": [3.0, 6.0]},
  {"activity": "walk", "duration_s": 20.0},
  {"activity": "stairs", "duration_s": 8.0},
  {"activity": "washer", "duration_s": 30.0},
  {"activity": "drive", "duration_s": 40.0},
  {"activity": "pocket", "duration_s": 20.0},
  {"activity": "mattress", "duration_s": 20.0},
  {"activity": "desk", "duration_s": 20.0, "quiet_s": 4.0},
  {"activity": "hand", "duration_s": 20.0},
  {"activity": "rest", "duration_s": 6.0, "support": "face_to_wall"}
]}
"""
scenarios = {name: load_scenario(name) for name in ("tables", "lab")}


def lively() -> Scenario:
    return msgspec.json.decode(LIVELY, type=Scenario)


def ideal_at(rate_hz: float) -> Phone:
    sensor = SensorSettings(rate_hz=rate_hz)
    return msgspec.structs.replace(load_phone("ideal"), accel=sensor, gyro=sensor)


def integrated(rates: np.ndarray, dt: float) -> Rotation:
    """Rotation over evenly spaced rates by the fourth-order Magnus series, Simpson over pairs of steps."""
    first, middle, last = rates[:-2:2], rates[1:-1:2], rates[2::2]
    span = 2.0 * dt
    vectors = span / 6.0 * (first + 4.0 * middle + last) + span**2 / 12.0 * np.cross(first, last)
    turns = Rotation.from_rotvec(vectors)
    while len(turns) > 1:
        if len(turns) % 2:
            turns = Rotation.concatenate([turns, Rotation.identity(1)])
        turns = turns[::2] * turns[1::2]
    return turns[0]


@pytest.mark.parametrize("name", ["tables", "lab"])
def test_ideal_phone_at_rest_reads_local_gravity_to_rounding(name: str) -> None:
    simulation = simulate(scenarios[name], load_phone("ideal"), seed=5)
    recording = simulation.whole()
    rests = simulation.truth.rests
    assert len(rests) > 20
    for rest in rests:
        forces = recording.accelerometer.between(rest.t_start, rest.t_end).xyz
        assert np.abs(np.linalg.norm(forces, axis=1) - rest.gravity).max() < 1e-13 * 9.8 * 10
        assert np.abs(forces - rest.up * rest.gravity).max() < 1e-13 * 9.8 * 10
        assert np.all(recording.gyroscope.between(rest.t_start, rest.t_end).xyz == 0.0)


def test_gyroscope_of_the_ideal_phone_integrates_to_the_true_attitude() -> None:
    rate = 1000.0
    simulation = simulate(lively(), ideal_at(rate), seed=2)
    assert {p.activity for p in simulation.plan.pieces} >= {
        "walk",
        "stairs",
        "washer",
        "drive",
        "hand",
        "pocket",
    }
    for piece in simulation.plan.pieces:
        steps = 2 * math.ceil((piece.t_end - piece.t_start) * rate / 2.0)
        t = np.linspace(piece.t_start, piece.t_end, steps + 1)
        turned = integrated(motion_of(piece, t).rate, t[1] - t[0])
        reached = Rotation.from_matrix(piece.attitude) * turned
        off = (reached.inv() * Rotation.from_matrix(piece.attitude_at(piece.t_end))).magnitude()
        assert off < 1e-6, (piece.activity, off)


def test_recorded_rates_lead_from_rest_to_rest() -> None:
    rate = 1000.0
    simulation = simulate(scenarios["lab"], ideal_at(rate), seed=4)
    gyro = simulation.whole().gyroscope
    rests = simulation.truth.rests[:8]
    assert len(rests) == 8
    for before, after in pairwise(rests):
        run = gyro.between(before.t_end - 0.5, after.t_start + 0.5)
        rates = run.xyz[: len(run) - (len(run) + 1) % 2]
        reached = Rotation.from_matrix(before.attitude) * integrated(rates, 1.0 / rate)
        seen = reached.as_matrix()[2]
        assert np.linalg.norm(seen - after.up) < 1e-5


def test_pieces_join_without_a_jump() -> None:
    pieces = simulate(lively(), load_phone("ideal"), seed=3).plan.pieces
    assert len(pieces) > 10
    for before, after in pairwise(pieces):
        assert before.t_end == after.t_start
        assert np.abs(before.attitude_at(before.t_end) - after.attitude).max() < 1e-12
        ends = motion_of(before, np.array([before.t_end])), motion_of(after, np.array([after.t_start]))
        assert np.abs(ends[0].rate - ends[1].rate).max() < 1e-9


def test_rate_dot_is_the_derivative_of_rate() -> None:
    h = 1e-5
    for piece in simulate(lively(), load_phone("ideal"), seed=6).plan.pieces:
        t = np.linspace(piece.t_start + 0.01, piece.t_end - 0.01, 200)
        numeric = (motion_of(piece, t + h).rate - motion_of(piece, t - h).rate) / (2.0 * h)
        scale = 1.0 + np.abs(numeric).max()
        assert np.abs(numeric - motion_of(piece, t).rate_dot).max() < 2e-4 * scale, piece.activity


def test_force_of_a_carried_point_is_gravity_plus_its_acceleration() -> None:
    """The centripetal and tangential terms against the second difference of where the point really is."""
    r, h = np.array([0.03, 0.05, -0.01]), 1e-4
    turns = (
        Turn(np.array([0.0, 0.6, 0.8]), Glide(1.5, 0.8)),
        Turn(np.array([1.0, 0.0, 0.0]), Glide(-0.7, 0.8)),
    )
    lift = (Sway(np.array([0.1, -0.2, 0.9]), Glide(0.2, 0.8)),)
    piece = Piece(
        0.0, 0.8, rotation(np.array([0.0, 1.0, 0.0]), 0.4), "turn", False, 9.81, turns, lift, Glide(0.9, 0.8)
    )

    def place(t: float) -> np.ndarray:
        return piece.attitude_at(t) @ r

    for t in (0.1, 0.3, 0.5, 0.7):
        now = motion_of(piece, np.array([t]))
        swing = np.cross(now.rate_dot[0], r) + np.cross(now.rate[0], np.cross(now.rate[0], r))
        numeric = (place(t + h) - 2.0 * place(t) + place(t - h)) / h**2
        assert piece.attitude_at(t) @ swing == pytest.approx(numeric, abs=2e-5)
        carried = lift[0].direction * Glide(0.2, 0.8).at(np.array([t]))[2]
        heading = rotation(np.array([0.0, 0.0, 1.0]), float(Glide(0.9, 0.8).at(np.array([t]))[0][0]))
        expected = np.array([0.0, 0.0, 9.81]) + heading @ carried
        assert piece.attitude_at(t) @ now.force[0] == pytest.approx(expected, abs=1e-12)


def test_the_earth_turns_where_it_is_asked_to() -> None:
    text = '{"earth_rotation": true, "segment": [{"activity": "rest", "duration_s": 20.0}]}'
    scenario = msgspec.json.decode(text, type=Scenario)
    simulation = simulate(scenario, load_phone("ideal"), seed=1)
    rest = simulation.truth.rests[0]
    rates = simulation.whole().gyroscope.between(rest.t_start, rest.t_end).xyz
    assert np.linalg.norm(rates, axis=1) == pytest.approx(EARTH_RATE, rel=1e-12)
    assert rates[0] @ rest.up == pytest.approx(EARTH_RATE * math.sin(math.radians(52.2)), rel=1e-12)


profiles = st.one_of(
    st.builds(Glide, st.floats(-3, 3), st.floats(0.5, 5), st.floats(0, 1)),
    st.builds(Creep, st.floats(-0.1, 0.1), st.floats(1, 100)),
    st.integers(1, 5).flatmap(
        lambda k: st.builds(
            lambda a, f, p: Waves(np.array(a), np.array(f), np.array(p), 6.0, 1.0),
            *[st.lists(st.floats(lo, hi), min_size=k, max_size=k) for lo, hi in ((-1, 1), (0.1, 5), (0, 6))],
        )
    ),
)


@given(profiles, st.floats(0.05, 5.9))
@settings(max_examples=60, deadline=None)
def test_profiles_know_their_derivatives(profile, t: float) -> None:
    h = 1e-4
    (v0, r0, _), (_, r1, a1), (v2, r2, _) = (profile.at(np.array([x])) for x in (t - h, t, t + h))
    assert (v2 - v0) / (2 * h) == pytest.approx(r1, abs=2e-3)
    assert (r2 - r0) / (2 * h) == pytest.approx(a1, abs=0.2)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_turn_between_leads_from_one_attitude_to_the_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, end = Rotation.random(2, random_state=rng).as_matrix()
    axis, angle = turn_between(start, end)
    assert np.abs(start @ rotation(axis, angle) - end).max() < 1e-7


@pytest.mark.parametrize("axis", list(np.eye(3)))
@pytest.mark.parametrize("angle", [0.0, 1e-6, math.pi - 1e-6, math.pi])
def test_turn_between_at_the_ends_of_its_range(axis: np.ndarray, angle: float) -> None:
    end = rotation(axis, angle)
    found = turn_between(np.eye(3), end)
    assert np.abs(rotation(*found) - end).max() < 1e-7


@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(SUPPORTS)))
@settings(max_examples=40, deadline=None)
def test_attitudes_are_rotations(seed: int, support: str) -> None:
    attitude = lying(SUPPORTS[support], np.random.default_rng(seed))
    assert np.abs(attitude @ attitude.T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(attitude) == pytest.approx(1.0)


def test_poses_reach_every_side() -> None:
    ups = np.array([p[2] for p in poses(24, np.random.default_rng(0))])
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        assert (ups @ direction).max() > math.cos(math.radians(15.0))


def test_attitude_with_puts_up_where_it_is_told() -> None:
    up = np.array([0.36, -0.48, 0.8])
    assert attitude_with(up, 1.0).T @ np.array([0.0, 0.0, 1.0]) == pytest.approx(up)


@pytest.mark.parametrize(
    ("latitude", "published"),
    [(0.0, 9.7803267715), (45.0, 9.806199203), (90.0, 9.8321863685)],
)
def test_gravity_on_the_ellipsoid_as_published(latitude: float, published: float) -> None:
    """Moritz 2000, Geodetic Reference System 1980: normal gravity at equator, 45 degrees, pole."""
    assert gravity_at(latitude, 0.0) == pytest.approx(published, abs=2e-8)


def test_gravity_falls_by_the_free_air_gradient() -> None:
    """0.3086 mGal/m, the conventional mean (Hinze et al. 2005)."""
    assert (gravity_at(45.0, 0.0) - gravity_at(45.0, 100.0)) / 100.0 == pytest.approx(3.086e-6, rel=1e-3)


def test_a_day_shows_every_side_of_the_phone() -> None:
    """Calibration from rests alone needs them: 9 parameters ask for attitudes all around."""
    rests = [r for r in simulate(load_scenario("day"), load_phone("ideal"), seed=0).truth.rests]
    ups = np.array([r.up for r in rests if r.t_end - r.t_start >= 10.0])
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        assert (ups @ direction).max() > math.cos(math.radians(30.0))
