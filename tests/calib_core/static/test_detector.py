"""The stationary detector: splits and restores, pairing of streams, probing, settings."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stillcal.calib_core.codec import packed, unpacked
from stillcal.calib_core.static.detector import DetectorState, StationaryDetector
from stillcal.calib_core.static.gather import uniform
from stillcal.calib_core.static.rest import group_attitudes
from stillcal.calib_core.static.settings import DetectorSettings, Mode, Sense, Sleep
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.studies.grammenos2018.algorithm_1 import algorithm_1

UPS = [(0, 0, 1), (1, 0, 0), (0, -1, 0), (1, 1, 0), (0, 1, 1), (-1, 0, 1)]


def detect(*blocks, **knobs):
    detector = StationaryDetector(DetectorSettings(**knobs))
    return detector.feed(*blocks) + detector.finish(), detector


def day(bench, seed, accel_rate, gyro_rate):
    """Minutes of rests and motion, with a gap and a change of the rate."""
    b = bench(seed, accel_rate=accel_rate, gyro_rate=gyro_rate)
    for i, up in enumerate(UPS):
        b.shaking(b.rng.uniform(1, 5)).still(b.rng.uniform(1, 25), up)
        if i == 3:
            b.pause(b.rng.uniform(0.1, 15.0))  # and 10 s of block and 3 s of lag: within max_lag_s
            b.accel_rate = 25.0
    return b


def fed_in_pieces(b, cuts, rng, knobs):
    """Feed both streams cut at `cuts` (s), the gyroscope up to 3 s off, in either order, restoring."""
    accel, gyro = b.accel, b.gyro
    detector, rests, at = StationaryDetector(knobs), [], [0, 0]
    detector.wants(0.0)
    for cut in [*cuts, math.inf]:
        to = [int(np.searchsorted(accel.t, cut)), int(np.searchsorted(gyro.t, cut + rng.uniform(-3, 3)))]
        blocks = [accel[at[0] : to[0]], gyro[at[1] : max(to[1], at[1])]]
        for block in blocks if rng.random() < 0.5 else blocks[::-1]:
            rests += detector.feed(block)
        at = [to[0], max(to[1], at[1])]
        if rng.random() < 0.3:
            saved = packed(detector.state)
            detector = StationaryDetector(knobs, unpacked(saved, DetectorState))
            assert packed(detector.state) == saved
    return rests + detector.finish(), detector


# The fixture is a pure function: sharing it between examples shares nothing.
@pytest.mark.slow
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32),
    accel_rate=st.sampled_from([5.0, 23.7, 50.0, 200.0]),
    gyro_rate=st.sampled_from([5.0, 50.0, 104.0]),
    mode=st.sampled_from(Mode),
)
def test_split_and_restored_streams_give_the_same_rests_bit_for_bit(bench, seed, accel_rate, gyro_rate, mode):
    b = day(bench, seed, accel_rate, gyro_rate)
    knobs = DetectorSettings(mode=mode, probe_min_s=1.0, probe_max_s=8.0, seed=seed)
    rng = np.random.default_rng(seed)
    cuts = np.sort(np.concatenate((np.arange(5.0, b.t, 10.0), rng.uniform(0, b.t, rng.integers(1, 60)))))
    detector = StationaryDetector(knobs)
    detector.wants(0.0)
    whole = detector.feed(b.accel, b.gyro) + detector.finish()
    parts, pieces = fed_in_pieces(b, cuts, rng, knobs)
    assert packed(parts) == packed(whole)
    assert pieces.ledger == detector.ledger


def test_feeding_on_does_not_change_a_snapshot(bench):
    b = bench(1).still(10.0).shaking(2.0).still(10.0)
    detector = StationaryDetector()
    detector.feed(b.accel[:200], b.gyro[:200])
    state = detector.state
    before = packed(state)
    detector.feed(b.accel[200:], b.gyro[200:])
    assert packed(state) == before
    StationaryDetector(state=state).feed(b.accel[200:], b.gyro[200:])
    assert packed(state) == before


def test_every_field_of_a_rest_is_filled(bench):
    b = bench(2).shaking(3.0).still(30.0).shaking(3.0)
    t = b.accel.t
    warm = Samples.checked(Sensor.ACCELEROMETER, t, b.accel.xyz, temperature=20 + t / 10)
    (rest,), detector = detect(warm, b.gyro)
    assert 3.5 <= rest.t_start <= 4.0
    assert 32.0 <= rest.t_end <= 32.5
    assert rest.n == pytest.approx(50 * rest.duration, abs=2)
    assert rest.temperature == pytest.approx(20 + (rest.t_start + rest.t_end) / 20, abs=0.01)
    np.testing.assert_allclose(rest.force_sd, 0.02, rtol=0.1)
    np.testing.assert_allclose(rest.rate_sd, 0.002, rtol=0.1)
    assert rest.level == pytest.approx(0.02, rel=0.1)
    assert rest.rate_level == pytest.approx(0.002, rel=0.1)
    np.testing.assert_allclose(rest.specific_force, [0, 0, 9.80665], atol=4 * 0.02 / math.sqrt(rest.n))
    np.testing.assert_allclose(rest.rate, b.gyro_bias, atol=4 * 0.002 / math.sqrt(rest.n))
    assert 0 < rest.tilt_rate_limit < 1e-4
    assert rest.undetected_rotation_bound >= 0.005
    accel_floor, gyro_floor = detector.noise_floor(50.0)
    assert accel_floor == pytest.approx(0.02, rel=0.1)
    assert gyro_floor == pytest.approx(0.002, rel=0.1)


def test_long_stillness_becomes_rests_of_at_most_five_minutes(bench):
    b = bench(3, accel_rate=25, gyro_rate=25).still(1000.0)
    rests, _ = detect(b.accel, b.gyro)
    assert [round(r.duration) for r in rests] == [300, 300, 300, 100]


def test_a_lagging_gyroscope_is_waited_for(bench):
    b = bench(4).still(20.0).shaking(3.0).still(20.0)
    detector, rests = StationaryDetector(), []
    for start in range(0, len(b.accel), 100):
        rests += detector.feed(b.accel[start : start + 100])
        late = max(start - 500, 0)
        rests += detector.feed(b.gyro[late : max(start - 400, 0)])
    rests += detector.feed(b.gyro[late + 100 :]) + detector.finish()
    assert len(rests) == 2
    assert all(r.rate is not None for r in rests)
    assert detector.ledger.gyro_late == 0


def test_a_lost_gyroscope_is_waited_for_only_so_long_and_taken_up_again(bench):
    b = bench(5)
    for _ in range(8):
        b.shaking(5.0).still(25.0)
    detector, rests = StationaryDetector(), []
    for start in range(0, len(b.accel), 50):
        now = start / 50
        rests += detector.feed(b.accel[start : start + 50])
        if not 60 <= now < 150:
            rests += detector.feed(b.gyro[start : start + 50])
        if now < 140:
            assert detector.state.accel.rows.shape[0] <= 62
    rests += detector.finish()
    assert [r.rate is not None for r in rests] == [True, True, False, False, False, True, True, True]


def test_a_stream_that_runs_backwards_is_refused(bench):
    b = bench(6).still(2.0)
    detector = StationaryDetector()
    detector.feed(b.accel[50:])
    with pytest.raises(ValueError, match="accelerometer runs backwards"):
        detector.feed(b.accel[:50])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("w_min_s", 0.5),
        ("accel_factor", 0.0),
        ("window_s", math.nan),
        ("probe_max_s", 1.0),
        ("max_rest_s", 0.5),
    ],
)
def test_settings_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        DetectorSettings(**{name: value})


def test_settings_come_from_plain_values():
    knobs = msgspec.convert({"mode": "probe", "w_min_s": 2, "seed": 7}, DetectorSettings)
    assert (knobs.mode, knobs.w_min_s, knobs.seed) == (Mode.PROBE, 2, 7)


# --- probing ---


def probed_day(b, **knobs):
    """Answer the detector's wants as an engine would: samples only while it wants them."""
    detector, rests, asked, now = StationaryDetector(DetectorSettings(mode=Mode.PROBE, **knobs)), [], [], 0.0
    accel, gyro = b.accel, b.gyro
    while now < b.t:
        want = detector.wants(now)
        if isinstance(want, Sleep):
            assert want.until > now
            now = want.until
            continue
        end = max(want.until, now + 0.1)
        rests += detector.feed(gyro.between(now, end), accel.between(now, end))
        asked.append((now, end))
        now = end
    return rests + detector.finish(), detector, asked


def test_probing_finds_rests_at_a_fraction_of_the_on_time(bench):
    b = bench(7, accel_rate=25, gyro_rate=25)
    for i in range(60):
        b.shaking(60.0).still(60.0, UPS[i % 6])
    rests, detector, asked = probed_day(b, seed=3)
    ledger = detector.ledger
    assert len(group_attitudes(rests, 0.1)) == 6
    assert ledger.asked_s < 0.06 * b.t
    assert sum(end - start for start, end in asked) < 1.2 * ledger.asked_s + 0.2 * len(asked)
    assert ledger.accel_samples == pytest.approx(25 * ledger.asked_s, rel=0.1)
    assert ledger.probes >= len(rests) + ledger.abandoned
    assert 0.3 < ledger.abandoned / ledger.probes < 0.7
    assert {r.rate is None for r in rests} == {False}
    lengths = [r.duration for r in rests]
    assert min(lengths) >= 0.9
    assert max(lengths) <= 10.5
    assert max(lengths) > 7


def test_probing_reads_nothing_outside_what_it_asked_for(bench):
    b = bench(8).still(600.0)
    rests, detector = detect(b.accel, b.gyro, mode=Mode.PROBE)
    ledger = detector.ledger
    assert ledger.accel_samples + ledger.accel_unasked == len(b.accel)
    assert ledger.accel_samples < 0.2 * len(b.accel)
    assert sum(r.duration for r in rests) <= ledger.asked_s


def test_a_probe_is_cut_off_at_the_first_window_that_moves(bench):
    b = bench(9).shaking(600.0)
    _, detector, asked = probed_day(b)
    assert detector.ledger.abandoned == detector.ledger.probes > 0
    assert detector.ledger.asked_s <= 1.0 * detector.ledger.probes
    assert max(end - start for start, end in asked) <= 1.0


def test_probe_times_follow_the_seed_and_nothing_else():
    def times(seed):
        detector, now, out = StationaryDetector(DetectorSettings(mode=Mode.PROBE, seed=seed)), 0.0, []
        for _ in range(20):
            out.append(detector.next_probe(now))
            now = out[-1] + 40.0  # given up w_min + max_lag = 31 s after its start
            detector.wants(now)
            detector = StationaryDetector(detector.settings, unpacked(packed(detector.state), DetectorState))
        return np.array(out)

    np.testing.assert_array_equal(times(1), times(1))
    assert not np.array_equal(times(1), times(2))
    pauses = np.diff(times(1)) - 31.0
    assert pauses.min() >= 30.0
    assert pauses.max() <= 301.0


def test_draws_are_uniform():
    draws = np.array([uniform(11, i) for i in range(4000)])
    assert 0 <= draws.min() <= draws.max() < 1
    counts = np.histogram(draws, 20, (0, 1))[0]
    assert ((counts - 200) ** 2 / 200).sum() < 43.8  # chi-squared, 19 degrees, 0.1 %


def test_probing_bears_sensors_that_take_a_second_to_start(bench):
    b = bench(10).still(4000.0)
    detector = StationaryDetector(DetectorSettings(mode=Mode.PROBE))
    rests, now = [], 0.0
    while now < 3900:
        want = detector.wants(now)
        if isinstance(want, Sense):
            first = now + (1.2 if not rests or now > rests[-1].t_end + 20 else 0.0)
            rests += detector.feed(*(s.between(first, want.until + 1.5) for s in (b.gyro, b.accel)))
            now = want.until + 1.5
        else:
            now = want.until
    assert len(rests) > 10


def test_modes_are_switched_on_the_way(bench):
    b = bench(11).still(100.0)
    detector = StationaryDetector()
    assert detector.wants(0.0) == Sense(math.inf)
    rests = detector.feed(b.accel[:2000], b.gyro[:2000])
    rests += detector.set_mode(Mode.PROBE)
    assert [r.duration for r in rests] == [pytest.approx(39.5, abs=0.05)]
    assert isinstance(detector.wants(40.0), Sleep)
    assert detector.feed(b.accel[2000:3000], b.gyro[2000:3000]) == []
    assert detector.ledger.probes == 0  # the first begins 30 s later at the earliest
    assert detector.ledger.accel_unasked > 900
    detector.set_mode(Mode.SCAN)
    rests = detector.feed(b.accel[3000:], b.gyro[3000:]) + detector.finish()
    assert rests[-1].t_end == pytest.approx(99.98)


# --- Algorithm 1 as printed ---


def test_algorithm_1_finds_rests_where_its_start_suits(bench):
    b = bench(12).still(20.0)
    for up in UPS:
        b.shaking(10.0).still(30.0, up)
    run = algorithm_1(b.accel, b.gyro, states=8, settings=DetectorSettings(probe_min_s=0.0, probe_max_s=5.0))
    assert len(run.states) == 8
    assert run.sigma_accel_min == min(s.sigma_accel for s in run.states)
    assert all(np.linalg.norm(s.specific_force) == pytest.approx(9.80665, abs=0.05) for s in run.states)


def test_algorithm_1_from_exactly_zero_never_accepts(bench):
    """Line 4 read literally (sigma_g,min = 0): nothing is below three times nothing."""
    b = bench(13).still(60.0)
    assert algorithm_1(b.accel, b.gyro, states=1, sigma_gyro_min=0.0).states == []
