"""The unaided calibration's studies, small: what is theory tightly, what is drawn with its error."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.gravity import STANDARD, at
from stillcal.calib_core.model import SensorModel
from stillcal.replay.phone import load_phone, load_scenario, population
from stillcal.replay.studies.claim import Verdict
from stillcal.replay.studies.grammenos2018 import gravity as unaided_gravity
from stillcal.replay.studies.grammenos2018 import homogeneity as unaided_homogeneity
from stillcal.replay.studies.grammenos2018 import newphone as unaided_newphone
from stillcal.replay.studies.grammenos2018 import people as unaided_people
from stillcal.replay.studies.grammenos2018 import power as unaided_power
from stillcal.replay.studies.grammenos2018 import smoothing as unaided_smoothing
from stillcal.replay.studies.grammenos2018.homogeneity import aggregate_error, at_rest, similarity, smoothed
from stillcal.replay.studies.grammenos2018.kalman import Kalman, inverse, settled, steady_gain
from stillcal.replay.studies.grammenos2018.smoothing import filtered, middle
from stillcal.replay.studies.har.devices import Device, read_devices
from stillcal.replay.studies.har.recordings import read_still


def test_median_against_mean_on_white_noise() -> None:
    """Variances of the median of n normal samples: 0.1383 and 0.0734 for n = 10, 20 (order statistics)."""
    noise = np.random.default_rng(0).normal(size=(60_000, 3))
    for n, of_median in ((10, 0.1383), (20, 0.0734)):
        median, mean = filtered(noise, n)
        room = 4 * np.sqrt(2 * n / noise.size)  # n neighbouring outputs share their samples
        assert mean * n == pytest.approx(1.0, rel=room)
        assert median == pytest.approx(of_median, rel=room)


def test_similarity_is_zero_with_itself_and_counts_axes_and_norm() -> None:
    trace = np.random.default_rng(1).normal(size=(50, 3)) + np.array([0.0, 0.0, 9.8])
    assert similarity(trace, trace) == 0.0
    up = np.tile([0.0, 0.0, 9.0], (50, 1))
    assert similarity(up, up + np.array([0.0, 0.0, 3.0])) == pytest.approx(3.0 + 9.0)


def test_aggregate_error_of_two_is_a_quarter_of_their_difference_squared() -> None:
    traces = np.stack([np.zeros((10, 3)), np.full((10, 3), 2.0)])
    assert aggregate_error(traces) == pytest.approx([1.0, 1.0])


def test_smoothing_keeps_a_constant_and_halves_nothing_else() -> None:
    traces = np.full((2, 20, 3), 4.0)
    assert smoothed(traces) == pytest.approx(4.0)
    assert smoothed(traces).shape == (2, 16, 3)


def test_a_fit_takes_up_the_error_of_gravity() -> None:
    """E scales as g^4 where only g differs; by the other g it is the difference of squares, squared."""
    found = unaided_gravity.costs(6, 0, lambda share: None)
    factor = (STANDARD / unaided_gravity.LOCAL) ** 4
    assert found.fitted[:, 0] / found.fitted[:, 1] == pytest.approx(factor, rel=2e-3)
    floor = (unaided_gravity.LOCAL**2 - STANDARD**2) ** 2
    assert np.median(found.judged[:, 0]) == pytest.approx(floor, rel=0.1)


def test_latitude_of_a_gravity() -> None:
    assert np.isnan(unaided_gravity._latitude_of(9.9))
    assert unaided_gravity._latitude_of(at(45.0, 0.0).value) == pytest.approx(45.0, abs=0.01)


def test_correction_takes_nine_additions_and_nine_multiplications() -> None:
    done = unaided_power.counts()
    assert done["apply"] == {"additions": 9, "multiplications": 9}
    assert done["gain fixed"] == {"additions": 6, "multiplications": 3}
    assert sum(done["Kalman"].values()) > 10 * sum(done["apply"].values())


def test_kalman_settles_at_its_steady_gain() -> None:
    values = np.random.default_rng(2).normal(size=(1, 400, 3))
    kalman = Kalman(values[0, 0], 0.01, 0.1)
    for z in values[0, 1:]:
        kalman.update(z)
    gain = steady_gain(0.01, 0.1)
    assert kalman.P[0, 0] == pytest.approx(gain * 0.1, rel=1e-9)
    assert settled(values, 0.01, 0.1)[0, -1] == pytest.approx(kalman.x, abs=1e-9)


def test_inverse_is_an_inverse() -> None:
    m = np.random.default_rng(3).normal(size=(3, 3))
    assert inverse(m) @ m == pytest.approx(np.eye(3), abs=1e-12)


def test_half_an_hour_of_one_person() -> None:
    day = msgspec.structs.replace(load_scenario("tables"), duration_s=1800.0)
    life = unaided_people.live(unaided_people.slowed(load_phone("typical"), 10.0), day, 3)
    assert 0 < life.attitudes <= life.rests
    assert 0.9 < life.sensing <= 1.001  # a new phone is watched without a break


def test_three_rests_are_never_enough() -> None:
    fewest = [unaided_people.fewest_rests(p, k) for k, p in enumerate(population(5, 0))]
    assert min(fewest) >= 6  # as many parameters


def test_real_devices(data_dir: Path) -> None:
    """Calibrated devices' norms are within a tenth of what they were, in any attitude."""
    devices = read_devices(data_dir)
    assert len(devices) == 15
    up = np.random.default_rng(4).normal(size=(200, 3))
    up *= STANDARD / np.linalg.norm(up, axis=1, keepdims=True)
    for k, device in enumerate(devices[:4]):
        raw = device.distort(up)
        off = [
            np.abs(np.linalg.norm(v, axis=1) - STANDARD).mean()
            for v in (raw, device.calibrated(k).apply(raw))
        ]
        assert off[1] < 0.1 * off[0]


def test_tilt_and_norm_of_a_known_error() -> None:
    """A bias of b across gravity g tilts by b / g; over all attitudes by pi / 4 of that, to first order."""
    device = Device("m d", "m", np.eye(3), np.array([0.0, 0.0, 0.1]), ())
    exact = SensorModel.of(np.eye(3), device.bias)
    errors = unaided_newphone.attitude_errors([device], [exact], 0)
    spread = np.sqrt(2 / 3 - (np.pi / 4) ** 2) / (np.pi / 4) / np.sqrt(unaided_newphone.DIRECTIONS)
    assert errors.tilt[0, 0] == pytest.approx(np.degrees(np.pi / 4 * 0.1 / STANDARD), rel=4 * spread + 0.01)
    assert errors.tilt[0, 1] < 1e-5
    assert errors.norm[0] == pytest.approx([0.05, 0.0], abs=4 * 0.1 / np.sqrt(12 * 500))


def test_drawn_life_and_its_charger() -> None:
    day = msgspec.structs.replace(load_scenario("day"), duration_s=9000.0)
    life = unaided_people.drawn_life(load_phone("typical"), day, 1)
    assert life.rests >= life.attitudes >= 1
    assert life.calibrated_at == np.inf or life.iterations > 0


def test_a_face_held_out_comes_nearer_to_gravity(data_dir: Path) -> None:
    rest = at_rest(data_dir)
    before, after = np.sqrt(np.mean(np.square(rest.norms), axis=0))
    assert after < 0.5 * before
    assert rest.mse("after") < rest.mse("before")


def test_the_middle_of_a_recording_is_twenty_seconds(data_dir: Path) -> None:
    rest = next(r for r in read_still(data_dir) if r.model == "LG-Nexus4")
    assert len(middle(rest)) / 198.5 == pytest.approx(20.0, rel=0.02)


def test_without_recordings_nothing_is_judged(tmp_path: Path) -> None:
    for module in (unaided_homogeneity, unaided_smoothing, unaided_newphone):
        study = module.study(None, tmp_path, 0, lambda share: None)
        assert {c.verdict for c in study.claims} == {Verdict.UNTESTED}
