"""The motion behind a recording holds nothing of what the simulated phone adds again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.clear_bins import still_bins
from stillcal.calib_core.diagnosis.comparison.direct import stamps_as_compared
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.built_in import judge_built_in
from stillcal.replay.diagnosis.phone.phone_file import phone_of
from stillcal.replay.diagnosis.phone.resimulate import Motion, moment_of, motion_of, resimulate
from stillcal.replay.diagnosis.phone.twin import conditions_of, fit_affine
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.effects.on_input import GyroNonlinearity, LeverArm, VibrationTone
from stillcal.replay.phone.effects.on_settings import GyroBiasRandomWalk
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.settings import ClockSettings, SensorSettings

T = np.arange(0.0, 120.0, 0.02)
TONE = VibrationTone(frequency=11.0, amplitude=(0.3, 0.2, 0.1))


def test_a_vibration_is_taken_off_the_recorded_motion_between_rests() -> None:
    """Played beside itself, it would jump in phase at the end of every rest."""
    angle = np.interp(T, [40.0, 44.0, 80.0, 84.0], [0.0, 1.0, 1.0, 2.0])
    force = STANDARD * np.stack([np.sin(angle), np.zeros(T.size), np.cos(angle)], axis=1)
    shaken = force + np.outer(np.sin(2.0 * np.pi * 11.0 * T + 1.0), TONE.amplitude)
    shaken += np.random.default_rng(0).normal(0.0, 0.005, shaken.shape)
    recording = Recording(Samples(Sensor.ACCELEROMETER, frozen(T), frozen(shaken)), None, [], Claims(), [])
    bins = still_bins(recording.accelerometer, None)
    conditions = conditions_of(bins)
    affine = fit_affine(bins, [TONE], conditions, STANDARD)
    found = motion_of(recording, bins, affine, [TONE], conditions, gravity=STANDARD)
    fast = np.diff(found.force - force, axis=0)[(angle[1:] > 0.05) & (angle[1:] < 0.95)]
    assert fast.std(axis=0).max() < 0.02, "of 0.27 with the vibration"


def test_what_a_gross_nonlinearity_added_is_solved_for() -> None:
    """At 5 rad/s this reads a third too large: taken at what was read, and again, it went to and fro."""
    true = np.outer(
        np.sin(2.0 * np.pi * 0.7 * T) * np.interp(T, [40.0, 45.0, 80.0, 85.0], [0.0, 5.0, 5.0, 0.0]),
        np.eye(3)[0],
    )
    accel = Samples(Sensor.ACCELEROMETER, frozen(T), frozen(np.tile([0.0, 0.0, STANDARD], (T.size, 1))))
    bent = GyroNonlinearity(cubic=(0.0132, 0.0, 0.0))
    streams = accel, replace(accel, sensor=Sensor.GYROSCOPE, xyz=frozen(true + 0.0132 * true**3))
    recording, bins = Recording(*streams, [], Claims(), []), still_bins(*streams)
    conditions = conditions_of(bins)
    found = motion_of(
        recording, bins, fit_affine(bins, [bent], conditions, STANDARD), [bent], conditions, gravity=STANDARD
    )
    assert found.rate is not None
    turns = np.abs(true[:, 0]) > 0.1
    assert np.abs(found.rate - true)[turns].max() < 0.005


def test_a_single_moment_of_a_motion_can_be_played() -> None:
    """A long recording is played in blocks, of which one may have one moment in a part that is known."""
    force = frozen(np.tile([0.0, 0.0, STANDARD], (T.size, 1)))
    recording = Recording(Samples(Sensor.ACCELEROMETER, frozen(T), force), None, [], Claims(), [])
    bins = still_bins(recording.accelerometer, None)
    conditions = conditions_of(bins)
    motion = motion_of(
        recording, bins, fit_affine(bins, [], conditions, STANDARD), [], conditions, gravity=STANDARD
    )
    moment = moment_of(recording, motion, conditions, T[1:2])
    assert moment.rate_dot.shape == (1, 3) and not moment.rate_dot.any()


@pytest.mark.parametrize(("rate", "felt"), [(0.01, False), (1.0, True)])
def test_noise_of_the_rate_acts_through_no_lever_arm(rate: float, felt: bool) -> None:
    """None of it was taken off the recorded force: a line of the gyroscope became one of the force."""
    force = frozen(np.tile([0.0, 0.0, STANDARD], (T.size, 1)))
    turning = np.outer(rate * np.sin(2.0 * np.pi * 5.0 * T), [1.0, 0.0, 0.0])
    accel = Samples(Sensor.ACCELEROMETER, frozen(T), force)
    streams = accel, replace(accel, sensor=Sensor.GYROSCOPE, xyz=frozen(0.0 * force))
    recording = Recording(*streams, [], Claims(), [])
    conditions = conditions_of(still_bins(*streams))
    ideal = SensorSettings(rate_hz=50.0)
    phone = Phone(accel=ideal, gyro=ideal, effects=(LeverArm(position=(0.0, 0.05, 0.0)),))
    played = resimulate(recording, Motion(T, force, T, turning), conditions, phone)
    assert (np.ptp(played.accelerometer.xyz, axis=0).max() > 0.01) == felt


def lying_still(t: Array) -> Samples:
    """Return the forces of a phone that lies flat, stamped t (n,) s."""
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(np.tile([0.0, 0.0, STANDARD], (t.size, 1))))


def clock_of(samples: Samples) -> ClockSettings:
    """Return the clock of the phone that would have made a recording of these samples."""
    recording = Recording(samples, None, [], Claims(), [])
    bins = still_bins(samples, None)
    conditions = conditions_of(bins)
    affine = fit_affine(bins, [], conditions, STANDARD)
    return phone_of(recording, bins, [], affine, conditions=conditions, gravity=STANDARD).clock


def test_a_phone_has_the_jitter_that_is_compared() -> None:
    """Of stamps most of which are exact, a median said that they have none."""
    samples = lying_still(T + 9e-4 * (np.arange(T.size) % 50 == 7))
    clock = clock_of(samples)
    assert clock.jitter_s == pytest.approx(stamps_as_compared(samples).jitter_s, rel=1e-3)
    assert 0.5e-4 < clock.jitter_s < 2e-4, "9e-4 / sqrt(50)"


def test_a_simulated_clock_loses_as_few_samples_as_the_recorded_one() -> None:
    """Nine in 20,000: most parts of the recording lose none, and the whole is compared."""
    lost = np.random.default_rng(3).choice(np.arange(1, 19_999), 9, replace=False)
    t = np.delete(np.arange(20_000) / 50.0, lost)
    assert clock_of(lying_still(t)).drop_fraction == pytest.approx(9 / 20_000, rel=0.01)


def test_a_simulated_walk_sets_out_from_where_the_recorded_one_did() -> None:
    """It set out from the mean of the recorded walk: the simulated bias was another one."""
    force = frozen(np.tile([0.0, 0.0, STANDARD], (T.size, 1)))
    accel = Samples(Sensor.ACCELEROMETER, frozen(T), force)
    walk = np.outer(0.01 * np.sqrt(T), [1.0, -1.0, 2.0])
    gyro = Samples(Sensor.GYROSCOPE, frozen(T), frozen(walk))
    recording = Recording(accel, gyro, [], Claims(), [])
    bins = still_bins(accel, gyro)
    conditions = conditions_of(bins)
    affine = fit_affine(bins, [], conditions, STANDARD)
    for effects, bias in (([], affine.rate_bias), ([GyroBiasRandomWalk(density=0.01)], bins.rate[0])):
        made = phone_of(recording, bins, effects, affine, conditions=conditions, gravity=STANDARD)
        assert made.gyro is not None and made.gyro.bias == pytest.approx(bias, rel=1e-4)


def test_a_walk_that_was_found_is_not_played_again_as_other_slow_noise() -> None:
    """Fitted to the walk, flicker noise was added to it: ten times the noise level at 1 Hz."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 1200.0, 0.5)
    force = frozen(np.tile([0.0, 0.0, STANDARD], (t.size, 1)))
    accel = Samples(Sensor.ACCELEROMETER, frozen(t), force)
    walk = np.cumsum(rng.normal(0.0, 1e-4, (t.size, 3)), axis=0) + rng.normal(0.0, 1e-4, (t.size, 3))
    gyro = Samples(Sensor.GYROSCOPE, frozen(t), frozen(walk))
    recording = Recording(accel, gyro, [], Claims(), [])
    bins = still_bins(accel, gyro)
    conditions = conditions_of(bins)
    affine = fit_affine(bins, [], conditions, STANDARD)
    slow = []
    for effects in ([], [GyroBiasRandomWalk(density=1e-4)]):
        made = phone_of(recording, bins, effects, affine, conditions=conditions, gravity=STANDARD)
        assert made.gyro is not None
        noise = made.gyro.noise
        slow.append(any([*noise.flicker, *noise.random_walk, *(any(g.sigma) for g in noise.gauss_markov)]))
    assert slow == [True, False]


def test_what_was_no_rest_in_the_recording_is_none_where_it_is_played() -> None:
    """Its noise is there twice: a sleeper's breathing was 'From 3465 to 4232 s the noise is 1.40 times'."""
    t = np.arange(0.0, 900.0, 0.02)
    noise = np.random.default_rng(4).normal(0.0, 0.02, (t.size, 3))
    noise[(t > 300.0) & (t < 500.0)] *= np.sqrt(2.0)
    played = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(noise + np.array([0.0, 0.0, STANDARD])))
    every = still_bins(played, None)
    rests = every.chosen((every.t < 300.0) | (every.t > 500.0))
    rests = replace(rests, rest=(rests.t > 400.0).astype(np.int64))
    doubled, alone = (examine(played, None, sought=(), within=one) for one in (every, rests))
    assert [s.finding.effect for s in doubled.statements] == ["unknown"]
    assert not alone.statements


def test_a_vibration_beyond_a_low_pass_is_played_as_it_was_read() -> None:
    """A phone feels it before its scale and its filter, which leaves a tenth of 22 Hz."""
    t = np.arange(0.0, 400.0, 0.02)
    angle = np.interp(t, [80.0, 82.0, 160.0, 162.0, 240.0, 242.0, 320.0, 322.0], [0, 1, 1, 2, 2, 3, 3, 4])
    force = STANDARD * np.stack([np.sin(angle), np.sin(2.0 * angle) / 2.0, np.cos(angle)], axis=1)
    force *= STANDARD / np.linalg.norm(force, axis=1)[:, None]
    noise = lfilter(*butter(2, 0.64), np.random.default_rng(0).normal(0.0, 0.02, force.shape), axis=0)
    read = force + noise + np.outer(np.sin(2.0 * np.pi * 22.0 * t), [0.02, 0.012, 0.0])
    recording = Recording(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(read)), None, [], Claims(), [])
    judged = judge_built_in(recording)
    assert judged.corrected is not None and judged.case is not None
    assert judged.case.cutoffs["accel"] == pytest.approx(16.0, rel=0.1)
    amplitudes = [f["parameters"]["amplitude"] for f in judged.answer["findings"]]
    assert [a["value"] for a in amplitudes] == [pytest.approx([0.02, 0.012, 0.0], abs=0.001)]
    played = judged.corrected.accelerometer
    rest = (played.t > 10.0) & (played.t < 70.0)
    turned = np.exp(-2j * np.pi * 22.0 * played.t[rest]) * np.hanning(rest.sum())
    found = 4.0 * np.abs(turned @ (played.xyz[rest] - played.xyz[rest].mean(axis=0))) / rest.sum()
    assert found == pytest.approx([0.02, 0.012, 0.0], abs=0.002)
    assert judged.answer["fit"]["still_different"] == []
