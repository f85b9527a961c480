"""Recordings are recognised by their content, wherever their bytes come from."""

from __future__ import annotations

import gzip
import importlib.util
import io
import os
import re
import struct
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

import stillcal
from stillcal.daemon.system import files
from stillcal.replay.formats import sources
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition import magic
from stillcal.replay.formats.recognition.opened import READERS, is_rest_table
from stillcal.replay.formats.trace import open_trace, read_all
from tests.support.log_files import (
    DATA,
    as_folder,
    as_zip,
    dataflash_file,
    gnss_logger,
    npz,
    phyphox_files,
    phyphox_ios_files,
    ros1_bag,
    rows,
    sensor_logger_files,
    text,
)

DEGREES = 180 / np.pi


@pytest.mark.parametrize("pack", [as_folder, as_zip])
def test_a_sensor_logger_export_is_read_uncalibrated_with_the_systems_bias(tmp_path: Path, pack) -> None:
    path = pack(tmp_path, sensor_logger_files())
    recording = read_all(path)
    calibrated = read_all(path, sensor="calibrated")
    assert recording.gyroscope is not None and calibrated.gyroscope is not None
    np.testing.assert_allclose(
        recording.gyroscope.xyz - calibrated.gyroscope.xyz, [[0.01, -0.02, 0.03]] * 400
    )
    np.testing.assert_allclose(recording.accelerometer.xyz - calibrated.accelerometer.xyz, 0.1)
    assert any("gyroscope bias is 0.01 -0.02 0.03 rad/s" in note for note in recording.notes)
    with pytest.raises(TraceError, match=r"no sensor 'watch'.*uncalibrated.*calibrated"):
        open_trace(path, sensor="watch")


@pytest.mark.parametrize("pack", [as_folder, as_zip])
@pytest.mark.parametrize("files", [sensor_logger_files, phyphox_files])
def test_several_exports_in_one_are_not_mixed(tmp_path: Path, pack, files) -> None:
    both = {f"{day}/{name}": text for day in ("monday", "tuesday") for name, text in files().items()}
    with pytest.raises(
        TraceError, match=r"holds 2 exports, in .*monday, .*tuesday; (unpack it and )?give one"
    ):
        open_trace(pack(tmp_path, both))


@pytest.mark.parametrize("pack", [as_folder, as_zip])
def test_a_phyphox_export_is_read_with_what_it_says_of_the_sensors(tmp_path: Path, pack) -> None:
    trace = open_trace(pack(tmp_path, phyphox_files()))
    assert trace.kind == "phyphox" and trace.has_gyroscope
    assert sum(len(chunk.accelerometer) for chunk in trace) == 400
    assert (trace.claims.device, trace.claims.accel_range) == ("Pixel 9a", 78.4532)
    assert trace.claims.gyro_range is None


@pytest.mark.parametrize("pack", [as_folder, as_zip])
def test_what_phyphox_on_ios_calls_x_y_z_is_read_and_not_taken_for_two_recordings(
    tmp_path: Path, pack
) -> None:
    """Both accelerations have the same header there; gravity is in one of the two only."""
    recording = read_all(pack(tmp_path, phyphox_ios_files(LONG)))
    np.testing.assert_array_equal(recording.accelerometer.xyz, LONG[:, 1:4])
    np.testing.assert_array_equal(recording.gyroscope.xyz, LONG[:, 4:])
    assert (recording.claims.device, recording.notes) == ("iPhone13,4", [])


def test_phyphox_on_ios_without_gravity_is_refused_with_what_to_record(tmp_path: Path) -> None:
    files = {name: made for name, made in phyphox_ios_files().items() if name != "Accelerometer.csv"}
    with pytest.raises(TraceError, match=r"Linear Accelerometer.csv: phyphox took gravity out.*with g"):
        open_trace(as_zip(tmp_path, files))


def test_a_zip_of_one_table_of_any_columns_is_read(tmp_path: Path) -> None:
    table = text("timestamp,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z", LONG)
    path = as_zip(tmp_path, {"imu0/data.csv": table, "readme.txt": "a walk"})
    recording = read_all(path)
    np.testing.assert_array_equal(recording.accelerometer.xyz, LONG[:, 1:4])
    assert re.search(r"imu0/data.csv is read; passed over: .*readme.txt", recording.notes[0])


def test_phyphox_without_gravity_is_refused_with_what_to_record(tmp_path: Path) -> None:
    header = ",".join(["Time (s)", *(f"Linear Acceleration {a} (m/s^2)" for a in "xyz")])
    path = as_zip(tmp_path, {"Raw Data.csv": text(header, rows()[:, :4])})
    with pytest.raises(TraceError, match=r"took gravity out.*with g"):
        open_trace(path)


@pytest.mark.parametrize(
    ("header", "table", "notes"),
    [
        (
            "timestamp_ms,accX,accY,accZ,gyroX,gyroY,gyroZ",
            [1e3, 1, 1],
            ["ms", "in m/s^2", "rad/s (as gravity"],
        ),
        (
            "Time [us],ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps",
            [1e6, 1 / 9.80665, 57.29577951308232],
            ["in g;", "deg/s"],
        ),
        ("time,gFx,gFy,gFz,wx,wy,wz", [1, 1 / 9.80665, 1], ["in g;", "rad/s (as gravity"]),
        ("timestamp,alpha_x,alpha_y,alpha_z,omega_x,omega_y,omega_z", [1e9, 1, 1], ["in ns", "by the size"]),
        (
            "epoch (ms),x-axis (g),y-axis (g),z-axis (g),x-axis (deg/s),y-axis (deg/s),z-axis (deg/s)",
            [1e3, 1 / 9.80665, 57.29577951308232],
            ["in ms", "in g;", "in deg/s"],
        ),
        (
            "S1_Timestamp_Unix_CAL,S1_Accel_X_CAL,S1_Accel_Y_CAL,S1_Accel_Z_CAL,S1_Gyro_X,S1_Gyro_Y,S1_Gyro_Z",
            [1e3, 1, 57.29577951308232],
            ["in ms", "in m/s^2 (by", "deg/s (as gravity"],
        ),
        (
            "ts,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z",
            [1e9, 1, 57.29577951308232],
            ["in ns", "deg/s (as gravity"],
        ),
        (
            "#timestamp [ns],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2],"
            "w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]",
            [1e9, 1, 1],
            ["in ns", "in m/s^2;", "rad/s"],
        ),
    ],
)
def test_columns_of_any_usual_name_are_found_with_their_units(
    tmp_path: Path, header: str, table: list[float], notes: list[str]
) -> None:
    data = rows(3000)
    scaled = data * np.array([table[0], *[table[1]] * 3, *[table[2]] * 3])
    path = tmp_path / "log.csv"
    path.write_text(text(header, scaled))
    recording = read_all(path)
    np.testing.assert_allclose(recording.accelerometer.t, data[:, 0], atol=1e-9)
    np.testing.assert_allclose(recording.accelerometer.xyz, data[:, 1:4], rtol=1e-9)
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.gyroscope.xyz, data[:, 4:], rtol=1e-9)
    assert all(part in recording.notes[0] for part in notes), recording.notes


@pytest.mark.parametrize(
    ("quantity", "beside"),
    [
        ("acc_uncalibrated", "acc"),
        ("accelerometer", "linear_acceleration"),
        ("gyro", "rot"),
        ("gyroscope_raw", "gyroscope"),
    ],
)
def test_the_least_corrected_columns_of_a_sensor_are_read(tmp_path: Path, quantity: str, beside: str) -> None:
    data = rows(3000)
    of, other = (data[:, 4:], "acc") if "gyr" in quantity else (data[:, 1:4], "gyr")
    names = ["time", *(f"{sensor}_{axis}" for sensor in (beside, quantity, other) for axis in "xyz")]
    rest = data[:, 1:4] if other == "acc" else data[:, 4:]
    path = tmp_path / "r.csv"
    path.write_text(text(",".join(names), np.column_stack([data[:, 0], of * 0.9, of, rest])))
    recording = read_all(path)
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.accelerometer.xyz, data[:, 1:4])
    np.testing.assert_array_equal(recording.gyroscope.xyz, data[:, 4:])
    if beside == "acc":
        assert "has 2 sensors: acc_uncalibrated (accelerometer, gyroscope), acc (" in recording.notes[0]
        np.testing.assert_array_equal(read_all(path, sensor=beside).accelerometer.xyz, of * 0.9)


LONG = rows(2000)
IN_OTHER_UNITS = [1e3, *[1 / 9.80665] * 3, *[DEGREES] * 3]
SHIMMER = "\n".join(
    "\t".join(line)
    for line in (
        ["Stamp", *(f"S1_{sensor}_{axis}" for sensor in ("Accel_LN", "Gyro") for axis in "XYZ")],
        ["CAL"] * 7,
        ["ms", *["g"] * 3, *["deg/s"] * 3],
    )
)
OWN = "t,ax,ay,az,gx,gy,gz"
OPENSIM = "walk\nversion=1\nnRows=2000\nnColumns=7\ninDegrees=no\nendheader\n"
PREAMBLE = "// General information:\n// Rate,100\nSample,Time (s),Comment\n\n"


@pytest.mark.parametrize(
    "table",
    [
        text("t;ax;ay;az;gx;gy;gz", LONG, ";").replace(".", ","),
        text("t|ax|ay|az|gx|gy|gz", LONG, "|"),
        text(f"# {OWN}", LONG),
        text(f"# made by hand\n# twice, and, again\n#{OWN}", LONG),
        text(f"# {OWN.replace(',', ' ')}", LONG, " "),
        text(f"sep=,\nDevice:,left\n\n{OWN}", LONG),
        text(f"Device:,left,,,,,\nRange:,4 g,,,,,\n{OWN}", LONG),  # as a spreadsheet fills short lines
        text(f"1,2,3\n{OWN}", LONG),
        text(f"Ranges,2,4,8,16,g,of,this,device,type\nRate,100\n{OWN}", LONG),
        text(f"logger:\n  name: left\n---\n{OWN}", LONG),
        text(OPENSIM + OWN.replace(",", "\t"), LONG, "\t"),
        text(PREAMBLE + OWN.replace(",", "\t"), LONG, "\t"),
        text("t,ax,ay,az,gx,gy,gz\nms,g,g,g,deg/s,deg/s,deg/s", LONG * IN_OTHER_UNITS),
        text(SHIMMER, LONG * IN_OTHER_UNITS, "\t"),
        text(
            "Zeit (s),Kraft x (m/s^2),Kraft y (m/s^2),Kraft z (m/s^2),AsX(°/s),AsY(°/s),AsZ(°/s)",
            LONG * [*[1] * 4, *[DEGREES] * 3],
        ),
    ],
)
def test_separators_comments_and_what_stands_before_a_header(tmp_path: Path, table: str) -> None:
    path = tmp_path / "r.csv"
    path.write_text(table, encoding="latin-1")
    recording = read_all(path)
    np.testing.assert_allclose(recording.accelerometer.t, LONG[:, 0], rtol=1e-14)
    np.testing.assert_allclose(recording.accelerometer.xyz, LONG[:, 1:4], rtol=1e-14)
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.gyroscope.xyz, LONG[:, 4:], rtol=1e-14)


@pytest.mark.parametrize("header", ["time,acc_x,acc_y,acc_z", "t,ax,ay,az"])
def test_acceleration_without_gravity_is_refused(tmp_path: Path, header: str) -> None:
    path = tmp_path / "r.csv"
    path.write_text(text(header, rows()[:, :4] * [1, 0.02, 0.02, 0.02]))
    with pytest.raises(TraceError, match=r"gravity (in no unit|was taken out)"):
        read_all(path)
    path.write_text(text(header, rows()[:, :4] * [1, 0.45, 0.45, 0.45]))
    assert len(read_all(path).accelerometer) == 400


@pytest.mark.parametrize(("order", "mark"), [([0, 1, 2, 3, 4, 5, 6], ","), ([0, 4, 5, 6, 1, 2, 3], ";")])
def test_without_a_header_the_columns_of_gravitys_size_are_the_accelerometers(
    tmp_path: Path, order: list[int], mark: str
) -> None:
    path = tmp_path / "r.csv"
    path.write_text(text("", LONG[:, order], mark).lstrip())
    recording = read_all(path)
    np.testing.assert_array_equal(recording.accelerometer.xyz, LONG[:, 1:4])
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.gyroscope.xyz, LONG[:, 4:])
    assert "columns counted from 0" in recording.notes[0]
    path.write_text(text("", np.column_stack([LONG[:, :4], LONG[:, 1:4] / 9.81]), mark).lstrip())
    with pytest.raises(TraceError, match="which of columns 1, 2, 3 and 4, 5, 6"):
        read_all(path)


def test_a_column_of_whole_seconds_is_no_clock(tmp_path: Path) -> None:
    path, t = tmp_path / "r.csv", LONG[:, :1]
    path.write_text(text("sec,ax,ay,az", np.column_stack([t // 1, LONG[:, 1:4]])))
    with pytest.raises(TraceError, match="99% of the stamps in column 'sec' repeat"):
        read_all(path)
    path.write_text(text("sec,time,ax,ay,az", np.column_stack([t // 1, LONG[:, :4]])))
    assert read_all(path).rate_hz == pytest.approx(100.0)


@pytest.mark.parametrize("name", ["", "datetime", "Date/Time", "Datum"])
def test_a_column_of_dates_is_the_time_whatever_it_is_called(tmp_path: Path, name: str) -> None:
    stamps = [str(np.datetime64("2026-03-01T10:00:00.000") + 10 * i) for i in range(len(LONG))]
    lines = [
        ",".join([stamp, *map(repr, row)]) for stamp, row in zip(stamps, LONG[:, 1:4].tolist(), strict=True)
    ]
    path = tmp_path / "r.csv"
    path.write_text("\n".join([f"{name},ax,ay,az", *lines]) + "\n")
    recording = read_all(path)
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 0.01, atol=1e-6)
    assert f"time {name} in dates" in recording.notes[0]


def test_damage_in_a_table_of_any_columns_is_not_laid_on_its_time(tmp_path: Path) -> None:
    path, content = tmp_path / "r.csv", text("time,acc_x,acc_y,acc_z", LONG[:, :4])
    path.write_text(content + "End of log\n")
    with pytest.raises(TraceError, match=r"r.csv:2002: 1 cells instead of 4; correct or delete that row"):
        read_all(path)
    path.write_bytes(gzip.compress(content.encode())[:-20])
    with pytest.raises(TraceError, match=r"gzip data cut short.*; copy the recording again"):
        read_all(path)
    path.write_text(content.replace("\n0.", "\n10h00m0."))
    with pytest.raises(
        TraceError, match=r"'10h00m0.0', which is not a number; give the time as.* or as a date"
    ):
        read_all(path)


def test_faulty_rows_below_a_header_are_not_taken_for_lines_of_units(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text(text("time,acc_x,acc_y,acc_z", LONG[:, :4]).replace("\n0.0", "\nx"))
    with pytest.raises(TraceError, match=r"r.csv:2: column 'time' holds 'x', which is not a number"):
        read_all(path)


NAMES = "loopIteration,time (us)," + ",".join(f"{f}[{i}]" for f in ("gyroADC", "accSmooth") for i in range(3))


def blackbox(header: str, rate: float, force: float, digits: int | None = None) -> str:
    """A log as blackbox_decode writes it; rate, force: what 1 rad/s and 1 m/s^2 are in it, rounded."""
    values = np.column_stack([LONG[:, 4:] * rate, LONG[:, 1:4] * force]).round(digits or 0)
    times = np.round(LONG[:, 0] * 1e6).astype(int).tolist()
    kind = int if digits is None else float
    rows_ = zip(times, values, strict=True)
    lines = [",".join(map(str, [i, t, *map(kind, v), "ARM|ANGLE"])) for i, (t, v) in enumerate(rows_)]
    return "\n".join([header + ",flags", *lines]) + "\n"


COUNTS = blackbox(NAMES, DEGREES, 2048 / 9.80665)
EXPLORER = '"Product","Blackbox flight data recorder"\n"acc_1G",2048\n"gyroScale",1.7453292519943296e-8\n'
IN_UNITS = NAMES.replace("]", "] (g)").replace("] (g)", "] (deg/s)", 3)
HEADERS = "fieldname,fieldvalue\nacc_1G,2048\ngyro_scale,0x3f800000\nblackbox_high_resolution,1\n"


@pytest.mark.parametrize(
    ("table", "beside", "steps"),
    [
        (EXPLORER + COUNTS, "", (1 / DEGREES, 9.80665 / 2048)),
        (blackbox(NAMES, 10 * DEGREES, 2048 / 9.80665), HEADERS, (0.1 / DEGREES, 9.80665 / 2048)),
        (
            blackbox(IN_UNITS, DEGREES, 1 / 9.80665, 2),
            "",
            (0.01 / DEGREES, 0.01 * 9.80665),
        ),
    ],
)
def test_a_betaflight_log_is_read_in_the_unit_that_it_says(
    tmp_path: Path, table: str, beside: str, steps: tuple[float, float]
) -> None:
    path = tmp_path / "LOG00001.01.csv"
    path.write_text(table)
    if beside:
        with pytest.raises(TraceError, match=r"accSmooth\[0\] is in counts.*--save-headers"):
            read_all(path)
        (tmp_path / "LOG00001.01.headers.csv").write_text(beside)
    recording = read_all(path)
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.gyroscope.xyz, LONG[:, 4:], rtol=0, atol=0.501 * steps[0])
    np.testing.assert_allclose(recording.accelerometer.xyz, LONG[:, 1:4], rtol=0, atol=0.501 * steps[1])
    np.testing.assert_allclose(recording.accelerometer.t, LONG[:, 0], atol=1e-9)
    assert "takes its own offsets off" in recording.notes[0]


def test_standard_input_is_read_and_leaves_no_file(tmp_path: Path) -> None:
    code = (
        "import sys, tempfile, os; from stillcal.replay.formats.trace import read_all;"
        "n = len(read_all('-').accelerometer); print(n, os.listdir(tempfile.gettempdir()))"
    )
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    packed = gzip.compress(text("t,ax,ay,az,gx,gy,gz", rows()).encode())
    result = subprocess.run(
        [sys.executable, "-c", code], input=packed, capture_output=True, env=environment, check=True
    )
    assert result.stdout.split(b"\n")[0] == b"400 []"


@pytest.mark.parametrize("make", [npz, ros1_bag, dataflash_file])
def test_a_binary_log_is_read_from_a_pipe(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    content = make(tmp_path).read_bytes()
    with piped(content) as path:
        recording = read_all(path)
    assert len(recording.accelerometer) == len(DATA)
    assert f"copied into a temporary file first ({len(content) / 1e6:.3g} MB)" in recording.notes[0]


def test_a_pipe_of_nothing_known_is_refused_by_its_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "_room", lambda: 1 << 20)
    with piped(bytes(1 << 24)) as path, pytest.raises(TraceError, match="no binary format that is known"):
        read_all(path)


@contextmanager
def piped(content: bytes) -> Iterator[str]:
    """Give a pipe's name from which `content` can be read; whoever reads may leave earlier."""
    reading, writing = os.pipe()

    def write() -> None:
        with suppress(BrokenPipeError), os.fdopen(writing, "wb") as file:
            file.write(content)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        yield f"/dev/fd/{reading}"
    finally:
        os.close(reading)
        writer.join()


def test_a_named_pipe_is_read_though_its_writer_comes_late(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Timer(0.2, lambda: pipe.write_text(text("t,ax,ay,az", rows()[:, :4])))
    writer.start()
    assert len(read_all(pipe).accelerometer) == 400
    writer.join()


def test_a_pipe_without_writer_ends_in_a_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr(files, "FIRST_WRITER_S", 0.1)
    with pytest.raises(TraceError, match="nobody writes to this pipe"):
        read_all(tmp_path / "pipe")


def test_an_endless_pipe_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "MOST_SPOOLED", 1 << 20)
    endless = subprocess.Popen(["yes", "1,2,3,4"], stdout=subprocess.PIPE)
    assert endless.stdout is not None
    with pytest.raises(TraceError, match="gives more than"):
        read_all(f"/dev/fd/{endless.stdout.fileno()}")
    endless.kill()
    endless.wait()
    endless.stdout.close()


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null", "/dev/urandom"])
def test_devices_are_refused(device: str) -> None:
    with pytest.raises(TraceError, match="is a device, not a recording"):
        read_all(device)


def test_a_truncated_zip_and_one_with_a_huge_index_are_refused(tmp_path: Path) -> None:
    path = as_zip(tmp_path, phyphox_files())
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(TraceError, match="zip data cut short or damaged"):
        read_all(path)
    end = b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 60_000, 60_000, 10, 0, 0)
    path.write_bytes(b"PK\x03\x04" + end)
    with pytest.raises(TraceError, match="an archive of 60000 files"):
        read_all(path)


def test_a_zip_that_unpacks_to_very_much_is_refused_in_little_memory(tmp_path: Path) -> None:
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Accelerometer.csv", phyphox_files()["Accelerometer.csv"] + "1" * (1 << 26))
    (tmp_path / "bomb.zip").write_bytes(bomb.getvalue())
    with pytest.raises(TraceError, match="a line does not end"):
        read_all(tmp_path / "bomb.zip")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"%PDF-1.7\n", "a PDF document"),
        (b"\x28\xb5\x2f\xfd\0\0", "a zstd file.*unpack it"),
        (b"H Product:Blackbox flight data recorder", "Betaflight blackbox.*blackbox_decode --save-headers"),
        (b"\0\1\2\3" * 100, "no binary format that is known.*docs/formats.md"),
    ],
)
def test_other_files_are_named(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "r.csv").write_bytes(content)
    with pytest.raises(TraceError, match=said):
        read_all(tmp_path / "r.csv")


def test_a_part_is_cut_out_by_seconds_after_the_start(tmp_path: Path) -> None:
    data = rows()
    data[:, 0] += 1000
    path = tmp_path / "r.csv"
    path.write_text(text("t,ax,ay,az,gx,gy,gz", data))
    events = (
        '{"t": 1000.5, "event": "charging", "on": true}\n{"t": 1003.5, "event": "charging", "on": false}\n'
    )
    (tmp_path / "r.events.jsonl").write_text(events)
    part = read_all(path, start=1, stop=2)
    assert (part.accelerometer.t[0], part.accelerometer.t[-1]) == (1001.0, 1002.0)
    assert part.gyroscope is not None and len(part.gyroscope) == 101
    assert [(event.t, event.on) for event in part.events] == [(1001.0, True)]
    with pytest.raises(TraceError, match="from 10 s to the end there is no accelerometer sample"):
        read_all(path, start=10)


def test_the_gyroscopes_file_of_a_pair_names_the_other(tmp_path: Path) -> None:
    row = "{i},{i},{ns},0.1,0.2,9.8,a,nexus4,nexus4_1,stand"
    for name in ("accelerometer", "gyroscope"):
        lines = [row.format(i=i, ns=i * 10_000_000) for i in range(100)]
        (tmp_path / f"Phones_{name}.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(TraceError, match=r"gyroscope's file of a pair; give Phones_accelerometer.csv"):
        read_all(tmp_path / "Phones_gyroscope.csv")
    assert read_all(tmp_path / "Phones_accelerometer.csv").gyroscope is not None


@pytest.mark.parametrize("name", ["Gyroscope.csv", "GyroscopeUncalibrated.csv"])
def test_a_gyroscope_of_sensor_logger_alone_is_called_so(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(sensor_logger_files()["Gyroscope.csv"])
    with pytest.raises(TraceError, match=rf"{name}: holds the gyroscope alone; give TotalAcceleration"):
        read_all(tmp_path / name)


def test_a_gnss_logger_file_is_read_with_the_phones_own_bias(tmp_path: Path) -> None:
    recording = read_all(gnss_logger(tmp_path))
    assert len(recording.accelerometer) == 400
    assert recording.gyroscope is not None and recording.gyroscope.t[100] == 1.0
    assert any("gyroscope bias is 0.01 -0.02 0.03 rad/s" in note for note in recording.notes)
    assert read_all(gnss_logger(tmp_path), sensor="calibrated").gyroscope is None


def test_a_bad_row_of_a_gnss_logger_file_is_named(tmp_path: Path) -> None:
    path = gnss_logger(tmp_path)
    text = path.read_text().split("\n")
    row = next(i for i, line in enumerate(text) if line.startswith("UncalGyro")) + 300
    text[row] = "UncalGyro,1700000000000,abc,1,2,3,4,5,6"
    path.write_text("\n".join(text))
    with pytest.raises(TraceError, match=rf"gnss_log.txt:{row + 1}: the UncalGyro row is not like the first"):
        read_all(path)


def test_a_data_frame_of_other_columns_is_read_by_their_names() -> None:
    pandas = pytest.importorskip("pandas")
    data = rows(3000)
    names = ["timestamp", *(f"acc_{a}" for a in "xyz"), *(f"gyr_{a}" for a in "xyz")]
    frame = pandas.DataFrame(data * [1e6, *[1 / 9.80665] * 3, *[DEGREES] * 3], columns=names).assign(
        label="walk"
    )
    recording = stillcal.load(frame)
    np.testing.assert_allclose(recording.accelerometer.xyz, data[:, 1:4])
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.gyroscope.xyz, data[:, 4:])
    assert "in g (by the size of gravity)" in recording.notes[0]
    with pytest.raises(stillcal.UserError, match=r"no accelerometer found in its columns \(label\)"):
        stillcal.load(frame[["label"]])


def test_times_in_a_matrix_of_one_column_are_refused_with_both_shapes() -> None:
    with pytest.raises(
        TraceError, match=r"shape \(2000, 3\) and its time stamps \(2000, 1\); give \(n, 3\) and"
    ):
        stillcal.load(t=LONG[:, :1], accelerometer=LONG[:, 1:4])


def test_tables_with_dates_an_index_or_arrays_of_three_columns_are_read() -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(LONG, columns=OWN.split(","))
    start = 1767225600
    dates = pandas.to_datetime(np.round((LONG[:, 0] + start) * 1e3).astype(np.int64), unit="ms")
    unstamped = frame.drop(columns="t")
    tables = [
        (frame.set_index("t"), 0),
        (unstamped.set_index(dates), start),
        (frame.assign(t=dates.tz_localize("UTC")), start),
        (unstamped.assign(time=dates.astype(str)), start),
        ({"t": LONG[:, 0], "acc": LONG[:, 1:4], "gyroscope": LONG[:, 4:]}, 0),
        (unstamped.assign(time=pandas.to_timedelta(LONG[:, 0], unit="s")), 0),
    ]
    if importlib.util.find_spec("pyarrow"):
        tables.append((importlib.import_module("pyarrow").Table.from_pandas(frame), 0))
    for table, first in tables:
        recording = stillcal.load(table)
        np.testing.assert_allclose(recording.accelerometer.t - first, LONG[:, 0], atol=1e-6)
        np.testing.assert_array_equal(recording.accelerometer.xyz, LONG[:, 1:4])
        assert recording.gyroscope is not None
        np.testing.assert_array_equal(recording.gyroscope.xyz, LONG[:, 4:])
    part = stillcal.load(frame, start=5, stop=6.5)
    assert (part.accelerometer.t[0], part.accelerometer.t[-1]) == (5.0, 6.5)
    assert part.gyroscope is not None and len(part.gyroscope) == 151
    with pytest.raises(stillcal.UserError, match="from 30 s to the end there is 0 samples"):
        stillcal.load(frame, start=30)
    for unused in ({"t": LONG[:, 0]}, {"format": "csv"}):
        with pytest.raises(TypeError):
            stillcal.load(frame, **unused)


def test_a_rest_table_is_told_from_a_recording_without_time(tmp_path: Path) -> None:
    turned = "\n".join(f"{9.8 * np.cos(i)},{9.8 * np.sin(i)},0.1" for i in range(20))
    path = tmp_path / "table.csv"
    for header, lines, rests in (
        ("ax,ay,az", turned, True),
        ("ax,ay,az", "\n".join(["0.1,0.2,9.8"] * 20), False),
        ("date,ax,ay,az", "\n".join(f"{i},{row}" for i, row in enumerate(turned.split("\n"))), False),
        ("t,ax,ay,az", "\n".join(f"{i},{row}" for i, row in enumerate(turned.split("\n"))), False),
        ("n,t,ax,ay,az", "\n".join(f"100,{i},{row}" for i, row in enumerate(turned.split("\n"))), True),
        ("n,t,ax,ay,az", "\n".join(f"{i},{i / 100},0.1,0.2,9.8" for i in range(20)), False),
        ("duration,ax,ay,az", "\n".join(["10,0.1,0.2,9.8"] * 20), True),
    ):
        path.write_text(f"{header}\n{lines}\n")
        assert is_rest_table(path) == rests, header


@pytest.mark.parametrize(
    ("form", "start"),
    [
        ("2026-03-01 10:00:{:06.3f}", 1772359200.0),
        ("2026-03-01T10:00:{:09.6f}Z", 1772359200.0),
        ("2026-03-01T10:00:{:06.3f}+02:00", 1772352000.0),
    ],
)
def test_dates_are_read_as_seconds(tmp_path: Path, form: str, start: float) -> None:
    path = tmp_path / "r.csv"
    lines = [form.format(i / 50) + ",0.1,0.2,9.8,0.001,0,0" for i in range(500)]
    path.write_text("\n".join(["time,ax,ay,az,gx,gy,gz", *lines]))
    recording = read_all(path)
    np.testing.assert_allclose(recording.accelerometer.t - start, np.arange(500) / 50, atol=1e-6)
    np.testing.assert_array_equal(recording.gyroscope.xyz[7], [0.001, 0, 0])
    for bad, said in (("yesterday", "not a date"), ("2026-02-30 10:00:00", "not a date"), ("", "is empty")):
        lines[300] = f"{bad},0.1,0.2,9.8,0.001,0,0"
        path.write_text("\n".join(["time,ax,ay,az,gx,gy,gz", *lines]))
        with pytest.raises(TraceError, match=rf"r.csv:302: column 'time' .*{said}"):
            read_all(path)


@pytest.mark.parametrize(("text", "kind"), [("<html>", "HTML or XML"), ("<?xml", "HTML or XML")])
def test_other_texts_are_named(tmp_path: Path, text: str, kind: str) -> None:
    (tmp_path / "r.txt").write_text(text)
    with pytest.raises(TraceError, match=f"is {kind}, not a recording"):
        read_all(tmp_path / "r.txt")


def test_every_kind_of_file_has_a_reader_that_the_documentation_names() -> None:
    told = (Path(__file__).parents[3] / "docs" / "formats.md").read_text()
    assert set(READERS) == {*magic.STARTS.values(), magic.JSON, magic.ECHO, magic.TEXT}
    assert [kind for kind in READERS if kind not in told] == []
