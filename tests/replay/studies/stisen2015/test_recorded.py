"""Activity through devices of other errors, rates and steadiness; interpolation; the modes of evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.studies.claim import Verdict
from stillcal.replay.studies.grammenos2018 import classes as classes_study
from stillcal.replay.studies.grammenos2018 import slices as slices_study
from stillcal.replay.studies.har.data import Windows
from stillcal.replay.studies.har.devices import Device
from stillcal.replay.studies.har.recordings import Still
from stillcal.replay.studies.har.scoring import radial_svm, tree
from stillcal.replay.studies.stisen2015 import families as families_scores
from stillcal.replay.studies.stisen2015 import gyroscope as gyroscope_study
from stillcal.replay.studies.stisen2015 import heterogeneity as heterogeneity_study
from stillcal.replay.studies.stisen2015.recorded import (
    METHODS,
    Kinds,
    Recorded,
    at_times,
    record,
    reference,
    resample,
)
from stillcal.replay.studies.stisen2015.remedies.treated import Carried

RNG = np.random.default_rng(0)


def a_device(rate: float = 100.0) -> Device:
    """A device with a bias, a scale, noise and every third interval long."""
    intervals = np.tile([0.8, 0.8, 1.4], 2000) / rate
    stamps = np.concatenate([[0.0], np.cumsum(intervals)])
    rest = Still("back", "d", "m", 9.8 + 0.01 * RNG.normal(size=(stamps.size, 3)), stamps, stamps)
    return Device("m d", "m", 1.02 * np.eye(3), np.array([0.1, -0.2, 0.3]), (rest,))


def waves(n: int = 4, frequency: float = 1.5) -> np.ndarray:
    t = np.arange(128) / 50.0
    return 9.8 + np.sin(2 * np.pi * frequency * t[None, :, None] + RNG.uniform(0, 6, (n, 1, 3)))


def test_splines_follow_a_slow_wave() -> None:
    times = np.tile(np.sort(RNG.uniform(0.2, 2.3, 200)), (1, 1))
    t = np.arange(128) / 50.0
    wave = np.sin(2 * np.pi * 2.0 * t)[None, :, None] * np.ones(3)
    expected = np.sin(2 * np.pi * 2.0 * times)[:, :, None]
    assert np.abs(at_times(wave, times) - expected).max() < 1e-3


def test_without_heterogeneity_a_device_is_the_reference() -> None:
    accel = waves()
    plain = record(accel, a_device(), Kinds(False, False, False), RNG)
    assert plain.samples == pytest.approx(reference(accel).samples)
    assert plain.stamps == pytest.approx(reference(accel).stamps)


def test_each_kind_changes_only_its_own() -> None:
    accel, device = waves(), a_device()
    errors = record(accel, device, Kinds(True, False, False), np.random.default_rng(1))
    assert errors.stamps == pytest.approx(reference(accel).stamps)
    off = errors.samples - device.distort(reference(accel).samples)
    assert off.std() == pytest.approx(0.01, rel=0.1)
    rate = record(accel, device, Kinds(False, True, False), RNG)
    assert rate.samples.shape[1] == 200
    assert np.diff(rate.stamps, axis=1) == pytest.approx(0.01, rel=1e-3)
    uneven = record(accel, device, Kinds(False, False, True), RNG)
    assert uneven.samples.shape[1] == 100
    assert np.diff(uneven.stamps, axis=1).max() == pytest.approx(1.4 * 0.02, rel=1e-2)


@pytest.mark.parametrize("method", METHODS)
def test_interpolation_finds_a_slow_wave_between_uneven_samples(method: str) -> None:
    accel = waves(frequency=0.5)
    uneven = record(accel, a_device(), Kinds(False, True, True), RNG)
    found = resample(uneven, 25.0, method)
    grid = 0.2 + np.arange(50) / 25.0
    expected = at_times(accel, np.tile(grid, (len(accel), 1)))
    # nearest is off by half an interval at most; a smoothed spline may miss by sqrt(0.2) rms
    room = {"nearest": np.pi * 0.014 / 2, "linear": 2e-3, "cubic": 1e-4, "smoothed": 3 * np.sqrt(0.2)}[method]
    assert found.shape == (4, 50, 3)
    assert np.abs(found - expected)[:, :-3].max() < room + 1e-3


def test_equal_stamps_do_not_break_splines() -> None:
    t = np.linspace(0.2, 2.2, 100)
    t[50] = t[49]
    recorded = Recorded(RNG.normal(size=(1, 100, 3)), t[None])
    for method in METHODS:
        assert np.isfinite(resample(recorded, 25.0, method)).all()


def test_displacement_of_a_shift_is_the_shift_in_spreads() -> None:
    """Normal features of spread 2, two moved by 3: 1.5 spreads; one that never changes is left out."""
    clean = np.c_[RNG.normal(scale=2.0, size=(4000, 2)), np.ones(4000)]
    moved = clean + np.array([3.0, -3.0, 9.0])
    assert families_scores.displacement(clean, clean) == 0.0
    # a sample's spread is uncertain by 1 / sqrt(2 n)
    assert families_scores.displacement(clean, moved) == pytest.approx(1.5, rel=4 / np.sqrt(8000))


def test_calibration_and_interpolation_undo_a_device() -> None:
    """Carried by a device of known errors, samples come back to within its noise and the interpolation."""
    device = a_device()
    accel = waves(frequency=0.5)
    recorded = record(accel, device, Kinds(), np.random.default_rng(2))
    carried = Carried(Windows(accel, np.zeros(4, int), np.arange(4)), [device], [0], [recorded], 0)
    clean = at_times(accel, np.tile(0.2 + np.arange(50) / 25.0, (4, 1)))
    off = {
        way: carried.handled(way, 25.0, 0)[:, :-3] - clean[:, :-3]
        for way in ("linear", "calibrated and linear")
    }
    assert np.sqrt(np.square(off["linear"]).mean()) > 0.2  # 2 % of 9.8 and the bias
    assert np.sqrt(np.square(off["calibrated and linear"]).mean()) < 0.05  # its noise is 0.01


def test_sensors_are_told_apart_by_what_they_see() -> None:
    """Only the forces hold the activity: the gyroscope guesses, and McNemar's test says so."""
    n = 180
    label, person = np.arange(n) % 2, np.arange(n) // 6
    blind = RNG.normal(size=(n, 100, 3))
    forces = blind + 4.0 * label[:, None, None]
    found = gyroscope_study.scores(forces, blind[::-1], label, person, 0, number=2)
    assert found.by_fold[0].mean() > 95.0
    assert found.by_fold[1].mean() < 65.0


def test_comparison_of_ways_sees_what_is_there() -> None:
    """Slices that only the second way tells apart: its gain is the whole difference."""
    n = 600
    label, person = RNG.integers(0, 2, n), np.arange(n) % 10
    blind = RNG.normal(size=(n, 40, 3))
    seeing = blind + 5.0 * label[:, None, None]
    ways = {"raw": blind, "calibrated": seeing, "Kalman": blind, "no errors": seeing}
    ways |= {slices_study.METHOD: seeing, "filtered": blind}
    data = slices_study.Slices(ways, label, person, RNG.integers(0, 5, n))
    found = slices_study.compare(data, radial_svm, slices_study.tilt, 0, False)
    assert found.values[:, 1].mean() > 0.95
    assert abs(found.values[:, 0].mean() - 0.5) < 0.1
    assert found.gain("Kalman") == pytest.approx(0.0)


@pytest.mark.parametrize("other_device", [False, True])
def test_nobody_is_known_to_a_classifier_that_is_tested_on_them(other_device: bool) -> None:
    """Slices that tell nothing but who it is: of somebody new that says nothing."""
    n = 600
    person = RNG.permutation(np.arange(n) % 20)
    label = RNG.permutation(np.arange(20) % 2)[person]
    who = np.zeros((n, 40, 3))
    who[np.arange(n), person, 0] = 1.0
    data = slices_study.Slices({"raw": who}, label, person, RNG.integers(0, 5, n))
    found = slices_study.compare(data, tree, slices_study.flat, 0, other_device, ways=("raw",))
    assert found.known[0] > 0.95
    assert found.values.mean() < 0.75


def test_tilt_is_the_angle_of_the_mean() -> None:
    slices = np.tile([0.0, 9.8 * np.sin(0.3), 9.8 * np.cos(0.3)], (2, 40, 1))
    angle_y, angle_z, norm = slices_study.tilt(slices)[0]
    assert (angle_y, angle_z, norm) == pytest.approx((0.3, np.pi / 2 - 0.3, 9.8))


def test_without_recordings_nothing_is_judged(tmp_path: Path) -> None:
    for module in (heterogeneity_study, classes_study, gyroscope_study):
        study = module.study(None, tmp_path, 0, lambda share: None)
        assert {c.verdict for c in study.claims} == {Verdict.UNTESTED}
