"""Tables with one row for each sensor and time."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.tables import text as text_module
from stillcal.replay.formats.trace import Recording, open_trace, read_all
from tests.support.log_files import DATA

T, FORCE, RATE = DATA[:, 0], DATA[:, 1:4], DATA[:, 4:]
DEGREES = 180 / np.pi
BOOT_NS = 81_000_000_000_000


def sensor_rows(
    force: str = "accelerometer",
    rates: str = "gyroscope",
    others: Sequence[str] = ("magnetometer,{t},20.0,-5.0,40.0",),
    per_g: float = 1.0,
    per_rad: float = 1.0,
) -> list[str]:
    """Return rows `sensor,timestamp,x,y,z`, ns, the gyroscope 3 ms after the accelerometer."""
    rows = []
    force_xyz, rate_xyz = (FORCE * per_g).tolist(), (RATE * per_rad).tolist()
    for t, (ax, ay, az), (gx, gy, gz) in zip(T, force_xyz, rate_xyz, strict=True):
        ns = BOOT_NS + round(t * 1e9)
        rows.append(f"{force},{ns},{ax!r},{ay!r},{az!r}")
        rows += [other.format(t=ns + 1_000_000) for other in others]
        rows.append(f"{rates},{ns + 3_000_000},{gx!r},{gy!r},{gz!r}")
    return rows


def in_order(rows: list[str], order: Sequence[int]) -> list[str]:
    cells = (row.split(",") for row in rows)
    return [",".join(row[i] for i in order) for row in cells]


def read(folder: Path, rows: list[str]) -> Recording:
    path = folder / "walk.csv"
    path.write_text("\n".join(rows) + "\n")
    return read_all(path)


def assert_same(recording: Recording) -> None:
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz, FORCE, rtol=1e-12)
    np.testing.assert_allclose(recording.gyroscope.xyz, RATE, rtol=1e-12)
    np.testing.assert_allclose(recording.accelerometer.t - BOOT_NS / 1e9, T, atol=1e-9)
    np.testing.assert_allclose(recording.gyroscope.t - BOOT_NS / 1e9, T + 0.003, atol=1e-9)


@pytest.mark.parametrize(
    ("force", "rates"),
    [
        ("accelerometer", "gyroscope"),
        ("ACC", "GYR"),
        ("TYPE_ACCELEROMETER", "TYPE_GYROSCOPE"),
        ("android.sensor.accelerometer", "android.sensor.gyroscope"),
        ("BMI160 Accelerometer", "BMI160 Gyroscope"),
        ("AccelerometerUncalibrated", "GyroscopeUncalibrated"),
        ("TotalAcceleration", "Gyroscope"),
        ('"accel"', '"gyro"'),
    ],
)
@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (1, 0, 2, 3, 4), (4, 3, 2, 1, 0)])
def test_rows_of_sensors_are_read_in_any_order_of_columns(
    tmp_path: Path, force: str, rates: str, order: Sequence[int]
) -> None:
    rows = ["sensor,timestamp,x,y,z", *sensor_rows(force, rates)]
    recording = read(tmp_path, in_order(rows, order))
    assert_same(recording)
    assert any("passed over: magnetometer" in note for note in recording.notes)


def test_each_block_holds_one_sensor_and_the_header_comes_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text_module, "BLOCK_BYTES", 4096)
    header, *rows = ["kind,time_ns,x,y,z", *sensor_rows()]
    by_kind = [row for kind in "mga" for row in rows if row.startswith(kind)]
    recording = read(tmp_path, [header, *by_kind[:900], header, *by_kind[900:]])
    assert_same(recording)
    assert any("1 line repeats the header" in note for note in recording.notes)
    assert any(note.endswith("passed over: magnetometer") for note in recording.notes)


def test_a_text_that_goes_with_the_sensor_is_no_device(tmp_path: Path) -> None:
    units = {"accelerometer": "m/s^2", "gyroscope": "rad/s", "magnetometer": "uT"}
    rows = [f"{row},{units[row.split(',')[0]]}" for row in sensor_rows()]
    assert_same(read(tmp_path, ["sensor,timestamp,x,y,z,unit", *rows]))


def test_rows_of_other_sensors_may_have_other_cells(tmp_path: Path) -> None:
    others = ("light,{t},40", "step,{t},walking,,", "gps,{t},52.2,0.12,20,3,4")
    assert_same(read(tmp_path, ["sensor,timestamp,x,y,z", *sensor_rows(others=others)]))


@pytest.mark.parametrize("other", ["rotation_vector", "TYPE_GAME_ROTATION_VECTOR", "RotationVector"])
def test_a_rotation_vector_is_no_gyroscope(tmp_path: Path, other: str) -> None:
    rows = sensor_rows(others=[f"{other},{{t}},0.1,-0.2,0.3"])
    recording = read(tmp_path, ["sensor,timestamp,x,y,z", *rows])
    assert_same(recording)
    assert any(note.endswith(f"passed over: {other}") for note in recording.notes)


def test_units_are_found_by_gravity(tmp_path: Path) -> None:
    rows = ["sensor,timestamp,x,y,z", *sensor_rows(per_g=1 / 9.80665, per_rad=DEGREES)]
    recording = read(tmp_path, rows)
    assert_same(recording)
    said = "; ".join(recording.notes)
    assert "in g (by the size of gravity)" in said and "in deg/s (as gravity's direction turns)" in said


def test_of_raw_and_corrected_rows_both_are_listed_and_the_raw_ones_read(tmp_path: Path) -> None:
    corrected = ("AccelerometerCalibrated,{t},0.5,0.5,9.5", "LinearAcceleration,{t},0.01,0.02,0.03")
    path = tmp_path / "walk.csv"
    rows = sensor_rows("AccelerometerUncalibrated", "GyroscopeUncalibrated", corrected)
    path.write_text("\n".join(["sensor,timestamp,x,y,z", *rows]))
    assert_same(read_all(path))
    with pytest.raises(TraceError, match=r"no sensor 'watch'; choose one of: imu.*calibrated"):
        open_trace(path, sensor="watch")


def test_a_faulty_row_of_a_sensor_is_named_and_others_are_not(tmp_path: Path) -> None:
    rows = ["sensor,timestamp,x,y,z", *sensor_rows()]
    rows[302] = "magnetometer,not a time,?,?,?"
    assert_same(read(tmp_path, rows))
    rows[301] = "accelerometer,81000000000000,oops,0,0"
    with pytest.raises(TraceError, match=r"walk\.csv:302: column 'x' holds 'oops'"):
        read(tmp_path, rows)
    rows[301] = "accelerometer,81000000000000,0,0"
    with pytest.raises(TraceError, match=r"walk\.csv:302: 4 cells instead of 5"):
        read(tmp_path, rows)


def test_a_gyroscopes_rows_alone_are_refused(tmp_path: Path) -> None:
    rows = [row for row in sensor_rows() if not row.startswith("acc")]
    with pytest.raises(TraceError, match=r"walk\.csv: holds a gyroscope and no accelerometer"):
        read(tmp_path, ["sensor,timestamp,x,y,z", *rows])


def test_two_clocks_are_refused(tmp_path: Path) -> None:
    cells = [row.split(",") for row in sensor_rows()]
    epoch = 1_700_000_000_000_000_000
    rows = [
        ",".join([c[0], str(int(c[1]) + epoch) if c[0] == "gyroscope" else str(int(c[1]) // 10**6), *c[2:]])
        for c in cells
    ]
    with pytest.raises(TraceError, match=r"do not overlap those of the accelerometer, .*on one clock"):
        read(tmp_path, ["sensor,timestamp,x,y,z", *rows])


def test_a_column_of_what_a_person_does_names_no_sensor(tmp_path: Path) -> None:
    path = tmp_path / "accelerometer.csv"
    lines = [
        f"{t!r},{x!r},{y!r},{z!r},walking" for t, (x, y, z) in zip(T.tolist(), FORCE.tolist(), strict=True)
    ]
    path.write_text("\n".join(["timestamp,x,y,z,activity", *lines]))
    np.testing.assert_array_equal(read_all(path).accelerometer.xyz, FORCE)


def in_turn(header: str, cells: str, count: int = 600) -> list[str]:
    """Return rows of two devices in turn, the second with axes x and z the other way."""
    rows = [header]
    for t, (x, y, z) in zip(T[:count].tolist(), FORCE[:count].tolist(), strict=True):
        rows.append(cells.format(device="left", t=t, x=x, y=y, z=z))
        rows.append(cells.format(device="right", t=t + 0.001, x=-x, y=y, z=-z))
    return rows


@pytest.mark.parametrize(
    ("header", "cells"),
    [
        ("imu,t,ax,ay,az", "{device},{t!r},{x!r},{y!r},{z!r}"),
        ("timestamp,acc_x,acc_y,acc_z,side", "{t!r},{x!r},{y!r},{z!r},{device}"),
        ("sensor,device,t,x,y,z", "accelerometer,{device},{t!r},{x!r},{y!r},{z!r}"),
    ],
)
def test_devices_in_turn_are_not_read_as_one(tmp_path: Path, header: str, cells: str) -> None:
    with pytest.raises(
        TraceError, match=r"several devices in turn, by column '(imu|side|device)': left, right"
    ):
        read(tmp_path, in_turn(header, cells))
    names = header.split(",")
    lines = (zip(names, row.split(","), strict=True) for row in in_turn(header, cells)[1:])
    (tmp_path / "walk.json").write_text("\n".join(json.dumps(dict(line)) for line in lines))
    with pytest.raises(
        TraceError, match=r"several devices in turn, by field '(imu|side|device)': left, right"
    ):
        read_all(tmp_path / "walk.json")


@pytest.mark.parametrize(
    "label", [lambda i: "walking" if i // 150 % 2 else "sitting", lambda i: str(i % 2 == 0)]
)
def test_what_a_person_does_and_flags_are_no_devices(tmp_path: Path, label: Callable[[int], str]) -> None:
    rows = [f"{t!r},{x!r},{y!r},{z!r}" for t, (x, y, z) in zip(T.tolist(), FORCE.tolist(), strict=True)]
    recording = read(tmp_path, ["t,ax,ay,az,label", *(f"{row},{label(i)}" for i, row in enumerate(rows))])
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)


def by_types(name: str, axes: str, force: int, rates: int) -> list[str]:
    rows = (
        f"{t},{kind},{joined}"
        for t in range(0, 2000, 10)
        for kind, joined in (
            (force, f"{0.1 + t % 7 / 100},0.2,9.8"),
            (rates, f"{t % 3 / 100},0.02,0.03"),
            (6, "1,2,3"),
        )
    )
    return [f"time_ms,{name},{axes}", *rows]


@pytest.mark.parametrize(
    ("name", "axes", "types"),
    [
        ("sensor_type", "x,y,z", (1, 4)),
        ("type", "v0,v1,v2", (35, 4)),
        ("sensorType", "value_0,value_1,value_2", (1, 16)),
        ("id", "values[0],values[1],values[2]", (35, 16)),
    ],
)
@pytest.mark.parametrize("form", ["csv", "json"])
def test_android_s_numbers_of_sensors(
    tmp_path: Path, name: str, axes: str, types: tuple[int, int], form: str
) -> None:
    lines = by_types(name, axes, *types)
    if form == "json":
        names = lines[0].split(",")
        lines = [
            json.dumps(
                dict(zip(names, map(float, row.split(",")), strict=True)) | {name: int(row.split(",")[1])}
            )
            for row in lines[1:]
        ]
    path = tmp_path / "r.txt"
    path.write_text("\n".join(lines) + "\n")
    recording = read_all(path)
    np.testing.assert_allclose(recording.accelerometer.xyz[:, 2], 9.8)
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.gyroscope.xyz[:, 1:], [[0.02, 0.03]] * 200)
    assert "passed over: pressure" in recording.notes[0]


def test_numbers_that_may_mean_anything_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("\n".join(by_types("sensor", "x,y,z", 1, 4)) + "\n")
    with pytest.raises(TraceError, match=r"'sensor' may hold Android's types.*call it sensor_type"):
        read_all(path)


def test_labels_of_activities_are_no_sensors(tmp_path: Path) -> None:
    path = tmp_path / "accelerometer.csv"
    rows = (f"{i * 10},{1 + i // 50},{i % 7 / 100},0.2,9.8" for i in range(200))
    path.write_text("\n".join(["time_ms,activity_type,x,y,z", *rows]) + "\n")
    assert len(read_all(path).accelerometer) == 200


def written_parquet(path: Path, columns: dict[str, np.ndarray]) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet  # noqa: PLC0415 - an extra

    table = pyarrow.table({name: pyarrow.array(values.tolist()) for name, values in columns.items()})
    parquet.write_table(table, path, row_group_size=150)


def written_npz(path: Path, columns: dict[str, np.ndarray]) -> None:
    with path.open("wb") as file:
        np.savez(file, **columns)


def written_hdf5(path: Path, columns: dict[str, np.ndarray]) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file["log/" + name] = values.astype(object) if values.dtype.kind == "U" else values


def written_hdf5_rows(path: Path, columns: dict[str, np.ndarray]) -> None:
    h5py = pytest.importorskip("h5py")
    kinds = [(name, "S16" if v.dtype.kind == "U" else v.dtype) for name, v in columns.items()]
    rows = np.array(list(zip(*columns.values(), strict=True)), dtype=kinds)
    with h5py.File(path, "w") as file:
        file["log"] = rows


@pytest.mark.parametrize("write", [written_parquet, written_npz, written_hdf5, written_hdf5_rows])
def test_arrays_may_hold_a_row_for_each_sensor(
    tmp_path: Path, write: Callable[[Path, dict[str, np.ndarray]], None]
) -> None:
    n = 200
    time = np.arange(n) * 10.0 + 1000
    force = np.random.default_rng(2).normal([0.1, 0.2, 9.8], 0.02, (n, 3))
    rates = np.random.default_rng(3).normal(0.0, 0.02, (n, 3))
    rows = np.stack([force, rates], axis=1).reshape(-1, 3)
    columns = {"sensor": np.tile(["accelerometer", "gyroscope"], n), "time_ms": np.repeat(time, 2)}
    path = tmp_path / "r"
    write(path, columns | dict(zip("xyz", rows.T.copy(), strict=True)))
    recording = read_all(path)
    np.testing.assert_array_equal(recording.accelerometer.xyz, force)
    np.testing.assert_allclose(recording.accelerometer.t, time / 1000)
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.gyroscope.xyz, rates)
