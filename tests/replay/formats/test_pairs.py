"""A gyroscope that is not in the accelerometer's table: another file, another group, or none at all."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.pairs import rates_file
from stillcal.replay.formats.trace import Recording, open_trace, read_all
from tests.support.log_files import (
    DATA,
    as_folder,
    as_zip,
    npz,
    phyphox_files,
    ros1_bag,
    sensor_logger_files,
    text,
)

DEGREES = 180 / np.pi
T, FORCE, RATE = DATA[:, 0], DATA[:, 1:4], DATA[:, 4:]
LATER = T[:400] + 0.003


def force(header: str) -> str:
    return text(header, DATA[:, :4])


def rates(header: str, per_rad: float = 1.0) -> str:
    return text(header, np.column_stack([LATER, RATE[:400] * per_rad]))


def _folder(parent: Path) -> Path:
    made = parent / "in"
    made.mkdir()
    return made


def assert_pair(recording: Recording) -> None:
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz, FORCE, rtol=1e-9)
    np.testing.assert_allclose(recording.gyroscope.xyz, RATE[:400], rtol=1e-9)
    np.testing.assert_allclose(recording.gyroscope.t - recording.accelerometer.t[0], LATER, atol=1e-9)


def xyz(time: str, axis: str, unit: str) -> str:
    return ",".join([f'"{time}"', *(f'"{axis.format(a)} ({unit})"' for a in "xyz")])


PHYPHOX, METAWEAR = ("Time (s)", "{}"), ("elapsed (s)", "{}-axis")
PAIRS = [
    ("Accelerometer.csv", xyz(*PHYPHOX, "m/s^2"), "Gyroscope.csv", xyz(*PHYPHOX, "rad/s"), 1.0),
    ("a_Accelerometer.csv", xyz(*METAWEAR, "m/s^2"), "a_Gyroscope.csv", xyz(*METAWEAR, "deg/s"), DEGREES),
    ("sensor_accel_0.csv", "timestamp,x,y,z", "sensor_gyro_0.csv", "timestamp,x,y,z", DEGREES),
    ("acc.csv", "t,x,y,z", "gyr.csv", "t,x,y,z", 1.0),
    ("acce.txt", "# Created on a Monday", "gyro.txt", "# Created on a Monday", 1.0),
]


@pytest.mark.parametrize("given", ["file", "folder", "zip", "--gyro"])
@pytest.mark.parametrize(("first", "columns", "second", "others", "per_rad"), PAIRS)
def test_two_files_of_one_recording_are_read_together(
    tmp_path: Path, given: str, first: str, columns: str, second: str, others: str, per_rad: float
) -> None:
    files = {first: force(columns), second: rates(others, per_rad)}
    if given == "zip":
        assert_pair(read_all(as_zip(tmp_path, files)))
        return
    if given == "--gyro":
        (tmp_path / "elsewhere.csv").write_text(files.pop(second).replace("x,y,z", "gx,gy,gz"))
    folder = as_folder(tmp_path, files)
    gyro = tmp_path / "elsewhere.csv" if given == "--gyro" else None
    assert_pair(read_all(folder if given == "folder" else folder / first, gyro=gyro))


@pytest.mark.parametrize("header", ["Timestamp,X,Y,Z", "time,x,y,z"])
def test_axes_that_nothing_names_are_an_accelerometers_where_they_measure_gravity(
    tmp_path: Path, header: str
) -> None:
    """MATLAB's writetimetable gives the timetables of a phone's sensors that MATLAB Mobile logs so."""
    (tmp_path / "walk.csv").write_text(force(header))
    (tmp_path / "turns.csv").write_text(rates(header))
    recording = read_all(tmp_path / "walk.csv", gyro=tmp_path / "turns.csv")
    assert_pair(recording)
    assert any(
        "walk.csv: x, y, z are an accelerometer's by the size of gravity" in n for n in recording.notes
    )


@pytest.mark.parametrize("other", [RATE[0], np.array([20.0, -5.0, 40.0])])
def test_rows_of_two_sensors_are_not_one_accelerometers(tmp_path: Path, other: np.ndarray) -> None:
    rows = DATA[:, :4].copy()
    rows[::3, 1:] = other
    (tmp_path / "walk.csv").write_text(text("time,x,y,z", rows))
    with pytest.raises(TraceError, match=r":1: no accelerometer found by its names"):
        read_all(tmp_path / "walk.csv")


def test_axes_that_nothing_names_are_those_of_one_sensor(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(text("time,x,y,z,x,y,z", DATA))
    with pytest.raises(
        TraceError, match=r":1: no accelerometer found by its names; .*: time, x, y, z, x, y, z"
    ):
        read_all(tmp_path / "walk.csv")


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        *((name, 1.0) for name in ("Gravity.csv", "mag_field.csv", "velocity.csv", "rotation_vector.csv")),
        *((name, 1 / 9.81) for name in ("Quaternions.csv", "surface_normals.csv", "GameRotationVector.csv")),
    ],
)
@pytest.mark.parametrize("times", ["Timestamp", "time,seconds_elapsed"])
def test_axes_of_something_else_are_not_taken_for_an_accelerometers(
    tmp_path: Path, name: str, factor: float, times: str
) -> None:
    table = np.column_stack([*[T for _ in times.split(",")], FORCE * factor])
    (tmp_path / name).write_text(text(f"{times},x,y,z", table))
    with pytest.raises(TraceError, match=rf"{name}: is called after another quantity than acceleration"):
        read_all(tmp_path / name)


def test_axes_that_nothing_names_and_are_not_of_gravitys_size_are_refused(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(text("Timestamp,X,Y,Z", DATA[:, :4] * [1, 1.1, 1.1, 1.1]))
    with pytest.raises(TraceError, match=r":1: no accelerometer found by its names; .*: Timestamp, X, Y, Z"):
        read_all(tmp_path / "walk.csv")


@pytest.mark.parametrize("others", ["w", "qw", "roll,pitch,yaw"])
def test_axes_beside_a_rotation_are_not_taken_for_an_accelerometers(tmp_path: Path, others: str) -> None:
    table = np.column_stack([DATA[:, :4], RATE[:, : others.count(",") + 1]])
    (tmp_path / "log.csv").write_text(text(f"time,x,y,z,{others}", table))
    with pytest.raises(TraceError, match=r":1: no accelerometer found by its names"):
        read_all(tmp_path / "log.csv")


@pytest.mark.parametrize("other", ["quaternion.csv", "log1.csv"])
def test_a_folders_table_of_bare_axes_is_passed_over_beside_a_named_accelerometer(
    tmp_path: Path, other: str
) -> None:
    unit = text("time,x,y,z", DATA[:, :4] / [1, 9.81, 9.81, 9.81])
    files = {"acc.csv": force("t,x,y,z"), "gyr.csv": rates("t,x,y,z"), other: unit}
    recording = read_all(as_folder(tmp_path, files))
    assert_pair(recording)
    assert any(f"acc.csv with gyr.csv is read; passed over: {other}" in note for note in recording.notes)


def several(words: list[str], sensor: str, columns: np.ndarray) -> str:
    """Return a table of one sensor's columns for each word; those of "right" are multiplied by -1."""
    header = ",".join(["t", *(f"{word}_{sensor}_{axis}" for word in words for axis in "xyz")])
    return text(header, np.column_stack([T, *(-columns if word == "right" else columns for word in words)]))


def test_each_of_several_accelerometers_goes_with_the_gyroscope_of_its_name(tmp_path: Path) -> None:
    files = {"acc.csv": several(["left", "right"], "acc", FORCE)}
    folder = as_folder(tmp_path, files | {"gyr.csv": several(["right", "left"], "gyr", RATE)})
    for sensor, sign in (("left", 1), ("right", -1)):
        recording = read_all(folder / "acc.csv", sensor=sensor)
        assert recording.gyroscope is not None
        np.testing.assert_allclose(recording.gyroscope.xyz, sign * RATE, rtol=1e-9)
    (folder / "gyr.csv").write_text(several(["hand", "foot"], "gyr", RATE))
    with pytest.raises(TraceError, match=r"gyr.csv:1: none of its gyroscopes is called as .* left_acc_x"):
        read_all(folder / "acc.csv")


@pytest.mark.parametrize(
    "header", ["t,gx,gy,gz", '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"']
)
@pytest.mark.parametrize("pack", [as_folder, as_zip, None])
def test_a_gyroscope_alone_is_said_to_be_one(tmp_path: Path, pack, header: str) -> None:
    path = tmp_path / "r.csv"
    path.write_text(rates(header))
    with pytest.raises(TraceError, match=r"gyroscope and no accelerometer.*give the accelerometer's file"):
        read_all(path if pack is None else pack(_folder(tmp_path), {"r.csv": rates(header)}))


def test_arrays_of_a_gyroscope_alone_are_said_to_be_one(tmp_path: Path) -> None:
    np.savez(tmp_path / "r.npz", t=T, gyr=RATE)
    with pytest.raises(TraceError, match=r"holds a gyroscope and no accelerometer"):
        read_all(tmp_path / "r.npz")


@pytest.mark.parametrize("pack", [as_folder, as_zip])
@pytest.mark.parametrize("files", [phyphox_files, sensor_logger_files])
def test_a_gyroscopes_file_without_rows_is_said(tmp_path: Path, pack, files) -> None:
    held = {n: c.split("\n")[0] + "\n" if n.startswith("Gyroscope") else c for n, c in files().items()}
    recording = read_all(pack(tmp_path, held))
    assert recording.gyroscope is None and len(recording.accelerometer) == 400
    assert any("Gyroscope.csv holds a header and no samples" in note for note in recording.notes)


def test_a_gyroscopes_file_without_rows_beside_a_file_is_said(tmp_path: Path) -> None:
    folder = as_folder(tmp_path, {"acc.csv": force("t,x,y,z"), "gyr.csv": "t,x,y,z\n"})
    recording = read_all(folder / "acc.csv")
    assert recording.gyroscope is None
    assert any("gyr.csv: holds a header and no samples" in note for note in recording.notes)
    with pytest.raises(TraceError, match=r"gyr.csv:1: the file holds a header only"):
        read_all(folder / "acc.csv", gyro=folder / "gyr.csv")


@pytest.mark.parametrize("held", ["npz", "folder", "zip", "itself", "no rates"])
def test_a_gyroscopes_file_that_cannot_be_one_is_refused_and_not_passed_over(
    tmp_path: Path, held: str
) -> None:
    own = tmp_path / "walk.csv"
    own.write_text(force("t,ax,ay,az"))
    (tmp_path / "other.csv").write_text(force("t,ax,ay,az"))
    gyro = own if held == "itself" else tmp_path / "other.csv"
    made = {
        "npz": lambda: npz(tmp_path),
        "folder": lambda: as_folder(_folder(tmp_path), phyphox_files()),
        "zip": lambda: as_zip(_folder(tmp_path), phyphox_files()),
    }
    what = {"itself": "is the recording itself", "no rates": "no column 'gx', 'gy', 'gz'"}
    with pytest.raises(TraceError, match=what.get(held, "no gyroscope's file of its own goes with")):
        read_all(made.get(held, lambda: own)(), gyro=gyro)


GROUPS = [
    {"imu/accel": FORCE, "imu/gyro": RATE, "time": T},
    {"imu/accel/values": FORCE, "imu/accel/t": T, "imu/gyro/values": RATE[:400], "imu/gyro/t": LATER},
    {"accel/data": FORCE, "accel/t": T, "gyro/data": RATE[:400] * DEGREES, "gyro/t": LATER},
    {
        **{f"acc/{axis}": FORCE[:, i] for i, axis in enumerate("xyz")},
        **{"acc/t": T, "gyr/data": RATE, "gyr/t": T},
    },
]


@pytest.mark.parametrize("kind", ["hdf5", "matlab"])
@pytest.mark.parametrize("arrays", GROUPS)
def test_groups_that_hold_a_sensor_each_are_read_together(
    tmp_path: Path, arrays: dict[str, np.ndarray], kind: str
) -> None:
    path = tmp_path / "r"
    if kind == "hdf5":
        with h5py.File(path, "w") as file:
            for name, value in arrays.items():
                file[name] = value
    else:
        tree: dict = {}
        for name, value in arrays.items():
            *groups, last = name.split("/")
            inner = tree
            for group in groups:
                inner = inner.setdefault(group, {})
            inner[last] = value
        scipy.io.savemat(path, tree, appendmat=False)
    recording = read_all(path)
    if any(value.shape[0] == 400 for value in arrays.values()):
        assert_pair(recording)
        return
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz, FORCE, rtol=1e-9)
    np.testing.assert_allclose(recording.gyroscope.xyz, RATE, rtol=1e-9)


@pytest.mark.parametrize("attribute", [True, False])
def test_a_groups_attribute_or_a_number_in_it_says_its_rate(tmp_path: Path, attribute: bool) -> None:
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["imu/accel"] = FORCE
        if attribute:
            file["imu"].attrs["fs"] = 100.0
        else:
            file["imu/fs"] = 100.0
    np.testing.assert_allclose(read_all(tmp_path / "r.h5").accelerometer.t, T, atol=1e-9)


def bag(folder: Path, per_rad: float) -> Path:
    repeated = np.vstack([DATA + 6.0 * i * np.eye(7)[0] for i in range(3)])
    repeated[:, 4:] *= per_rad
    return ros1_bag(folder, repeated)


def test_a_bag_in_degrees_is_read_as_such_and_said(tmp_path: Path) -> None:
    recording = read_all(bag(tmp_path, DEGREES))
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.gyroscope.xyz[:600], RATE, rtol=1e-9)
    assert any("are read in deg/s (as gravity's direction turns), not in rad/s" in n for n in recording.notes)


def test_a_bag_in_radians_is_read_without_a_word(tmp_path: Path) -> None:
    recording = read_all(bag(tmp_path, 1.0))
    assert recording.gyroscope is not None and not recording.notes
    np.testing.assert_allclose(recording.gyroscope.xyz[:600], RATE, rtol=1e-9)


@pytest.mark.parametrize(
    ("accelerometer", "gyroscope"),
    [
        ("ACC.csv", "GYR.csv"),
        ("myAccData3.csv", "myGyroData3.csv"),
        ("walk-accelerometer-left.txt", "walk-gyroscope-left.txt"),
        ("TotalAcceleration.csv", "Gyroscope.csv"),
        ("accelerations.csv", "gyroscopes.csv"),
        ("linear_acceleration.csv", "angular_velocity.csv"),
        ("acc_protocol_1.csv", "gyr_protocol_1.csv"),
        ("rawTotalAccelerationData.csv", "rawGyroscopeData.csv"),
        ("ACC_gyration.csv", "GYR_gyration.csv"),
        ("accident_acc.csv", "accident_gyr.csv"),
        ("imu0_specific_force.csv", "imu0_angular_rate.csv"),
        ("accel.csv", "omega.csv"),
    ],
)
def test_the_gyroscopes_file_is_called_the_same_with_its_own_word(
    tmp_path: Path, accelerometer: str, gyroscope: str
) -> None:
    others = ("gyr_11.csv", "gyro_other.csv", "magnetometer.csv", "rotation.csv", "acc_2.csv")
    for name in (accelerometer, gyroscope, *others):
        (tmp_path / name).touch()
    assert rates_file(tmp_path / accelerometer) == tmp_path / gyroscope


@pytest.mark.parametrize("name", ["acc_1_1.csv", "walk.csv", "gyr_11.csv", "rotation.csv", "linear.csv"])
def test_a_file_of_another_name_is_not_taken(tmp_path: Path, name: str) -> None:
    for other in ("gyr_11.csv", "acc_11.csv.gz", "rotation.csv", "gyro_acc_11.csv"):
        (tmp_path / other).touch()
    assert rates_file(tmp_path / name) is None


def test_of_several_files_that_with_the_most_alike_name_is_taken(tmp_path: Path) -> None:
    names = ("Gyroscope.csv", "gyro.csv", "gyr.csv", "GyroscopeUncalibrated.csv", "gyroscope_raw.csv")
    for name in names:
        (tmp_path / name).touch()
    pairs = {"Accelerometer.csv": 0, "accel.csv": 1, "Acc.csv": 2, "AccelerometerUncalibrated.csv": 3}
    assert {name: rates_file(tmp_path / name).name for name in pairs} == {
        n: names[i] for n, i in pairs.items()
    }


@pytest.mark.parametrize("header", ["acc_time,{a},gyr_time,{g}", "timestamp,{a},gyro_timestamp,{g}"])
def test_a_gyroscope_with_a_column_of_its_own_times_is_read_by_it(tmp_path: Path, header: str) -> None:
    names = header.format(a="acc_x,acc_y,acc_z", g="gyr_x,gyr_y,gyr_z")
    table = np.column_stack([T[:400], FORCE[:400], LATER, RATE[:400]])
    (tmp_path / "walk.csv").write_text(text(names, table))
    recording = read_all(tmp_path / "walk.csv")
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE[:400])
    np.testing.assert_array_equal(recording.gyroscope.xyz, RATE[:400])
    np.testing.assert_allclose(recording.accelerometer.t, T[:400])
    np.testing.assert_allclose(recording.gyroscope.t, LATER)
    other = np.column_stack([T[:400], FORCE[:400], LATER + 1.7e9, RATE[:400]])
    (tmp_path / "walk.csv").write_text(text(names, other))
    with pytest.raises(TraceError, match="do not overlap those of the accelerometer"):
        read_all(tmp_path / "walk.csv")


def test_nothing_is_passed_on_of_a_gyroscope_on_another_clock(tmp_path: Path) -> None:
    (tmp_path / "acc.csv").write_text(force("t,x,y,z"))
    (tmp_path / "gyr.csv").write_text(text("t,x,y,z", np.column_stack([LATER + 1.7e9, RATE[:400]])))
    passed: list[int] = []
    with pytest.raises(TraceError, match=r"times, from 1.7e\+09 s on, do not overlap those of .* acc.csv"):
        passed.extend(len(chunk.gyroscope) for chunk in open_trace(tmp_path / "acc.csv"))
    assert not any(passed)
