"""The formats on real recordings (public, see docs/formats.md for their sources)."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.checks.units import UnitCheck
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import Recording, read_all

FORMATS = files("stillcal.config") / "formats"
SUNSIDED = (FORMATS / "mpu6050.toml").read_text()
ROCKET = (FORMATS / "airbrakes.toml").read_text()


def resting_norm(recording: Recording) -> float:
    """Return the median norm of the force, m/s^2: most of each recording is rest or calm motion."""
    return float(np.median(np.linalg.norm(recording.accelerometer.xyz, axis=1)))


@pytest.mark.parametrize(
    ("file", "format", "rows", "rate"),
    [
        ("imu_tk/xsens_acc.mat.gz", "imu_tk", 51175, 100),
        ("mikoff/imu0.log", "mikoff", 15969, 100),
        ("mikoff/imu1.log", "mikoff", 15931, 100),
        ("mikoff/imu2.log", "mikoff", 15934, 100),
        ("imucal/example_ferraris_session.csv", "imucal", 10376, 102.4),
        ("hhar/Phones_accelerometer.csv.gz", "hhar", 10000, 200),
        ("hhar/Watch_accelerometer.csv.gz", "hhar", 10000, 100),
    ],
)
def test_known_formats(data_dir: Path, file: str, format: str, rows: int, rate: float) -> None:
    recording = read_all(data_dir / file, format)
    assert recording.gyroscope is not None
    assert len(recording.accelerometer) == len(recording.gyroscope) == rows
    assert 1 / np.median(np.diff(recording.accelerometer.t)) == pytest.approx(rate, rel=0.02)
    assert resting_norm(recording) == pytest.approx(9.8, rel=0.1)
    assert np.median(np.abs(recording.gyroscope.xyz)) < 0.5


@pytest.mark.parametrize(
    ("file", "text", "rows"),
    [
        ("sunsided/still_10min.csv.gz", SUNSIDED, 65022),
        ("sunsided/full_sphere.csv.gz", SUNSIDED, 10516),
        ("rocket/jackpot_launch_1.csv.gz", ROCKET, 6616),
    ],
)
def test_a_map_written_by_a_user(data_dir: Path, tmp_path: Path, file: str, text: str, rows: int) -> None:
    format = tmp_path / "own.toml"
    format.write_text(text)
    recording = read_all(data_dir / file, format)
    assert len(recording.accelerometer) == rows
    assert resting_norm(recording) == pytest.approx(9.8, rel=0.1)
    temperature = recording.accelerometer.temperature
    assert temperature is not None and 10 < temperature.min() < temperature.max() < 50
    format.write_text(text.replace('unit = "g"', 'unit = "m/s^2"'))
    with pytest.raises(TraceError, match="it seems to be g"):
        read_all(data_dir / file, format)


@pytest.mark.parametrize("file", ["sunsided/still_10min.csv.gz", "sunsided/full_sphere.csv.gz"])
def test_degrees_taken_for_radians_are_recognised(data_dir: Path, tmp_path: Path, file: str) -> None:
    format = tmp_path / "own.toml"
    format.write_text(SUNSIDED.replace("deg/s", "rad/s"))
    with pytest.raises(TraceError, match="the rates are not rad/s"):
        read_all(data_dir / file, format)


def test_hhar_stamps_are_put_in_order_and_a_sleeping_clock_is_noted(data_dir: Path) -> None:
    phone = read_all(data_dir / "hhar/Phones_accelerometer.csv.gz", "hhar")
    assert (np.diff(phone.accelerometer.t) > 0).all()
    assert any("287 rows were out of time order" in note for note in phone.notes)
    watch = read_all(data_dir / "hhar/Watch_accelerometer.csv.gz", "hhar")
    assert any("advanced 135.595 s while arrival times advanced 538.567 s" in note for note in watch.notes)


def judged(force: np.ndarray, rate: np.ndarray) -> bool:
    """Whether windows (n, 128, 3) at 50 Hz, in m/s^2 and rad/s, are refused for their units."""
    check = UnitCheck(Path("windows"))
    try:
        for i in range(len(force)):
            t = 10.0 * i + np.arange(128) / 50
            check.see(Samples(Sensor.ACCELEROMETER, t, force[i]), Samples(Sensor.GYROSCOPE, t, rate[i]))
        check.finish()
    except TraceError:
        return True
    return False


def test_thirty_people_with_a_phone_raise_no_alarm_and_degrees_show_at_rest(data_dir: Path) -> None:
    """UCI HAR (Anguita et al. 2013): walking, stairs, sitting, standing, lying, phone at the waist."""
    windows = np.load(data_dir / "ucihar/ucihar_subset.npz")
    force = windows["train_total_acc"] * 9.80665
    rate = windows["train_body_gyro"].astype(np.float64)
    kinds = windows["train_y"].astype(int) * 100 + windows["train_subject"]
    chosen = [np.flatnonzero(kinds == kind) for kind in np.unique(kinds)]
    assert len(chosen) > 100
    assert sum(judged(force[w], rate[w]) for w in chosen) == 0
    assert all(judged(force[w], np.rad2deg(rate[w])) for w in chosen if kinds[w[0]] >= 400)
    assert all(judged(force[w] / 9.80665, rate[w]) for w in chosen)
