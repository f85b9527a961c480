"""Real recordings open without --format, each as what its maker wrote."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import open_trace, read_all

OPENED = {
    "axivity/ax3_testfile.cwa": ("Axivity CWA", 98.86),
    "axivity/ax6_testfile.cwa": ("Axivity CWA", 99.03),
    "broad/01_undisturbed_slow_rotation_A.mat": ("MATLAB", 285.7),
    "broad/14_undisturbed_slow_translation_with_breaks_B.mat": ("MATLAB", 285.7),
    "carbonix/flight_three_imus.npz": ("NPZ", 333.3),
    "hhar/Phones_accelerometer.csv.gz": ("hhar", 198.6),
    "hhar/Watch_accelerometer.csv.gz": ("hhar", 100.4),
    "imu_tk/xsens_acc.mat.gz": ("imu_tk", 100.0),
    "imucal/example_ferraris_session.csv": ("imucal", 102.4),
    "mikoff/imu0.log": ("mikoff", 100.0),
    "mikoff/imu1.log": ("mikoff", 100.0),
    "mikoff/imu2.log": ("mikoff", 100.0),
    "px4/sample.ulg": ("PX4 ULog", 250.0),
    "px4/sample_log_small.ulg": ("PX4 ULog", 204.6),
    "rocket/jackpot_launch_1.csv.gz": ("airbrakes", 89.77),
    "sunsided/full_sphere.csv.gz": ("mpu6050", 478.7),
    "sunsided/still_10min.csv.gz": ("mpu6050", 491.4),
}
REFUSED = {
    "axivity/ax3_testfile_corrupt_blocks_0_13_14_142_143_144.cwa": "",  # opened, see below
    "hhar/Phones_gyroscope.csv.gz": "gyroscope's file of a pair",
    "hhar/Watch_gyroscope.csv.gz": "gyroscope's file of a pair",
    "imu_tk/xsens_gyro.mat.gz": "gyroscope's file of a pair",
    "hhar_still/index.csv": "no accelerometer found by its names",
    "hhar_still/still_accel.npz": "no column of time stamps",  # 200 recordings, one after another
    "ucihar/ucihar_subset.npz": "windows",
}


def test_no_recording_is_left_out(data_dir: Path) -> None:
    there = {
        str(path.relative_to(data_dir))
        for path in data_dir.rglob("*")
        if path.is_file() and not path.name.startswith(("LICENSE", "README"))
    }
    assert there <= OPENED.keys() | REFUSED.keys()


@pytest.mark.parametrize("name", OPENED)
def test_a_recording_opens_by_its_content(data_dir: Path, name: str) -> None:
    kind, rate = OPENED[name]
    assert open_trace(data_dir / name).kind == kind
    recording = read_all(data_dir / name)
    assert recording.rate_hz == pytest.approx(rate, rel=1e-3)
    assert (recording.gyroscope is None) == (name == "axivity/ax3_testfile.cwa")


@pytest.mark.parametrize("name", [name for name, said in REFUSED.items() if said])
def test_what_is_no_recording_says_what_it_is(data_dir: Path, name: str) -> None:
    with pytest.raises(TraceError, match=REFUSED[name]):
        read_all(data_dir / name)


def test_damaged_blocks_of_an_axivity_file_are_named_and_the_rest_is_the_same(data_dir: Path) -> None:
    whole = read_all(data_dir / "axivity/ax3_testfile.cwa").accelerometer
    damaged = read_all(data_dir / "axivity/ax3_testfile_corrupt_blocks_0_13_14_142_143_144.cwa")
    assert any("left out (wrong check sum or layout): 0 13 14 142 143 144" in n for n in damaged.notes)
    kept = np.setdiff1d(np.arange(145), [0, 13, 14, 142, 143, 144])
    samples = (kept[:, None] * 120 + np.arange(120)).ravel()
    np.testing.assert_array_equal(damaged.accelerometer.xyz, whole.xyz[samples])
    np.testing.assert_allclose(damaged.accelerometer.t, whole.t[samples], atol=0.01)


def test_an_axivity_file_whose_sensors_are_exchanged_at_first_says_so(data_dir: Path) -> None:
    recording = read_all(data_dir / "axivity/ax6_testfile.cwa")
    assert any("exchanged in 32 blocks, between 0 and 31" in note for note in recording.notes)
    assert len(recording.accelerometer) == (283 - 32) * 40


def test_what_the_autopilot_has_corrected_is_said(data_dir: Path) -> None:
    px4 = read_all(data_dir / "px4/sample.ulg").notes
    assert any("PX4 has corrected these values already: accelerometer (CAL_ACC0" in note for note in px4)
    ardupilot = open_trace(data_dir / "carbonix/flight_three_imus.npz", sensor="2").notes
    assert any("ArduPilot has corrected these values already" in note for note in ardupilot)
