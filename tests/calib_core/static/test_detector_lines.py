"""Lines that the detector draws in time and in its ledger: waiting, epochs, refusals, second judgements."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from stillcal.calib_core.static.classify import Coarseness
from stillcal.calib_core.static.detector import DetectorState, StationaryDetector
from stillcal.calib_core.static.noise_floor import Floor
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import DetectorSettings, Label, Mode, Sense
from stillcal.calib_core.streams.samples import Samples, Sensor


def rest_with(force_sd, rate_sd=None):
    sd = np.full(3, 1e-3)
    rate = {} if rate_sd is None else {"rate": sd, "rate_sd": np.full(3, rate_sd), "rate_uncertainty": sd}
    force = np.array([0.0, 0.0, 9.8])
    return RestState(0.0, 10.0, 500, force, np.asarray(force_sd) * np.ones(3), sd, 0.01, **rate)


def knowing(accel_level, gyro_level, accel_steps=None, gyro_steps=None):
    """A detector that has learnt these floors at 50 Hz, and perhaps the steps of coarse sensors."""
    levels = [np.full(9, np.inf), np.full(9, np.inf)]
    levels[0][4], levels[1][4] = accel_level, gyro_level
    coarse = [
        Coarseness() if lsb is None else Coarseness(few=9.0, lsb=np.full(3, lsb))
        for lsb in (accel_steps, gyro_steps)
    ]
    state = DetectorState(Mode.SCAN, floors=[Floor(level=level) for level in levels], coarse=coarse)
    return StationaryDetector(state=state)


@pytest.mark.parametrize(("share", "valid"), [(1 - 1e-9, True), (1 + 1e-9, False)])
def test_a_rest_is_still_valid_up_to_the_factors_over_the_floors(share, valid):
    detector = knowing(0.01, 0.001)
    assert detector.still_valid(rest_with(2 * 0.01 * share, 1e-4)) is valid
    assert detector.still_valid(rest_with(0.001, 3 * 0.001 * share)) is valid
    assert detector.still_valid(rest_with(np.array([3.0, 0.0, 0.0]) ** 0.5 * 0.02 * share)) is valid


@pytest.mark.parametrize(("share", "valid"), [(1 - 1e-9, True), (1 + 1e-9, False)])
def test_a_coarse_sensors_step_is_allowed_on_top(share, valid):
    """The step of three axes of 0.04 rounded: 0.04 sqrt(3 / 12) = 0.02."""
    detector = knowing(0.01, 0.001, accel_steps=0.04, gyro_steps=0.004)
    assert detector.still_valid(rest_with(math.hypot(0.02, 0.02) * share, 1e-4)) is valid
    assert detector.still_valid(rest_with(0.001, math.hypot(0.003, 0.002) * share)) is valid


def test_a_rest_is_judged_by_the_floor_of_its_own_rate():
    detector = knowing(0.01, 0.001)
    slow = replace(rest_with(9.0), n=100)
    assert detector.still_valid(slow)  # nothing is known at 10 Hz
    assert not detector.still_valid(replace(slow, n=500))
    assert detector.noise_floor(50.0) == (0.01, 0.001)
    assert detector.noise_floor(10.0) == (math.inf, math.inf)


def test_a_block_that_begins_before_the_last_one_ended_is_refused(bench):
    b = bench(1).still(4.0)
    for feed in (b.accel, b.gyro):
        detector = StationaryDetector()
        detector.feed(feed[:100])
        with pytest.raises(ValueError, match=f"{feed.sensor} runs backwards, from 1"):
            detector.feed(feed[90:150])
        detector.feed(feed[100:150])
        detector.feed(Samples.empty(feed.sensor))
        detector.feed(feed[149:])  # the same stamp again does not run backwards


@pytest.mark.parametrize(("lag", "waits"), [(4.0, True), (6.0, False)])
def test_the_gyroscope_is_waited_for_as_long_as_the_settings_say(bench, lag, waits):
    b = bench(2).still(20.0)
    detector = StationaryDetector(DetectorSettings(max_lag_s=5.0))
    detector.feed(b.gyro.between(0.0, 5.0), b.accel.between(0.0, 5.0))
    judged = detector.ledger.accel_samples
    detector.feed(b.accel.between(5.0, 5.0 + lag))
    assert (detector.ledger.accel_samples == judged) == waits
    detector.feed(b.gyro.between(5.0, 20.0), b.accel.between(5.0 + lag, 20.0))
    assert (detector.ledger.gyro_late == 0) == waits


def test_the_wait_ends_after_max_lag_and_not_before(bench):
    """Cells of half a second, whole when a later sample has come: 5 s are 10 cells behind."""
    b = bench(3).still(20.0)
    detector = StationaryDetector(DetectorSettings(max_lag_s=5.0))
    detector.feed(b.gyro.between(0.0, 5.0), b.accel.between(0.0, 5.0))
    waiting = []
    for end in np.arange(5.1, 13.0, 0.1):
        detector.feed(b.accel.between(end - 0.1, end))
        waiting.append((round(end, 1), detector.ledger.accel_samples))
    first = next(end for end, n in waiting if n > waiting[0][1])
    assert 9.5 < first - 0.5 <= 10.1


def test_the_gyroscope_alone_gives_nothing_and_is_kept_for_the_accelerometer(bench):
    b = bench(4).still(10.0)
    detector = StationaryDetector()
    assert detector.feed(b.gyro) == []
    assert detector.ledger.gyro_samples == 0
    (rest,) = detector.feed(b.accel) + detector.finish()
    assert rest.rate is not None


def test_floors_are_renewed_after_eight_cells_and_then_twice_as_rarely(bench):
    """Epochs of 8, 16, ... 512 cells of half a second, each ending at a multiple of its length."""
    b = bench(5, accel_rate=20, gyro_rate=20).still(900.0)
    detector, seen = StationaryDetector(), []
    for start in range(0, len(b.accel), 40):
        detector.feed(b.gyro[start : start + 40], b.accel[start : start + 40])
        state = detector.state
        if not seen or seen[-1] != (state.epoch_end, state.epoch_cells):
            seen.append((state.epoch_end, state.epoch_cells))
    reached = [pair for pair in seen if math.isfinite(pair[0])]
    assert reached == [
        (8, 8),
        (16, 16),
        (32, 32),
        (64, 64),
        (128, 128),
        (256, 256),
        (512, 512),
        (1024, 512),
        (1536, 512),
        (2048, 512),
    ]


def test_a_floor_is_used_from_the_epoch_after_the_one_that_taught_it(bench):
    """Eight windows of half a second make a level: the first epoch holds them, the second uses them."""
    b = bench(6).still(20.0)
    detector = StationaryDetector()
    detector.feed(b.gyro.between(0.0, 4.4), b.accel.between(0.0, 4.4))
    assert detector.noise_floor(50.0) == (math.inf, math.inf)
    detector.feed(b.gyro.between(4.4, 5.1), b.accel.between(4.4, 5.1))
    assert detector.noise_floor(50.0)[0] == pytest.approx(0.02, rel=0.15)
    assert detector.noise_floor(50.0)[1] == pytest.approx(0.002, rel=0.15)


def test_the_ledger_counts_every_window_and_sample_once(bench):
    b = bench(7).still(10.0)
    detector = StationaryDetector()
    detector.feed(b.accel, b.gyro.between(0.0, 5.0))
    detector.finish()
    ledger = detector.ledger
    assert (ledger.accel_samples, ledger.gyro_samples, ledger.accel_unasked) == (500, 250, 0)
    assert (ledger.accel_on_s, ledger.gyro_on_s) == (10.0, 5.0)
    assert ledger.windows == {Label.STILL: 20}
    ledger.windows.clear()
    assert detector.ledger.windows == {Label.STILL: 20}  # it was a copy


def test_a_window_with_one_gyroscope_sample_has_none(bench):
    b = bench(8).still(10.0)
    one_a_window = b.gyro[::25]
    detector = StationaryDetector()
    (rest,) = detector.feed(b.accel, one_a_window) + detector.finish()
    assert rest.rate is None


def test_a_coarse_gyroscope_does_not_excuse_a_stuck_accelerometer(bench):
    b = bench(9, gyro_noise=2e-4).still(60.0)
    lsb = 1e-3
    gyro = Samples.checked(Sensor.GYROSCOPE, b.gyro.t, np.round(b.gyro.xyz / lsb) * lsb + 0.0)
    xyz = b.accel.xyz.copy()
    xyz[1500:] = xyz[1500]
    detector = StationaryDetector()
    rests = detector.feed(Samples.checked(Sensor.ACCELEROMETER, b.accel.t, xyz), gyro) + detector.finish()
    assert max(r.t_end for r in rests) <= 30.5
    assert detector.ledger.windows[Label.FROZEN] >= 58


def test_probes_are_drawn_within_their_bounds_from_any_time_on():
    detector = StationaryDetector(DetectorSettings(mode=Mode.PROBE, probe_min_s=30.0, probe_max_s=60.0))
    first = detector.next_probe(1000.0)
    assert 1000.0 <= first <= 1060.5
    assert StationaryDetector().next_probe(1000.0) == 1000.0
    assert StationaryDetector().wants(1000.0) == Sense(math.inf)


def test_setting_the_mode_that_is_set_closes_no_rest(bench):
    b = bench(10).still(20.0)
    detector = StationaryDetector()
    detector.feed(b.accel[:500], b.gyro[:500])
    assert detector.set_mode(Mode.SCAN) == []
    assert detector.mode is Mode.SCAN
    (rest,) = detector.feed(b.accel[500:], b.gyro[500:]) + detector.finish()
    assert rest.duration == pytest.approx(20.0, abs=0.1)
    assert detector.set_mode(Mode.PROBE) == []
    assert detector.mode is Mode.PROBE
