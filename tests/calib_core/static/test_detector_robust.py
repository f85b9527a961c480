"""Where the paper's rule or a naive one fails: each test shows that, and that the detector does better."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.settings import DetectorSettings, Label
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.studies.grammenos2018.algorithm_1 import algorithm_1

G = 9.80665
UPS = [(0, 0, 1), (1, 0, 0), (0, -1, 0), (1, 1, 0), (0, 1, 1), (-1, 0, 1)]
EAGER = DetectorSettings(probe_min_s=0.0, probe_max_s=1.0, w_spread_s=2.0)


def detect(*blocks, **knobs):
    detector = StationaryDetector(DetectorSettings(**knobs))
    return detector.feed(*blocks) + detector.finish(), detector


def covered(rests, span):
    """Share of `span` (s, s) that rests cover."""
    return sum(max(min(r.t_end, span[1]) - max(r.t_start, span[0]), 0) for r in rests) / (span[1] - span[0])


def test_a_freak_quiet_moment_does_not_end_acceptance(bench):
    b = bench(1).still(4.0, noise=0.05)
    for up in UPS:
        b.shaking(3.0).still(10.0, up)
    paper = algorithm_1(b.accel, b.gyro, states=99, settings=EAGER)
    assert all(s.t_end <= 4.5 for s in paper.states)
    rests, _ = detect(b.accel, b.gyro)
    assert sum(r.t_start > 4.0 for r in rests) == len(UPS)


def test_walking_from_the_start_is_not_taken_for_a_rest(bench):
    b = bench(2).shaking(120.0, force=2.0, rate=0.8)
    paper = algorithm_1(b.accel, b.gyro, states=5, sigma_gyro_min=0.3, settings=EAGER)
    assert len(paper.states) == 5
    rests, detector = detect(b.accel, b.gyro)
    assert rests == []
    assert detector.ledger.windows.keys() <= {Label.ACCEL_MOVING, Label.GYRO_MOVING, Label.IMPLAUSIBLE}


def test_rests_taken_before_the_floor_was_known_are_withdrawn(bench):
    b = bench(3, accel_noise=0.012).still(20.0, noise=5.0).shaking(3.0).still(20.0, UPS[1])
    rests, detector = detect(b.accel, b.gyro)
    assert [detector.still_valid(r) for r in rests] == [False, True]


def test_a_floor_that_rose_for_good_is_learnt_again(bench):
    b = bench(4, accel_rate=25, gyro_rate=25).still(300.0)
    for _ in range(80):
        b.shaking(4.0).still(60.0, UPS[1], noise=3.5)
    rests, _ = detect(b.accel, b.gyro, half_life_s=600.0)
    assert covered(rests, (b.t - 600.0, b.t)) > 0.8


@pytest.mark.parametrize("rate", [5.0, 12.5, 25.0, 50.0, 100.0, 200.0, 400.0])
def test_every_sampling_rate(bench, rate):
    b = bench(5, accel_rate=rate, gyro_rate=rate).still(10.0)
    for up in UPS:
        b.shaking(6.0).still(20.0, up)
    rests, _ = detect(b.accel, b.gyro)
    assert sum(r.t_start > 10.0 and r.duration > 10.0 for r in rests) == len(UPS)


def test_a_rate_that_changes_on_the_way(bench):
    """Noise grows with bandwidth; a single floor learnt at 50 Hz would refuse every rest at 400 Hz."""
    b = bench(6)
    for _ in range(10):
        b.shaking(3.0).still(30.0)
    for rate in (400.0, 5.0, 100.0):
        b.accel_rate = b.gyro_rate = rate
        b.accel_noise, b.gyro_noise = 0.02 * (rate / 50) ** 0.5, 0.002 * (rate / 50) ** 0.5
        b.shaking(3.0).still(60.0, UPS[2])
        start = b.t - 60.0
        rests, _ = detect(b.accel, b.gyro)
        assert covered(rests, (start, b.t)) > 0.6, rate


def test_accelerometer_and_gyroscope_at_unequal_rates(bench):
    b = bench(7, accel_rate=12.5, gyro_rate=400.0).shaking(5.0).still(40.0).shaking(5.0)
    rests, _ = detect(b.accel, b.gyro)
    assert len(rests) == 1
    np.testing.assert_allclose(rests[0].rate, b.gyro_bias, atol=5 * rests[0].rate_uncertainty.max())


def test_a_gap_inside_a_window_cuts_it(bench):
    """The attitude changed while nothing was recorded: a window over both would average two attitudes."""
    b = bench(8).still(10.2).pause(0.6).still(10.0, (0.02, 0, 1))
    rests, detector = detect(b.accel, b.gyro)
    assert len(rests) == 2
    assert not any(r.t_start < 10.3 < r.t_end for r in rests)
    assert detector.ledger.windows[Label.GAP] >= 1
    for r, up in zip(rests, ((0, 0, 1), (0.02, 0, 1)), strict=True):
        truth = G * np.asarray(up) / np.linalg.norm(up)
        assert np.all(np.abs(r.specific_force - truth) < 4 * r.force_uncertainty)


def test_a_night_without_samples(bench):
    b = bench(9).still(20.0).pause(12 * 3600.0).still(20.0)
    rests, _ = detect(b.accel, b.gyro)
    assert [round(r.duration) for r in rests] == [20, 20]


def test_a_stuck_sensor_is_no_rest(bench):
    b = bench(10).still(60.0)
    stuck = Samples.checked(Sensor.ACCELEROMETER, b.accel.t, np.tile([-1.87, 5.87, 7.5], (len(b.accel), 1)))
    assert algorithm_1(stuck, None, states=5, settings=EAGER).states
    rests, detector = detect(stuck, b.gyro)
    assert rests == []
    assert detector.ledger.windows == {Label.FROZEN: 120}


def test_a_sensor_that_hangs_is_cut_off_there(bench):
    b = bench(11).still(60.0)
    xyz = b.accel.xyz.copy()
    xyz[b.accel.t >= 30.0] = xyz[1500]
    rests, detector = detect(Samples.checked(Sensor.ACCELEROMETER, b.accel.t, xyz), b.gyro)
    assert max(r.t_end for r in rests) <= 30.5
    assert detector.ledger.windows[Label.FROZEN] >= 58


def test_a_coarse_sensor_is_not_a_stuck_one(bench):
    """10 bits over 8 g and less noise than one step: many windows repeat exactly, and are genuine."""
    lsb = 0.1532
    rng = np.random.default_rng(12)
    covered_truth, rests_seen, constant = [], 0, 0
    for trial in range(12):
        up = rng.normal(size=3)
        b = bench(100 + trial, accel_noise=0.25 * lsb).still(120.0, up)
        coarse = np.round(b.accel.xyz / lsb) * lsb
        windows = coarse[: 50 * 120].reshape(-1, 25, 3)
        constant += int((np.ptp(windows, axis=1) == 0).all(axis=1).sum())
        rests, _ = detect(Samples.checked(Sensor.ACCELEROMETER, b.accel.t, coarse))
        truth = G * up / np.linalg.norm(up)
        rests_seen += covered(rests, (0.0, b.t)) > 0.7
        for r in rests:
            covered_truth += list(np.abs(r.specific_force - truth) < 2 * r.force_uncertainty)
    assert rests_seen >= 9
    assert np.mean(covered_truth) > 0.95


def test_a_held_sensor_admits_its_fewer_samples(bench):
    """Each reading delivered four times: the mean is as uncertain as that of a quarter of the samples."""
    ratios = []
    for trial in range(20):
        b = bench(trial, accel_rate=200.0).still(30.0)
        held = b.accel.xyz.reshape(-1, 4, 3)[:, :1].repeat(4, axis=1).reshape(-1, 3)
        rests, _ = detect(Samples.checked(Sensor.ACCELEROMETER, b.accel.t, held))
        ratios.append(rests[0].force_uncertainty / (0.02 / np.sqrt(len(b.accel) / 4)))
    assert 0.9 < np.mean(ratios) < 1.8


@pytest.mark.parametrize("bias", [0.05, 0.5, 3.0])
def test_a_large_gyroscope_bias_prevents_nothing(bench, bias):
    """A fixed clip of 0.1 rad/s on the mean rate, as common tools have it, finds nothing here."""
    b = bench(13, gyro_bias=(bias, -bias, bias)).shaking(5.0).still(20.0).shaking(5.0)
    rests, _ = detect(b.accel, b.gyro)
    assert covered(rests, (5.0, 25.0)) > 0.85
    np.testing.assert_allclose(rests[0].rate, b.gyro_bias, atol=5 * rests[0].rate_uncertainty.max())


@pytest.mark.parametrize("turning", [0.0002, 0.001, 0.005, 0.02, 0.05])
@pytest.mark.parametrize("with_gyro", [True, False])
def test_slow_turning_about_a_horizontal_axis_is_rejected_or_admitted(bench, turning, with_gyro):
    b = bench(14).still(30.0).shaking(3.0)

    def force(t):
        return G * np.stack((np.sin(turning * t), np.zeros_like(t), np.cos(turning * t)), axis=1)

    b.add(120.0, force, lambda t: np.asarray(b.gyro_bias) + turning * np.array([0, 1.0, 0]) + 0 * t[:, None])
    b.shaking(3.0)
    if turning >= 0.001:
        paper = algorithm_1(b.accel, b.gyro, states=99, settings=EAGER)
        assert sum(s.t_start > 33.0 for s in paper.states) > 5
    rests, detector = detect(*((b.accel, b.gyro) if with_gyro else (b.accel,)))
    turned = [r for r in rests if r.t_start > 33.0]
    assert all(r.tilt_rate_limit >= turning for r in turned)
    if turning >= 0.005:
        assert turned == []
        reasons = detector.ledger.windows | detector.ledger.rests
        assert reasons.keys() & {Label.TILTING, Label.SHORT, Label.ACCEL_MOVING}


def test_turning_about_the_vertical_cannot_be_seen_and_is_admitted(bench):
    spin = 0.03
    b = bench(15).add(
        60.0,
        lambda t: np.tile([0, 0, G], (t.size, 1)),
        lambda t: np.array([0.001, 0.002, 0.001 + spin]) + 0 * t[:, None],
    )
    rests, _ = detect(b.accel, b.gyro)
    assert len(rests) == 1
    assert rests[0].undetected_rotation_bound >= spin
    assert rests[0].tilt_rate_limit < 0.001


def test_accelerometer_alone(bench):
    b = bench(16)
    for up in UPS:
        b.shaking(3.0).still(10.0, up)
    rests, detector = detect(b.accel)
    assert len(rests) == len(UPS)
    assert all(r.rate is None and r.undetected_rotation_bound is None and r.rate_level is None for r in rests)
    assert detector.ledger.gyro_samples == 0


def test_turned_gently_over_between_two_windows(bench):
    """No window is loud, yet half of them are in another attitude: the mean steps away."""
    b = bench(17).still(10.0).still(10.0, (0.01, 0, 1))
    assert np.linalg.norm(b.accel.xyz, axis=1).std() < 2 * 0.02
    rests, _ = detect(b.accel, b.gyro)
    assert len(rests) == 2
    assert rests[0].t_end <= 10.0 <= rests[1].t_start


@pytest.mark.parametrize("seed", range(20))
def test_rests_hold_no_motion_at_their_edges(bench, seed):
    """Motion begins and ends anywhere within a window, gently or not."""
    rng = np.random.default_rng(seed)
    b = bench(seed, accel_rate=100.0, gyro_rate=100.0)
    still = []
    for _ in range(6):
        b.shaking(rng.uniform(2.0, 5.0), force=rng.uniform(0.3, 3.0), rate=rng.uniform(0.05, 1.0))
        start = b.t
        b.still(rng.uniform(4.0, 12.0))
        still.append((start, b.t))
    rests, _ = detect(b.accel, b.gyro)
    inside = [[a - 0.02 <= r.t_start and r.t_end <= z + 0.02 for a, z in still] for r in rests]
    assert all(sum(row) == 1 for row in inside)
    for span in still:
        assert covered(rests, span) * (span[1] - span[0]) > span[1] - span[0] - 2.1


def test_handheld_tremor_is_rejected(bench):
    """A phone held as still as one can: tremor at 9 Hz, 8 mm/s^2 and more in each axis, and slow sway."""
    b = bench(18).still(30.0).shaking(3.0)
    sway = np.cumsum(b.rng.normal(0, 0.0006, (60 * 50, 3)), axis=0)

    def held(t):
        tremor = 0.08 * np.sin(2 * np.pi * 9.0 * t)[:, None] * [1, 0.7, 0.5]
        return np.array([0, 0, G]) + tremor + G * sway[: t.size]

    def rate(t):
        return np.asarray(b.gyro_bias) + 0.03 * np.sin(2 * np.pi * 9.0 * t)[:, None] * [1, 1, 0.5]

    b.add(60.0, held, rate)
    rests, detector = detect(b.accel, b.gyro)
    assert not [r for r in rests if r.t_start > 33.0]
    rests, _ = detect(b.accel[1650:], b.gyro[1650:])
    assert rests == [] or not any(detector.still_valid(r) for r in rests)


@pytest.mark.parametrize("tilt", [0.001, 0.003, 0.006])
@pytest.mark.parametrize("hz", [0.2, 0.3])
def test_breathing_is_rejected_or_its_uncertainty_covers(bench, tilt, hz):
    """A phone on a breathing chest: gravity sways by `tilt` and 4 mm of rise and fall push along it."""
    covers, mean = [], np.array([0, 0, G])
    for seed in range(6):
        b = bench(seed).still(20.0).shaking(3.0)
        phase = b.rng.uniform(0, 6.28)

        def force(t, phase=phase):
            wave = np.sin(2 * np.pi * hz * t + phase)[:, None]
            return mean + G * tilt * wave * [1, 0, 0] + 0.004 * (2 * np.pi * hz) ** 2 * wave * [0, 0, 1]

        def rate(t, b=b, phase=phase):
            turn = tilt * 2 * np.pi * hz * np.cos(2 * np.pi * hz * t + phase)[:, None] * [0, 1, 0]
            return np.asarray(b.gyro_bias) + turn

        b.add(90.0, force, rate).shaking(3.0)
        rests, _ = detect(b.accel, b.gyro)
        for r in rests:
            if r.t_start > 23.0:
                covers += list(np.abs(r.specific_force - mean) < 3 * r.force_uncertainty)
                assert r.tilt_rate_limit > 0
    assert not covers or np.mean(covers) > 0.97


@pytest.mark.parametrize("amplitude", [0.05, 0.2, 1.0, 2.0])
@pytest.mark.parametrize("hz", [10.0, 17.3, 24.9])
def test_a_washing_machine_is_rejected_or_its_uncertainty_covers(bench, amplitude, hz):
    covers, mean = [], np.array([0, 0, G])
    for seed in range(4):
        b = bench(seed)

        def force(t, b=b):
            slow = 1 + 0.3 * np.sin(2 * np.pi * 0.05 * t)
            return mean + (amplitude * slow * np.sin(2 * np.pi * hz * t))[:, None] * [0.3, 0.2, 1]

        b.still(20.0).shaking(3.0).add(60.0, force, b._bias).shaking(3.0)
        rests, _ = detect(b.accel, b.gyro)
        late = [r for r in rests if r.t_start > 23.0]
        for r in late:
            covers += list(np.abs(r.specific_force - mean) < 3 * r.force_uncertainty)
    assert not covers or np.mean(covers) > 0.97


def test_what_is_not_gravity_is_implausible(bench):
    t = np.arange(3000) / 50.0
    zeros = Samples.checked(Sensor.ACCELEROMETER, t, np.random.default_rng(0).normal(0, 0.01, (3000, 3)))
    rests, detector = detect(zeros)
    assert rests == []
    assert detector.ledger.windows == {Label.IMPLAUSIBLE: 120}
