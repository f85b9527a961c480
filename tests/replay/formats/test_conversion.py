"""A recording is the same in every format it can be converted to."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.cli.main import cli
from stillcal.daemon.store.store import Store
from stillcal.replay.commands.convert import convert_command
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording, open_trace, read_all
from stillcal.replay.formats.writer import TraceWriter
from tests.support.log_files import rows


def recording(*, shared: bool = True) -> Recording:
    data = rows(500)
    warm = np.round(25 + 0.2 * np.floor(data[:, 0]), 6)
    force = Samples(Sensor.ACCELEROMETER, data[:, 0], data[:, 1:4], warm, None)
    late = 0.0 if shared else 0.002
    rate = Samples(Sensor.GYROSCOPE, data[:, 0] + late, data[:, 4:], warm, None)
    return Recording(force, rate, [], Claims(nominal_rate_hz=100.0), [], "r")


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("ending", [".csv", ".csv.gz", ".parquet", ".mcap"])
def test_it_is_read_back_the_same(tmp_path: Path, ending: str, shared: bool) -> None:
    recording(shared=shared).save(tmp_path / "r.csv")
    out = tmp_path / f"new{ending}"
    result = CliRunner().invoke(convert_command, [str(tmp_path / "r.csv"), "--out", str(out)])
    assert result.exit_code == 0, result.output
    first, again = read_all(tmp_path / "r.csv"), read_all(out)
    for old, new in ((first.accelerometer, again.accelerometer), (first.gyroscope, again.gyroscope)):
        assert old is not None and new is not None
        np.testing.assert_array_equal(new.xyz, old.xyz)
        np.testing.assert_allclose(new.t, old.t, rtol=0, atol=1e-9 if ending == ".mcap" else 0)
    assert again.accelerometer.temperature is not None and first.accelerometer.temperature is not None
    np.testing.assert_array_equal(again.accelerometer.temperature, first.accelerometer.temperature)
    assert again.claims == first.claims
    assert not list(tmp_path.glob(".*"))


def test_parquet_is_read_without_pandas(tmp_path: Path) -> None:
    """Arrow imports it where one lets it, which takes longer than reading a short recording."""
    pytest.importorskip("pandas")
    recording(shared=False).save(tmp_path / "r.parquet")
    code = "import sys, stillcal; stillcal.load(sys.argv[1]); print('pandas' in sys.modules)"
    command = [sys.executable, "-c", code, str(tmp_path / "r.parquet")]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "False\n"


def test_simulated_and_corrected_recordings_may_be_parquet(tmp_path: Path, make_record: Any) -> None:
    """They hold the same numbers as CSV."""
    Store(tmp_path / "store.json").publish(make_record(1))
    for ending in (".csv", ".parquet"):
        made, corrected = str(tmp_path / f"lab{ending}"), str(tmp_path / f"true{ending}")
        apply = ["apply", made, "--store", str(tmp_path / "store.json"), "--out", corrected]
        for words in (["simulate", "lab", "--out", made], apply):
            assert CliRunner().invoke(cli, [*words, "--quiet"]).exit_code == 0
    for name in ("lab", "true"):
        text, parquet = (read_all(tmp_path / f"{name}{ending}") for ending in (".csv", ".parquet"))
        np.testing.assert_array_equal(parquet.accelerometer.t, text.accelerometer.t)
        np.testing.assert_array_equal(parquet.accelerometer.xyz, text.accelerometer.xyz)
        assert parquet.claims == text.claims and parquet.events == text.events
    text.save(tmp_path / "saved.parquet")
    np.testing.assert_array_equal(
        read_all(tmp_path / "saved.parquet").accelerometer.xyz, text.accelerometer.xyz
    )


def test_an_mcap_file_is_what_ros_2_reads(tmp_path: Path) -> None:
    """The messages are decoded by another library than the one that wrote them."""
    recording().save(tmp_path / "r.csv")
    CliRunner().invoke(convert_command, [str(tmp_path / "r.csv"), "--out", str(tmp_path / "r.mcap")])
    store = get_typestore(Stores.ROS2_HUMBLE)
    with (tmp_path / "r.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        messages = list(reader.iter_messages(topics=["/imu"]))
        warm = list(reader.iter_messages(topics=["/imu/temperature"]))
    kinds = {schema.name for schema, _, _ in messages if schema is not None}
    decoded = [store.deserialize_cdr(m.data, "sensor_msgs/msg/Imu") for _, _, m in messages]
    assert kinds == {"sensor_msgs/msg/Imu"} and len(decoded) == 500
    seventh, expected = decoded[7], recording()
    assert seventh.header.frame_id == "imu" and seventh.orientation_covariance[0] == -1
    np.testing.assert_allclose(seventh.header.stamp.sec + seventh.header.stamp.nanosec * 1e-9, 0.07)
    read = read_all(tmp_path / "r.csv")
    vector = seventh.linear_acceleration
    np.testing.assert_array_equal([vector.x, vector.y, vector.z], read.accelerometer.xyz[7])
    temperatures = [store.deserialize_cdr(m.data, "sensor_msgs/msg/Temperature") for _, _, m in warm]
    assert [round(m.temperature, 6) for m in temperatures] == [25.0, 25.2, 25.4, 25.6, 25.8]
    assert expected.claims == read.claims


def test_a_part_of_a_recording_and_one_beside_it(tmp_path: Path) -> None:
    with TraceWriter(tmp_path / "r.csv", claims=Claims(device="phone")) as writer:
        whole = recording()
        writer.write(whole.accelerometer, whole.gyroscope)
    command = [str(tmp_path / "r.csv"), "--out", str(tmp_path / "r.parquet")]
    assert CliRunner().invoke(convert_command, command).exit_code == 0
    assert open_trace(tmp_path / "r.parquet").claims.device == "phone"
    collides = CliRunner().invoke(convert_command, [*command, "--from", "1"])
    assert collides.exit_code == 2 and "r.json is read by this command" in collides.output
    part = [str(tmp_path / "r.csv"), "--out", str(tmp_path / "p.csv"), "--from", "1", "--to", "2"]
    assert CliRunner().invoke(convert_command, part).exit_code == 0
    assert len(read_all(tmp_path / "p.csv").accelerometer) == 101


def test_another_ending_and_a_bad_recording_leave_nothing(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("t,ax,ay,az\n0,0,0,9.8\n0.01,0,0,x\n")
    before = set(tmp_path.iterdir())
    for out, said in (
        ("r.xlsx", "ends in .csv"),
        ("new.parquet", "not a number"),
        ("new.mcap", "not a number"),
    ):
        result = CliRunner().invoke(convert_command, [str(tmp_path / "r.csv"), "--out", str(tmp_path / out)])
        assert result.exit_code != 0 and said in f"{result.output} {result.exception}"
    assert set(tmp_path.iterdir()) == before
