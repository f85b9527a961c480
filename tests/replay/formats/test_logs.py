"""Binary logs are read as their formats' own libraries, or specifications, write them."""

from __future__ import annotations

import io
import os
import re
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
from mcap.writer import Writer as McapWriter
from pyarrow import parquet
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs import extras
from stillcal.replay.formats.logs.matlab import TooLongError, read_matlab
from stillcal.replay.formats.tables.compiled import LONG_BYTES, compiled_reader
from stillcal.replay.formats.tables.table import EMPTY
from stillcal.replay.formats.trace import Recording, open_trace, read_all
from tests.support.log_files import (
    DATA,
    IMU,
    axivity,
    bag_of_texts,
    dataflash,
    dataflash_file,
    hdf5,
    imu_message,
    mat,
    mcap_file,
    npz,
    parquet_file,
    ros1_bag,
    ros2_bag,
    ros2_file,
    ulog,
    ulog_fifo,
)


def assert_same(recording: Recording, tolerance: float = 1e-12, start: float = 0.0) -> None:
    np.testing.assert_allclose(recording.accelerometer.t - start, DATA[:, 0], atol=1e-6)
    np.testing.assert_allclose(recording.accelerometer.xyz, DATA[:, 1:4], rtol=tolerance, atol=tolerance)
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.gyroscope.xyz, DATA[:, 4:], rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("packed", [False, True])
def test_matlab_files_hold_what_scipy_wrote_and_no_texts_or_cells(packed: bool) -> None:
    held = {"a": DATA[:7], "whole": np.arange(9, dtype=np.int16), "windows": np.ones((2, 3, 4), np.float32)}
    held |= {"a_name_longer_than_eight": np.array([1, 2, 3], np.uint8), "fs": 100.0, "on": True}
    others = {"text": "walk", "cells": np.array([1.0, "x"], dtype=object), "turned": 1 + 2j}
    out = io.BytesIO()
    deep = {"y": np.arange(4), "label": "left"}
    savemat(out, {**held, **others, "imu": {"x": 2.0, "deep": deep}}, do_compression=packed)
    groups = read_matlab(out.getvalue(), 1 << 20)
    assert groups.keys() == {"", "imu", "imu/deep"} and groups[""].keys() == held.keys()
    for name, values in held.items():
        np.testing.assert_array_equal(groups[""][name], values)
    assert groups["imu"]["x"] == 2.0 and groups["imu/deep"]["y"].tolist() == [0, 1, 2, 3]
    with pytest.raises(TooLongError):
        read_matlab(out.getvalue(), 1000)


def test_a_matlab_file_of_a_machine_whose_first_byte_is_the_highest() -> None:
    flags, shape, name = (6, 8, 6, 0), (5, 8, 1, 3), (1 << 16 | 1, ord("a") << 24)
    values = struct.pack(">2I3d", 9, 24, 1.5, 2.5, 3.5)
    array = struct.pack(">4I4I2I", *flags, *shape, *name) + values
    content = b"MATLAB 5.0 MAT-file".ljust(124) + b"\1\0MI" + struct.pack(">2I", 14, len(array)) + array
    assert read_matlab(content, 1000)[""]["a"].tolist() == [1.5, 2.5, 3.5]
    with pytest.raises(ValueError, match="type 8"):
        read_matlab(content.replace(struct.pack(">2I", 9, 24), struct.pack(">2I", 8, 24)), 1000)


def test_a_ros_1_bag(tmp_path: Path) -> None:
    recording = read_all(ros1_bag(tmp_path))
    assert_same(recording, start=1000)
    arrival = recording.accelerometer.t_arrival
    assert arrival is not None and abs(arrival[0] - 2000) < 1e-6


def test_of_several_topics_the_raw_one_that_was_logged_often_enough_is_first(tmp_path: Path) -> None:
    topics = {"/imu/data": 1, "/imu/data_raw": 2, "/aft/imu/data_raw": 25}
    trace = open_trace(ros1_bag(tmp_path, topics=topics))
    listed = re.findall(r"\S+(?= \([\d.]+ Hz\))", trace.notes[0])
    assert listed == ["/imu/data_raw", "/imu/data", "/aft/imu/data_raw"]
    assert "reading /imu/data_raw" in trace.notes[0]


def test_a_bag_of_compressed_messages_is_read_as_its_folder(tmp_path: Path) -> None:
    folder = ros2_bag(tmp_path, compressed=True)
    np.testing.assert_array_equal(read_all(folder).accelerometer.xyz, DATA[:, 1:4])
    with pytest.raises(TraceError, match=r"of /imu are compressed one by one; give the bag's folder"):
        open_trace(next(folder.glob("*.db3")))


def test_a_bag_without_stamps_is_read_by_the_times_of_logging(tmp_path: Path) -> None:
    recording = read_all(ros1_bag(tmp_path, stamped=False))
    assert_same(recording, start=2000)
    assert any("no stamps of its own" in note for note in recording.notes)


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_a_ros_2_bag_as_a_folder_and_as_its_file(tmp_path: Path, storage: StoragePlugin) -> None:
    folder = ros2_bag(tmp_path, storage)
    assert_same(read_all(folder), start=1000)
    (alone,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    assert_same(read_all(shutil.copy(alone, tmp_path / "renamed.log")), start=1000)


def test_topics_of_acceleration_and_of_rates_are_paired(tmp_path: Path) -> None:
    trace = open_trace(ros2_bag(tmp_path, split=True))
    assert trace.sensor == "/camera/accel/sample"
    assert_same(read_all(tmp_path / "walk"), start=1000)


def test_an_mcap_file_of_any_profile_and_one_of_other_messages(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)

    def write(name: str, encoding: str) -> Path:
        with (tmp_path / name).open("wb") as file:
            writer = McapWriter(file)
            writer.start()
            schema = writer.register_schema(IMU, "ros2msg", b"")
            channel = writer.register_channel("/imu", encoding, schema)
            for row in DATA:
                ns = round((1000 + row[0]) * 1e9)
                writer.add_message(channel, ns, store.serialize_cdr(imu_message(store, row), IMU), ns)
            writer.finish()
        return tmp_path / name

    assert_same(read_all(write("a.mcap", "cdr")), start=1000)
    with pytest.raises(TraceError, match=r"no topic of type sensor_msgs/Imu; there are: /imu .*json"):
        read_all(write("b.mcap", "json"))


def test_a_dataflash_log_with_two_sensors_and_its_corrections(tmp_path: Path) -> None:
    path = tmp_path / "00000012.BIN"
    path.write_bytes(dataflash())
    recording = read_all(path)
    assert_same(recording, 1e-6)
    assert recording.accelerometer.temperature is not None
    assert recording.accelerometer.temperature[0] == 31.5
    notes = "\n".join(recording.notes)
    assert "has 2 sensors: IMU0 (100 Hz), IMU1 (100 Hz); reading IMU0" in notes
    assert "corrected these values already: accelerometer (INS_ACCOFFS 0.25 0 0), temperature" in notes
    second = read_all(path, sensor="IMU1")
    assert second.gyroscope is not None
    np.testing.assert_allclose(second.gyroscope.xyz, DATA[:, 4:] + 1, rtol=1e-6)


def test_damage_in_a_dataflash_log_is_skipped_and_said(tmp_path: Path) -> None:
    content = bytearray(dataflash(instances=1))
    content[5000:5040] = b"\x00" * 40
    path = tmp_path / "log.bin"
    path.write_bytes(bytes(content[:-7]))
    recording = read_all(path)
    assert 590 <= len(recording.accelerometer) < 600
    assert any("bytes are damaged and were skipped" in note for note in recording.notes)


MAKERS: list[Callable[[Path], Path]] = [npz, mat, hdf5, parquet_file]
ROWS = np.rec.fromarrays(DATA.T, names="time,ax,ay,az,gx,gy,gz")


def structured_npz(folder: Path) -> Path:
    """A table as numpy keeps one, beside an array of Python objects that nobody needs."""
    np.savez(folder / "walk.npz", imu=ROWS, about=np.array([{"by": "me"}], dtype=object))
    return folder / "walk.npz"


def dated_npz(folder: Path) -> Path:
    stamps = np.round(DATA[:, 0] * 1e6).astype("datetime64[us]")
    np.savez(folder / "walk.npz", time=stamps, acc=DATA[:, 1:4], gyr=DATA[:, 4:])
    return folder / "walk.npz"


def structured_hdf5(folder: Path) -> Path:
    with h5py.File(folder / "walk.h5", "w") as file:
        file["imu"] = ROWS
    return folder / "walk.h5"


@pytest.mark.parametrize("make", [*MAKERS, structured_npz, dated_npz, structured_hdf5])
def test_files_of_arrays(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    assert_same(read_all(make(tmp_path)))


def test_parquet_may_hold_time_stamps_with_a_date(tmp_path: Path) -> None:
    table = parquet.read_table(parquet_file(tmp_path))
    stamps = pa.array((1.7e9 + DATA[:, 0]) * 1e6, pa.float64()).cast(pa.int64()).cast(pa.timestamp("us"))
    parquet.write_table(table.set_column(1, "timestamp", stamps), tmp_path / "w.parquet")
    assert_same(read_all(tmp_path / "w.parquet"), start=1.7e9)


def test_a_column_map_says_what_arrays_are(tmp_path: Path) -> None:
    np.savez(tmp_path / "odd.npz", one=DATA[:, 0] * 1e3, two=DATA[:, 1:4] / 9.80665)
    with pytest.raises(TraceError, match=r"no accelerometer found in its arrays \(one, two\[0\]"):
        read_all(tmp_path / "odd.npz")
    columns = 'columns = ["two[0]", "two[1]", "two[2]"]'
    text = f'[time]\ncolumn = "one"\nunit = "ms"\n[accelerometer]\n{columns}\nunit = "g"\n'
    (tmp_path / "odd.toml").write_text(text)
    recording = read_all(tmp_path / "odd.npz", tmp_path / "odd.toml")
    np.testing.assert_allclose(recording.accelerometer.xyz, DATA[:, 1:4])


@pytest.mark.parametrize("make", [*MAKERS, ros1_bag, ros2_file, mcap_file, dataflash_file])
@pytest.mark.parametrize("keep", [0.02, 0.5, 0.97])
def test_what_is_cut_short_is_read_in_part_or_refused_in_one_line(
    tmp_path: Path, make: Callable[[Path], Path], keep: float
) -> None:
    path = make(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * keep)])
    try:
        recording = read_all(path)
    except TraceError as error:
        assert "\n" not in str(error) and str(error).startswith(str(path))
    else:
        assert make in (dataflash_file, mcap_file) and len(recording.accelerometer) < 600


def test_an_mcap_file_without_a_whole_message_is_said_to_break_off(tmp_path: Path) -> None:
    path = mcap_file(tmp_path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(TraceError, match="it breaks off before its first whole message"):
        read_all(path)


@pytest.mark.parametrize("make", [*MAKERS, ros1_bag, ros2_file, mcap_file, dataflash_file])
def test_a_first_byte_that_is_wrong_is_refused_in_one_line(
    tmp_path: Path, make: Callable[[Path], Path]
) -> None:
    path = make(tmp_path)
    path.write_bytes(b"?" * 16 + path.read_bytes()[16:])
    with pytest.raises(TraceError, match=r"no binary format that is known|zip data cut short") as caught:
        read_all(path)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(path))


@pytest.mark.parametrize("storage", [None, *StoragePlugin])
def test_a_bag_without_the_topic_names_those_it_has(tmp_path: Path, storage: StoragePlugin | None) -> None:
    path = bag_of_texts(tmp_path, storage)
    with pytest.raises(TraceError, match=r"no topic of type sensor_msgs/Imu; there are: /chatter \(std_msgs"):
        read_all(path)


def test_topics_on_two_clocks_are_refused(tmp_path: Path) -> None:
    path = ros2_bag(tmp_path, split=True, rate_later_s=1.7e9)
    with pytest.raises(
        TraceError, match=r"do not overlap those of .*both sensors of one recording on one clock"
    ):
        read_all(path)


def test_a_missing_library_is_named_with_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = ros1_bag(tmp_path)

    def absent(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(extras.importlib, "import_module", absent)
    with pytest.raises(TraceError, match=r"rosbags, .* is not installed; pip install 'stillcal\[ros\]'"):
        read_all(path)


def test_a_bag_in_g_is_noticed_by_the_size_of_gravity(tmp_path: Path) -> None:
    in_g = DATA.copy()
    in_g[:, 1:4] /= 9.80665
    recording = read_all(ros1_bag(tmp_path, in_g))
    np.testing.assert_allclose(recording.accelerometer.xyz, in_g[:, 1:4] * 9.80665)
    assert any("is in g, by the size of gravity" in note for note in recording.notes)


def test_a_format_that_is_not_the_logs_own_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=r"is ArduPilot DataFlash, .*leave --format out"):
        open_trace(dataflash_file(tmp_path), "csv")
    assert open_trace(dataflash_file(tmp_path), "auto").kind == "ArduPilot DataFlash"


@pytest.mark.parametrize("make", [*MAKERS, ros1_bag, dataflash_file])
def test_damage_anywhere_gives_samples_or_one_line(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    path = make(tmp_path)
    content = path.read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(12):
        damaged = bytearray(content)
        for place in rng.integers(0, len(damaged), 20):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            recording = read_all(path)
        except TraceError as error:
            assert "\n" not in str(error)
        else:
            assert (np.abs(recording.accelerometer.xyz) <= 1e9).all()


def test_a_reading_beyond_any_sensor_is_named(tmp_path: Path) -> None:
    wild = DATA.copy()
    wild[300, 2] = 1e200
    np.savez(tmp_path / "w.npz", t=wild[:, 0], acc=wild[:, 1:4])
    with pytest.raises(TraceError, match=r"w.npz:301: .* beyond any sensor's range"):
        read_all(tmp_path / "w.npz")


def test_a_ulog_in_which_the_library_would_search_for_ever_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its last message says more bytes than there are, and the way back leads over zeros to itself."""
    monkeypatch.setattr("stillcal.replay.formats.logs.ulog._MOST_SEEKS", 20_000)
    header = b"ULog\x01\x12\x35\x01" + bytes(8)
    (tmp_path / "log.ulg").write_bytes(header + bytes(70_000) + struct.pack("<HB", 12_000, 1) + bytes(9))
    with pytest.raises(TraceError, match=r"the ULog is damaged .*no message is found any more"):
        read_all(tmp_path / "log.ulg")


def written(name: str, make: Callable[[], bytes]) -> Callable[[Path], Path]:
    def path(folder: Path) -> Path:
        (folder / name).write_bytes(make())
        return folder / name

    return path


def test_a_ulog_is_read_with_the_parameters_that_px4_corrects_by(tmp_path: Path) -> None:
    recording = read_all(written("log.ulg", ulog)(tmp_path))
    assert_same(recording, 1e-6)
    assert recording.accelerometer.temperature is not None
    assert recording.accelerometer.temperature[0] == 31.5


def test_a_ulog_that_is_cut_short_is_read_and_said_to_be(tmp_path: Path) -> None:
    whole = ulog()
    recording = read_all(written("cut.ulg", lambda: whole[: len(whole) // 2 + 1])(tmp_path))
    assert any("cut.ulg: the log is cut short" in note for note in recording.notes)
    assert not any(
        "cut short" in note for note in read_all(written("log.ulg", lambda: whole)(tmp_path)).notes
    )


def test_a_ulog_larger_than_memory_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = written("log.ulg", ulog)(tmp_path)
    os.truncate(path, 10 << 30)  # a hole, which takes no room on the disk
    with pytest.raises(TraceError, match="10 GiB are more than can be held in memory"):
        open_trace(path)


def test_a_cwa_file_that_ends_within_a_block_says_so(tmp_path: Path) -> None:
    path = written("log.cwa", axivity)(tmp_path)
    assert not any("cut short" in note for note in read_all(path).notes)
    os.truncate(path, path.stat().st_size - 100)
    (note,) = [note for note in read_all(path).notes if "cut short" in note]
    assert "its last block has 412 of 512 bytes" in note


def test_the_chip_s_own_buffer_in_a_ulog_is_spread_over_its_time(tmp_path: Path) -> None:
    """600 samples at 100 Hz in messages of 8; the last one is not full."""
    recording = read_all(written("log.ulg", lambda: ulog_fifo(DATA[:597]))(tmp_path))
    t, force = recording.accelerometer.t, recording.accelerometer.xyz
    np.testing.assert_allclose(t, DATA[:597, 0], atol=2e-6)
    np.testing.assert_allclose(force, DATA[:597, 1:4], atol=0.51 / 2048)
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.gyroscope.xyz, DATA[:597, 4:], atol=0.51 / 1024)
    # A chip whose clock runs 20 % slow says 12 ms between samples: time does not run backwards.
    slow = ulog_fifo(DATA[:597]).replace(np.float32(1e4).tobytes(), np.float32(1.2e4).tobytes())
    again = read_all(written("slow.ulg", lambda: slow)(tmp_path)).accelerometer
    np.testing.assert_allclose(again.t[8:], DATA[8:597, 0], atol=2e-6)


def test_arrow_reads_the_same_bits_and_leaves_what_it_cannot_read() -> None:
    rng = np.random.default_rng(3)
    values = rng.standard_normal((500, 3)) * 10.0 ** rng.integers(-30, 30, (500, 3))
    text = "".join(",".join(map(repr, row)) + "\n" for row in values.tolist()).encode()
    read = compiled_reader(LONG_BYTES, 3)
    assert read is not None
    table = read(text, 500, [2, 0])
    assert table is not None
    np.testing.assert_array_equal(table, values[:, [2, 0]])
    empty = read(b"1,,3\n4,5,6\n", 2, [1])
    assert empty is not None and empty.tolist() == [[EMPTY], [5.0]]
    finite = read(b"1,nan,3\n", 1, [1])
    assert finite is not None and np.isnan(finite).all()  # the reader of samples refuses it by name
    for refused in (b"1,x,3\n", b"1,2\n", b"1,2,3,4\n", b"1,2,3\n\n4,5,6\n", b"1,1_0,3\n"):
        assert read(refused, refused.count(b"\n"), [1]) is None, refused


def test_an_axivity_recording_of_both_sensors(tmp_path: Path) -> None:
    recording = read_all(written("log.cwa", axivity)(tmp_path))
    assert recording.gyroscope is not None
    start = recording.accelerometer.t[0]
    np.testing.assert_allclose(recording.accelerometer.t - start, DATA[:, 0], atol=1e-4)
    np.testing.assert_allclose(recording.accelerometer.xyz, DATA[:, 1:4], atol=0.51 * 9.80665 / 2048)
    np.testing.assert_allclose(recording.gyroscope.xyz, DATA[:, 4:], atol=np.deg2rad(0.51 * 500 / 32768))


def test_arrays_of_unequal_lengths_are_not_put_side_by_side_in_silence(tmp_path: Path) -> None:
    path, (t, force, rate) = tmp_path / "r.npz", (DATA[:, 0], DATA[:, 1:4], DATA[:, 4:])
    np.savez(path, acc=force, acc_t=t, gyr=rate[:-30], gyr_t=np.linspace(t[0], t[-1], len(t) - 30))
    with pytest.raises(TraceError, match=r"acc 600, gyr 570\) with times of their own.*gyroscope_t"):
        read_all(path)
    np.savez(path, acc=force, t=t, gyr=rate[:-30])
    recording = read_all(path)
    assert recording.gyroscope is not None and len(recording.gyroscope) == 570
    assert recording.notes[-1].endswith("(rows: acc 600, gyr 570): the first 570 rows are read")
    np.savez(path, acc=force, t=t, gyr=rate[::2])
    assert read_all(path).notes[-1].endswith("the first 600 rows are read; left out: gyr")
    np.savez(path, acc=force, gyr=rate, t=t, mag_t=t[::4], acc_left=force[:300])
    assert len(read_all(path).accelerometer) == 600


def test_zeros_after_the_records_of_an_mcap_file_are_not_read(tmp_path: Path) -> None:
    store, path = get_typestore(Stores.ROS2_HUMBLE), tmp_path / "crashed.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, use_chunking=False)
        writer.start()
        channel = writer.register_channel("/imu", "cdr", writer.register_schema(IMU, "ros2msg", b""))
        for row in DATA:
            ns = round((1000 + row[0]) * 1e9)
            message = store.serialize_cdr(imu_message(store, row), IMU)
            writer.add_message(channel, ns, message, ns)
    with path.open("r+b") as file:
        file.truncate(10 << 30)
    recording = read_all(path)
    np.testing.assert_allclose(recording.accelerometer.xyz, DATA[:, 1:4])
    assert any("up to where it breaks off" in note for note in recording.notes)
