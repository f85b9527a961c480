"""A recording written while it lasts: both sensors merged, files of bounded length, the oldest deleted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.streams.events import Charging, Location
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.conversion.live_recording import LiveRecording, Parts
from stillcal.replay.formats.trace import read_all
from tests.support.phone_pieces import whole

A, G = Sensor.ACCELEROMETER, Sensor.GYROSCOPE


def block(samples: Samples) -> dict[str, Any]:
    return {
        "sensor": samples.sensor.value,
        "samples": np.column_stack((samples.t, samples.xyz)).tolist(),
        "temperature_c": None if samples.temperature is None else samples.temperature.tolist(),
    }


def blocks(accel: Samples, gyro: Samples | None, length: float = 2.0) -> list[dict[str, Any]]:
    """Return the streams in blocks of `length` s, the accelerometer's ahead of the gyroscope's."""
    out = []
    for start in np.arange(0.0, accel.t[-1], length):
        out.append(block(accel.between(start, start + length)))
        if gyro is not None:
            out.append(block(gyro.between(start - 1.0, start + length - 1.0)))
    out += [] if gyro is None else [block(gyro.between(start + length - 1.0, np.inf))]
    return [b for b in out if b["samples"]]


def test_both_sensors_come_back_as_they_were_sent(tmp_path: Path) -> None:
    accel, gyro = whole(130.0)
    recording = LiveRecording(Parts(tmp_path / "r.csv.gz", 3), 3600.0)
    recording.take({"claims": '{"device": "p", "nominal_rate_hz": 100.0}'})
    recording.take({"t_s": 3.0, "charging": True})
    recording.take({"t_s": 4.0, "location": [52.0, 0.1]})
    for each in blocks(accel, gyro):
        recording.take(each)
    (part,) = recording.close()
    assert part.samples == len(accel) + len(gyro) and "2.2 minutes" in part.words()
    found = read_all(part.path)
    assert found.gyroscope is not None
    for sent, came in ((accel, found.accelerometer), (gyro, found.gyroscope)):
        assert came.t.tolist() == sent.t.tolist() and came.xyz.tolist() == sent.xyz.tolist()
    assert found.accelerometer.temperature.tolist() == accel.temperature.tolist()
    assert found.events == [Charging(3.0, True), Location(4.0, 52.0, 0.1)]
    assert found.claims.device == "p"


def test_without_a_gyroscope_there_are_no_columns_of_it(tmp_path: Path) -> None:
    accel, _ = whole(70.0)
    recording = LiveRecording(Parts(tmp_path / "r.csv", 3), 3600.0)
    for each in blocks(accel, None):
        recording.take(each)
    (part,) = recording.close()
    assert part.path.read_text().splitlines()[0] == "t,ax,ay,az,temperature"
    assert len(read_all(part.path).accelerometer) == len(accel)


def test_files_are_bounded_and_the_oldest_are_deleted(tmp_path: Path) -> None:
    accel, gyro = whole(100.0)
    (tmp_path / "r.4.csv").write_text("another's")
    recording = LiveRecording(Parts(tmp_path / "r.csv", 2), 20.0)
    recording.take({"t_s": 1.0, "charging": True})
    for each in blocks(accel, gyro):
        recording.take(each)
    kept = recording.close()
    assert [part.path.name for part in kept] == ["r.5.csv", "r.6.csv"]
    assert (tmp_path / "r.4.csv").read_text() == "another's"
    assert not (tmp_path / "r.csv").exists() and not (tmp_path / "r.events.jsonl").exists()
    for part in kept:
        assert part.t_end - part.t_start < 27.0  # begins and ends with a gathered block
        (charging,) = read_all(part.path).events  # said long before, and still so
        assert isinstance(charging, Charging) and charging.on


def test_a_sensor_that_lags_beyond_patience_is_left_out_and_time_never_runs_back(tmp_path: Path) -> None:
    accel, gyro = whole(200.0)
    recording = LiveRecording(Parts(tmp_path / "r.csv", 2), 3600.0)
    recording.take(block(gyro.between(0.0, 5.0)))
    for each in blocks(accel, None):
        recording.take(each)
    recording.take(block(gyro.between(10.0, np.inf)))
    (part,) = recording.close()
    found = read_all(part.path)
    assert len(found.accelerometer) == len(accel)
    assert found.gyroscope is not None and 0 < len(found.gyroscope) < len(gyro) - 100


def test_what_is_given_up_leaves_nothing_behind(tmp_path: Path) -> None:
    recording = LiveRecording(Parts(tmp_path / "r.csv", 2), 3600.0)
    accel, gyro = whole(70.0)
    for each in blocks(accel, gyro):
        recording.take(each)
    recording.discard()
    assert list(tmp_path.iterdir()) == []
    assert LiveRecording(Parts(tmp_path / "r.csv", 2), 3600.0).close() == []
    with pytest.raises(KeyError):
        recording.take({"samples": [[0.0, 1.0, 2.0, 3.0]]})
