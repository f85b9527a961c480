"""Noise of one recording as it is told to people: the reason why not, and the size of slow noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.compare import _is_motion, compare
from stillcal.calib_core.diagnosis.comparison.noise.slow_noise import (
    SlowNoise,
    _as_walk,
    by_name,
    difference_of,
    slow_noise,
    why_no_slow_noise,
)
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import (
    LEVEL,
    density,
    of_both,
    why_no_density,
)
from stillcal.calib_core.diagnosis.comparison.quantity import posterior
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, Linear, on_axes
from stillcal.calib_core.diagnosis.model.moments import Moments
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Where
from stillcal.calib_core.diagnosis.model.settings import CERTAIN
from stillcal.calib_core.diagnosis.segments.noise_range import LOUDEST, loudest
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.wander import NO_DRIVER
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 50.0


def test_the_level_beneath_larger_steps_is_known_roughly() -> None:
    """Midway between two steps it is a third as much again: a simulation without steps had too little."""
    rng, step = np.random.default_rng(2), 0.03
    true = 0.3 * step / np.sqrt(RATE / 2.0)
    noise = rng.normal(0.0, 0.3, (int(600.0 * RATE), 3))
    codes = np.rint(np.array([10.5, 6.5, 326.5]) + noise)
    samples = Samples(Sensor.ACCELEROMETER, np.arange(len(codes)) / RATE, step * codes)
    shown = density(examine(samples, None, sought=()).streams[0])
    assert shown is not None
    off = shown.value - np.log(true)
    assert (off > 0.25).all() and (off < shown.sigma).all()


def test_the_level_beneath_larger_steps_is_that_of_all_rests() -> None:
    """Rests differ by where between two steps they lie: it was not compared, as if something shook them."""
    stream = examine(stepped(0.32 * 0.03, 0.03, 3), None, sought=()).streams[0]
    assert stream.levels is not None and not stream.levels.alike
    shown = density(stream)
    assert shown is not None
    assert (np.abs(shown.value - np.log(0.32 * 0.03 / np.sqrt(RATE / 2.0))) < 0.5 * shown.sigma).all()


def noise(kind: str) -> np.ndarray:
    """Return ten minutes of noise of 0.02 m/s^2, (n, 3)."""
    rng = np.random.default_rng(3)
    shape = (int(600.0 * RATE), 3)
    if kind == "heavy":
        return 0.02 * rng.standard_t(3.0, shape) / np.sqrt(3.0)
    white = 0.02 * rng.normal(size=shape)
    return np.asarray(lfilter([1.0], [1.0, -0.95], white, axis=0)) if kind == "coloured" else white


@pytest.mark.parametrize(
    ("kind", "reason"), [("heavy", "differs between rests"), ("coloured", "is not white"), ("white", None)]
)
def test_the_reason_for_no_density_is_the_true_one(kind: str, reason: str | None) -> None:
    xyz = np.array([0.0, 0.0, 9.80665]) + noise(kind)
    stream = examine(Samples(Sensor.ACCELEROMETER, np.arange(len(xyz)) / RATE, xyz), None).streams[0]
    if reason is None:
        assert density(stream) is not None
    else:
        assert density(stream) is None and reason in why_no_density(stream)


def test_slow_noise_is_the_allan_deviation_of_averages_over_100_s() -> None:
    """That of flicker noise is its floor; short bins 100 s apart differ by 1.7 times as much."""
    rng, floor, n = np.random.default_rng(5), 1e-4, 6000
    frequency = np.maximum(np.fft.rfftfreq(2 * n, 0.2), 1.0 / (0.4 * n))[:, None]
    density_of = floor**2 / (2.0 * np.log(2.0)) / frequency
    spectrum = np.sqrt(density_of * 2 * n * 5.0 / 2.0) * np.exp(2j * np.pi * rng.random((n + 1, 3)))
    rates = np.fft.irfft(spectrum, axis=0)[:n] + 1e-4 * rng.normal(size=(n, 3))
    t, still = np.arange(n) / 5.0, np.array([0.0, 0.0, 9.80665]) + 0.01 * rng.normal(size=(n, 3))
    exam = examine(Samples(Sensor.ACCELEROMETER, t, still), Samples(Sensor.GYROSCOPE, t, rates), sought=())
    slow = slow_noise(exam, next(s for s in exam.sensors if s.sensor == "gyro"))
    assert slow is not None
    assert np.exp(slow.value).mean() == pytest.approx(floor, rel=0.25)


@cache
def resting(white: float, wander: float, seed: int) -> SlowNoise:
    """Return a gyroscope's slow noise. white: rad/s a sample; wander: rad/s of a random walk in 100 s."""
    rng, t = np.random.default_rng(seed), np.arange(12000) / 5.0
    still = np.array([0.0, 0.0, 9.80665]) + 0.01 * rng.normal(size=(t.size, 3))
    walk = np.cumsum(rng.normal(0.0, wander / np.sqrt(500.0), (t.size, 3)), axis=0)
    rates = walk + white * rng.normal(size=(t.size, 3))
    exam = examine(Samples(Sensor.ACCELEROMETER, t, still), Samples(Sensor.GYROSCOPE, t, rates), sought=())
    slow = slow_noise(exam, next(s for s in exam.sensors if s.sensor == "gyro"))
    assert slow is not None
    return slow


@pytest.mark.parametrize("simulated", [(0.0, 0.0), (1e-4, 0.0), (1e-2, 0.0)])
def test_what_is_louder_by_its_white_noise_alone_has_no_more_slow_noise(
    simulated: tuple[float, float],
) -> None:
    """A simulation without any noise was said to lack slow noise of 6 deg/h, the recording's white noise."""
    one = difference_of(resting(1e-3, 0.0, 1), resting(*simulated, 2))
    assert posterior(one.log_bayes_factor, 30) < 0.5
    walking = difference_of(resting(1e-3, 5e-3, 1), resting(*simulated, 2))
    assert walking.relation() == "lacking" or simulated[0] > 0.0
    other = difference_of(resting(1e-3, 0.0, 1), resting(simulated[0], 5e-3, 2))
    assert posterior(other.log_bayes_factor, 30) > CERTAIN and (other.value < 0.0).all()


def test_slow_noise_beside_louder_white_noise_is_as_unsure_as_before() -> None:
    one, louder = resting(1e-4, 1e-5, 3), resting(4e-3, 0.0, 4)
    beside = one.beside(louder)
    own, added = np.exp(2.0 * one.value), louder.white - one.white
    np.testing.assert_allclose(np.exp(2.0 * beside.value), own + added)
    np.testing.assert_allclose(np.exp(2.0 * beside.value) * beside.sigma, own * one.sigma)
    np.testing.assert_array_equal(louder.beside(one).value, louder.value)


@pytest.mark.parametrize(("wander", "none"), [(0.0, True), (1e-5, False)])
def test_a_sensor_without_white_noise_has_none_of_the_slow_either_unless_it_wanders(
    wander: float, none: bool
) -> None:
    """What is added to it, so that it can be judged, is no slow noise of its own."""
    assert resting(0.0, wander, 5).none == none


def test_what_steps_larger_than_the_noise_leave_in_means_is_no_slow_noise() -> None:
    rng, t = np.random.default_rng(6), np.arange(15000) / 25.0
    still = np.array([0.0, 0.0, 9.80665]) + 0.01 * rng.normal(size=(t.size, 3))
    rates = np.array([0.4e-3, 0.5e-3, 0.0]) + 2.4e-4 * rng.normal(size=(t.size, 3))
    rates[:40] += np.linspace(-0.05, 0.05, 40)[:, None]
    for step, told in ((1e-4, True), (1e-3, False)):
        gyroscope = Samples(Sensor.GYROSCOPE, t, step * np.rint(rates / step))
        exam = examine(Samples(Sensor.ACCELEROMETER, t, still), gyroscope, sought=())
        slow = slow_noise(exam, next(s for s in exam.sensors if s.sensor == "gyro"))
        assert (slow is not None) == told


class Swing(Effect):
    """A swing of the gyroscope's bias that has no name."""

    name = "unknown"
    sensor = "gyro"
    follows = "a period in time"
    parameters = (Linear("amplitude", "rad/s", 3, 0.01),)

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return what a unit of it adds, (n, 3, 3)."""
        return on_axes(np.sin(2.0 * np.pi * moments.age / 250.0))


@pytest.mark.parametrize(("amplitude", "told"), [(1e-5, True), (5e-3, False)])
def test_what_a_large_effect_without_a_name_leaves_is_no_slow_noise(amplitude: float, told: bool) -> None:
    """It departs from its form by a twentieth, with a third of its period."""
    rng, t = np.random.default_rng(8), np.arange(6000) / 5.0
    swing = np.sin(2.0 * np.pi * t / 250.0) + 0.05 * np.sin(6.0 * np.pi * t / 250.0)
    still = np.array([0.0, 0.0, 9.80665]) + 0.01 * rng.normal(size=(t.size, 3))
    rates = amplitude * swing[:, None] + 1e-4 * rng.normal(size=(t.size, 3))
    exam = examine(Samples(Sensor.ACCELEROMETER, t, still), Samples(Sensor.GYROSCOPE, t, rates), sought=())
    residuals = next(s for s in exam.sensors if s.sensor == "gyro")
    where = Where(0.0, 1200.0, (0.0, 0.01), Swing.follows)
    found = Finding("unknown", "gyro", [], where, {}, Evidence(99.0), [], "")
    stated = Stated(found, residuals.hypothesis(Swing(), {}), residuals)
    exam = replace(exam, statements=[stated])
    assert (slow_noise(exam, residuals) is not None) == told
    assert (why_no_slow_noise(exam, residuals) is None) == told


def test_wander_of_a_phone_in_a_train_is_the_trains() -> None:
    rng, t = np.random.default_rng(7), np.arange(30000) / 50.0
    pulled = np.repeat(rng.normal(0.0, 0.05, 600), 50)[:, None] * np.array([0.0, 0.0, 1.0])
    still = np.array([0.0, 0.0, 9.80665]) + 0.01 * rng.normal(size=(t.size, 3))
    found = Finding(
        "unknown", "accel", [], Where(0.0, 600.0, (0.0, 0.01), NO_DRIVER), {}, Evidence(9.0), [], ""
    )
    for force, motion in ((still, False), (still + pulled, True)):
        exam = examine(Samples(Sensor.ACCELEROMETER, t, force), None, sought=())
        assert _is_motion((found, True), (exam, exam)) == motion


def test_noise_louder_than_any_sensors_is_a_difference_where_all_rests_have_it() -> None:
    """It was not compared, as if something shook the phone, and no difference was found."""
    loud, usual = (examine(stepped(sd, 0.0, 3), None, sought=()) for sd in (0.15, 0.03))
    assert loud.streams[0].levels is not None and loud.streams[0].levels.loud and not loud.statements
    found = compare(loud, usual, ("rec", "sim")).discrepancies
    assert [(d.effect, d.relation) for d in found] == [(LEVEL, "too_small")]


def stepped(noise: float, step: float, seed: int) -> Samples:
    """Return ten minutes of rests in 20 attitudes, the values in steps. noise: sd, m/s^2."""
    rng = np.random.default_rng(seed)
    n = int(600.0 * RATE)
    rests = np.repeat(rng.normal(0.0, 5.0, (20, 3)), n // 20, axis=0)
    values = rests + rng.normal(0.0, noise, (n, 3)) if noise else rests
    return Samples(
        Sensor.ACCELEROMETER, np.arange(n) / RATE, step * np.rint(values / step) if step else values
    )


@pytest.mark.parametrize(
    ("noise", "step", "told"),
    [
        *((0.0, 0.01, True), (0.002, 0.01, True), (0.0, 0.1, False), (0.01, 0.0, False), (0.0, 0.0, True)),
        *((0.0, 0.04, True), (0.0085, 0.03, False)),
    ],
)
def test_values_that_stay_on_one_step_lack_noise_that_would_move_them(
    noise: float, step: float, told: bool
) -> None:
    """The recording's is 0.02 m/s^2: of less than a step of 0.1 nothing would be seen.

    One that steps of 0.04 would just show agreed, and a third of a step was none beside twice as much.
    """
    exams = examine(stepped(0.02, 0.0, 1), None, sought=()), examine(stepped(noise, step, 2), None, sought=())
    recorded, simulated = (side.get((LEVEL, "accel")) for side in of_both(exams))
    assert recorded is not None and not recorded.none
    assert (simulated is not None and simulated.none) == told
    found = compare(*exams, ("rec", "sim")).discrepancies
    assert ((LEVEL, "lacking") in [(d.effect, d.relation) for d in found]) == told
    put_in = "All else was judged with the noise of a quiet phone put into sim."
    assert (put_in in [d.note for d in found if d.effect == LEVEL]) == (not step and not noise)

    if not noise and not told:
        assert simulated is None and why_no_density(exams[1].streams[0]).endswith("steps that hide the noise")


def test_noise_of_one_axis_that_a_step_would_hide_is_not_lacking() -> None:
    """The recording's z has less noise than would move the simulation's values."""
    quiet_z = stepped(0.02, 0.0, 1)
    xyz = quiet_z.xyz.copy()
    xyz[:, 2] = np.round(xyz[:, 2] / 20.0) * 20.0 + np.random.default_rng(4).normal(0.0, 1e-3, len(xyz))
    exams = [examine(one, None, sought=()) for one in (replace(quiet_z, xyz=xyz), stepped(0.0, 0.01, 2))]
    recorded, simulated = (side.get((LEVEL, "accel")) for side in of_both(exams))
    assert recorded is not None and simulated is None


def test_a_slow_log_has_all_the_noise_in_a_narrower_band() -> None:
    assert loudest("accel", 100.0) == loudest("accel", 21.0) == LOUDEST["accel"]
    assert loudest("accel", 21.0 / 4.0) == pytest.approx(2.0 * LOUDEST["accel"])


def walks(*sensors: str) -> Any:
    """Return what an examination states: a random walk of each of some sensors."""
    stated = [SimpleNamespace(finding=SimpleNamespace(effect=f"{s}_bias_random_walk")) for s in sensors]
    return SimpleNamespace(statements=stated)


@pytest.mark.parametrize(
    ("larger", "stated", "effect", "relation"),
    [
        (20.0, ("gyro", ""), "gyro_bias_random_walk", "lacking"),
        (0.05, ("", "gyro"), "gyro_bias_random_walk", "superfluous"),
        (2.0, ("gyro", "gyro"), "gyro_bias_random_walk", "too_small"),
        (2.0, ("gyro", ""), "gyro_bias_random_walk", "too_small"),
        (20.0, ("", ""), "gyro_slow_noise", "too_small"),
        (20.0, ("accel", "gyro"), "gyro_slow_noise", "too_small"),
    ],
)
def test_slow_noise_has_the_name_that_the_recording_with_more_of_it_states(
    larger: float, stated: tuple[str, str], effect: str, relation: str
) -> None:
    """A random walk that one of the two alone has was slow noise, of which there is more."""
    own, other = resting(1e-3, 1e-3 * larger, 1), resting(1e-3, 1e-3, 2)
    found = by_name(difference_of(own, other), [walks(one) for one in stated])
    assert found.recorded.effect == found.simulated.effect == effect
    assert found.relation() == relation


def test_a_walk_has_the_density_that_makes_its_allan_deviation() -> None:
    """N sqrt(tau / 3) of IEEE Std 952-1997, beside white noise."""
    own = resting(1e-3, 1e-2, 1)
    found = by_name(difference_of(own, resting(1e-3, 1e-5, 2)), [walks("gyro"), walks()])
    own_part = np.sqrt(np.exp(2.0 * own.value) - own.white)
    assert np.exp(found.recorded.value) == pytest.approx(own_part * np.sqrt(3.0 / 100.0))
    assert [p.unit for p in found.recorded.parts] == ["rad/s/sqrt(s)"]


def test_what_is_hardly_more_than_white_noise_leaves_an_unsure_walk() -> None:
    """Where half of the variance is the walk's, its density is twice as unsure as the whole."""
    seen = resting(1e-3, 1e-2, 1)
    half = _as_walk(replace(seen, value=0.5 * np.log(2.0 * seen.white)))
    assert half.sigma == pytest.approx(2.0 * seen.sigma)
    assert np.exp(half.value) == pytest.approx(np.sqrt(3.0 * seen.white / 100.0))
    less = _as_walk(replace(seen, value=0.5 * np.log(0.9 * seen.white)))
    assert np.exp(less.value) == pytest.approx(np.sqrt(3.0 * 0.09 * seen.white / 100.0))
    assert less.sigma == pytest.approx(10.0 * seen.sigma)


def test_an_accelerometer_s_walk_is_that_of_its_norm_on_each_axis() -> None:
    seen = resting(1e-3, 1e-2, 1)
    one = replace(
        seen, sensor="accel", value=seen.value[:1], covariance=seen.covariance[:1, :1], white=seen.white[:1]
    )
    made = _as_walk(one)
    assert made.value == pytest.approx(np.full(3, _as_walk(seen).value[0]))
    assert made.covariance == pytest.approx(np.full((3, 3), made.covariance[0, 0]))


def test_what_agrees_is_a_walk_only_where_both_state_one() -> None:
    one = replace(difference_of(resting(1e-3, 1e-2, 1), resting(1e-3, 1e-2, 2)), agrees=True)
    for stated, effect in (("gyro", "gyro_bias_random_walk"), ("", "gyro_slow_noise")):
        assert by_name(one, [walks("gyro"), walks(stated)]).recorded.effect == effect
