"""The stationary detector on real recordings, all with the default settings; `-s` prints the figures."""

from __future__ import annotations

import csv
import gzip

import numpy as np
import pytest
from scipy.io import loadmat

from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import group_attitudes
from stillcal.calib_core.static.settings import Label
from stillcal.calib_core.streams.samples import Samples, Sensor


def detect(*blocks):
    detector = StationaryDetector()
    return detector.feed(*blocks) + detector.finish(), detector


def imu_tk(data_dir):
    accel = np.loadtxt(data_dir / "imu_tk" / "xsens_acc.mat.gz")
    gyro = np.loadtxt(data_dir / "imu_tk" / "xsens_gyro.mat.gz")
    return (
        Samples.checked(Sensor.ACCELEROMETER, accel[:, 0], (accel[:, 1:] - 32768) / 411),
        Samples.checked(Sensor.GYROSCOPE, gyro[:, 0], (gyro[:, 1:] - 32768) / 6258),
    )


def test_imu_tk_gives_at_least_35_rests_in_12_attitudes(data_dir):
    rests, detector = detect(*imu_tk(data_dir))
    attitudes = group_attitudes(rests, 0.1)
    print(f"\nimu_tk: {len(rests)} rests in {len(attitudes)} attitudes; {detector.ledger.windows}")
    assert len(rests) >= 35
    assert len(attitudes) >= 12
    assert all(detector.still_valid(r) for r in rests)


@pytest.mark.parametrize("name", ["imu0", "imu1", "imu2"])
def test_mikoff_gives_many_attitudes(data_dir, name):
    xyz = np.loadtxt(data_dir / "mikoff" / f"{name}.log")
    t = np.arange(len(xyz)) / 100.0
    rests, _ = detect(
        Samples.checked(Sensor.ACCELEROMETER, t, xyz[:, :3]), Samples.checked(Sensor.GYROSCOPE, t, xyz[:, 3:])
    )
    attitudes = group_attitudes(rests, 0.1)
    print(f"\nmikoff {name}: {len(rests)} rests in {len(attitudes)} attitudes")
    assert len(attitudes) >= 12


def test_sunsided_ten_minutes_still(data_dir):
    with gzip.open(data_dir / "sunsided" / "still_10min.csv.gz", "rt") as file:
        names = ["host_time_s", "ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps", "temperature_c"]
        table = np.array([[float(row[n]) for n in names] for row in csv.DictReader(file)])
    table = table[np.argsort(table[:, 0], kind="stable")]
    rests, _ = detect(
        Samples.checked(Sensor.ACCELEROMETER, table[:, 0], table[:, 1:4] * 9.80665, table[:, 7]),
        Samples.checked(Sensor.GYROSCOPE, table[:, 0], np.radians(table[:, 4:7])),
    )
    share = sum(r.duration for r in rests) / table[-1, 0]
    print(f"\nsunsided: {share:.3f} of {table[-1, 0]:.0f} s in {len(rests)} rests")
    assert share > 0.98
    assert len(rests) == 3


@pytest.mark.parametrize("with_gyro", [True, False])
@pytest.mark.parametrize(
    "trial", ["01_undisturbed_slow_rotation_A", "14_undisturbed_slow_translation_with_breaks_B"]
)
def test_broad_against_its_movement_flag(data_dir, trial, with_gyro):
    """Optical truth: what is called a rest must be one (precision), and rests must be found (recall)."""
    mat = loadmat(data_dir / "broad" / f"{trial}.mat")
    t = np.arange(len(mat["imu_acc"])) / float(mat["sampling_rate"][0, 0])
    moving = mat["movement"].ravel() > 0
    accel = Samples.checked(Sensor.ACCELEROMETER, t, mat["imu_acc"])
    gyro = Samples.checked(Sensor.GYROSCOPE, t, mat["imu_gyr"])
    rests, _ = detect(*((accel, gyro) if with_gyro else (accel,)))
    called = np.zeros(t.size, dtype=bool)
    for rest in rests:
        called |= (t >= rest.t_start) & (t <= rest.t_end)
    precision, recall = (called & ~moving).sum() / called.sum(), (called & ~moving).sum() / (~moving).sum()
    print(f"\nBROAD {trial}, gyroscope {with_gyro}: precision {precision:.4f}, recall {recall:.4f}")
    assert precision > 0.999
    assert recall > 0.9


def test_phones_at_rest_are_found_and_stuck_ones_are_not(data_dir):
    """35 phones and watches at rest: all but the stuck recordings and one that shook are found."""
    acc = np.load(data_dir / "hhar_still" / "still_accel.npz")["acc"]
    found, stuck, total = 0, 0, 0
    for row in csv.DictReader((data_dir / "hhar_still" / "index.csv").open()):
        count = int(row["count"])
        xyz = acc[int(row["start"]) : int(row["start"]) + count].astype(float)
        t = np.arange(count) / float(row["rate_hz"])
        rests, detector = detect(Samples.checked(Sensor.ACCELEROMETER, t, xyz))
        total += 1
        if not np.ptp(xyz, axis=0).any():
            stuck += 1
            assert rests == []
            assert Label.FROZEN in detector.ledger.windows
        else:
            found += sum(r.duration for r in rests) > 0.8 * t[-1]
    print(f"\nhhar_still: {found} of {total - stuck} found at rest, {stuck} stuck and refused")
    assert stuck == 4
    assert found >= total - stuck - 2
