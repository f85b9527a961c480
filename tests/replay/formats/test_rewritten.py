"""Text whose lines hold readings, but not as cells."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.rewriting import rewritten
from stillcal.replay.formats.trace import open_trace, read_all

N = 60
RNG = np.random.default_rng(4)
FORCE = np.round(RNG.normal([0.2, 0.1, 9.8], 0.05, (N, 3)), 4)
RATES = np.round(RNG.normal(0, 0.05, (N, 3)), 4)
MS = np.arange(N) * 10 + 1000

LABELLED = {
    "blanks": "t: {t} ax: {a[0]} ay: {a[1]} az: {a[2]} gx: {w[0]} gy: {w[1]} gz: {w[2]}",
    "commas": "t={t}, ax={a[0]}, ay={a[1]}, az={a[2]}, gx={w[0]}, gy={w[1]}, gz={w[2]}",
    "units": "time: {t} ms Acc X: {a[0]} m/s^2 Acc Y: {a[1]} m/s^2 Acc Z: {a[2]} m/s^2 "
    "Gyro X: {w[0]} rad/s Gyro Y: {w[1]} rad/s Gyro Z: {w[2]} rad/s",
    "a time before": "{t} ax: {a[0]} ay: {a[1]} az: {a[2]} gx: {w[0]} gy: {w[1]} gz: {w[2]}",
    "a time before, with a colon": "{t}: |Acc X:{a[0]}, Acc Y:{a[1]}, Acc Z:{a[2]} "
    "|Gyr X:{w[0]}, Gyr Y:{w[1]}, Gyr Z:{w[2]} |Mag X:0.1, Mag Y:0.2, Mag Z:0.3",
    "a thermometer between": "t = {t} | AcX = {a[0]} | AcY = {a[1]} | AcZ = {a[2]} | Tmp = 25.1 "
    "| GyX = {w[0]} | GyY = {w[1]} | GyZ = {w[2]}",
    "a title for three": "t: {t} | Accel: X={a[0]}, Y={a[1]}, Z={a[2]} | Gyro: X={w[0]}, Y={w[1]}, Z={w[2]}",
    "a title and a unit for three": "t: {t} Acc X: {a[0]} Y: {a[1]} Z: {a[2]} m/s^2 "
    "Gyr X: {w[0]} Y: {w[1]} Z: {w[2]} rad/s",
    "two lines": "{t} Acceleration X: {a[0]}, Y: {a[1]}, Z: {a[2]} m/s^2\n"
    "{t} Rotation X: {w[0]}, Y: {w[1]}, Z: {w[2]} rad/s\nTemperature: 29.87 degC\n",
    "a monitor's stamp": "10:00:0{s:.3f} -> ax:{a[0]} ay:{a[1]} az:{a[2]} gx:{w[0]} gy:{w[1]} gz:{w[2]}",
}
IN_CELLS = {
    "a monitor's stamp": ("", "10:00:0{s:.3f} -> {a[0]},{a[1]},{a[2]},{w[0]},{w[1]},{w[2]}"),
    "its header stamped": (
        "10:00:00.900 -> ax,ay,az,gx,gy,gz\n",
        "10:00:0{s:.3f} -> {a[0]},{a[1]},{a[2]},{w[0]},{w[1]},{w[2]}",
    ),
    "lists": ("time_ms,acc,gyr\n", '{t},"[{a[0]}, {a[1]}, {a[2]}]","[{w[0]}, {w[1]}, {w[2]}]"'),
    "lists of blanks": (
        "time_ms,accelerometer,gyroscope\n",
        "{t},[{a[0]}  {a[1]} {a[2]}],[ {w[0]} {w[1]} {w[2]}]",
    ),
    "tuples": (
        "time_ms;note;acc (m/s²);gyr (rad/s)\n",
        "{t};-;({a[0]}, {a[1]}, {a[2]});({w[0]}, {w[1]}, {w[2]})",
    ),
    "semicolons behind blanks": ("", "{t} {a[0]} {a[1]} {a[2]} {w[0]} {w[1]} {w[2]};"),
    "semicolons at the ends": (
        "time_ms,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z;\n",
        "{t},{a[0]},{a[1]},{a[2]},{w[0]},{w[1]},{w[2]};",
    ),
}


def lines(line: str) -> list[str]:
    rows = zip(MS, FORCE, RATES, strict=True)
    return [line.format(t=t, s=t / 1000, a=a, w=w) for t, a, w in rows]


def assert_read(path: Path) -> None:
    recording = read_all(path)
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.gyroscope.xyz, RATES)
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 0.01, atol=1e-6)


@pytest.mark.parametrize("line", LABELLED.values(), ids=LABELLED)
def test_names_before_each_number(tmp_path: Path, line: str) -> None:
    path = tmp_path / "r.txt"
    path.write_text("MPU6050 ready\n\n" + "\n".join(lines(line)) + "\n")
    assert_read(path)


@pytest.mark.parametrize(("header", "line"), IN_CELLS.values(), ids=IN_CELLS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_lists_stamps_and_ends(tmp_path: Path, header: str, line: str, encoding: str) -> None:
    path = tmp_path / "r.csv"
    path.write_text(header + "\n".join(lines(line)) + "\n", encoding=encoding)
    assert_read(path)


GROUPED = {
    "quoted": (",", '"{:,.3f}"', None),
    "quoted where long": (",", "{:,.3f}", None),
    "German": (";", "{:,.3f}", str.maketrans(",.", ".,")),
    "French": (";", "{:,.3f}", str.maketrans(",.", "\u00a0,")),
    "Swiss": ("\t", "{:,.3f}", str.maketrans(",", "'")),
    "English, tabs": ("\t", "{:,.3f}", None),
}


@pytest.mark.parametrize(("mark", "cell", "as_written"), GROUPED.values(), ids=GROUPED)
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_marks_between_thousands(
    tmp_path: Path, mark: str, cell: str, as_written: dict[int, int] | None, encoding: str
) -> None:
    milli = np.column_stack([MS, FORCE / 9.80665e-3])
    table = [[cell.format(value).translate(as_written or {}) for value in row] for row in milli]
    quoted = [[f'"{c}"' if mark in c and '"' not in c else c for c in row] for row in table]
    path = tmp_path / "r.csv"
    text = "\n".join(map(mark.join, [["time_ms", "ax_mg", "ay_mg", "az_mg"], *quoted])) + "\n"
    path.write_bytes(text.encode(encoding))
    recording = read_all(path)
    np.testing.assert_allclose(recording.accelerometer.xyz, FORCE, atol=1e-5)
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 0.01, atol=1e-6)


@pytest.mark.parametrize(
    ("date", "unit", "per_si", "cell", "mark"),
    [
        ("%Y-%m-%d %H:%M:%S.%f", "ug", 1e6 / 9.80665, "{:,.0f}", ","),  # twice in a number
        ("%Y-%m-%d %H:%M:%S.%f", "mg", 1e3 / 9.80665, "{:,.0f}", "\u202f"),
        ("%d.%m.%Y %H:%M:%S,%f", "mg", 1e3 / 9.80665, "{:,.3f}", "."),
    ],
)
def test_marks_between_whole_thousands_and_beside_dates(
    tmp_path: Path, date: str, unit: str, per_si: float, cell: str, mark: str
) -> None:
    in_german = str.maketrans({",": mark, ".": ","})
    dates = [(datetime(2026, 3, 1) + timedelta(milliseconds=int(t))).strftime(date) for t in MS]
    rows = [
        [d, *(cell.format(v * per_si).translate(in_german) for v in a)]
        for d, a in zip(dates, FORCE, strict=True)
    ]
    path = tmp_path / "r.csv"
    path.write_text("\n".join(map(";".join, [["time", *(f"a{x} [{unit}]" for x in "xyz")], *rows])) + "\n")
    np.testing.assert_allclose(read_all(path).accelerometer.xyz, FORCE, atol=0.01)


def test_a_carriage_return_within_a_line_is_no_end_of_it(tmp_path: Path) -> None:
    rows = [",".join(map(str, (t, *a))) for t, a in zip(MS, FORCE, strict=True)]
    path = tmp_path / "r.csv"
    path.write_bytes("\n".join(["log\rof a walk", "time_ms,ax,ay,az", *rows]).encode() + b"\n")
    np.testing.assert_array_equal(read_all(path).accelerometer.xyz, FORCE)


@pytest.mark.parametrize(
    ("header", "time"),
    [
        ("time_ms", "{t}"),
        ("time_s", "{s:.2f}"),
        ("date;time", "01.03.2026;10:00:0{s:.3f}"),
        ("Firmware;1.2\ntime_ms", "{t}"),
        ("fs;50.0;;\ntime_ms", "{t}"),
    ],
)
def test_commas_that_may_be_decimal_marks_stay(tmp_path: Path, header: str, time: str) -> None:
    force = FORCE + np.array([2, 2, 0])  # so that no number begins with 0
    rows = [
        [time.format(t=t, s=t / 1000), *(f"{v:.3f}".replace(".", ",") for v in a)]
        for t, a in zip(MS, force, strict=True)
    ]
    path = tmp_path / "r.csv"
    path.write_text(f"{header};ax;ay;az\n" + "\n".join(map(";".join, rows)) + "\n")
    np.testing.assert_allclose(read_all(path).accelerometer.xyz, force, atol=6e-4)


def test_a_quoted_comma_beside_decimal_points_stands_between_thousands(tmp_path: Path) -> None:
    milli = np.round(FORCE / 9.80665e-3)
    rows = [f'{t / 1000:.2f},{x:.0f},{y:.0f},"{z:,.0f}"' for t, (x, y, z) in zip(MS, milli, strict=True)]
    path = tmp_path / "r.csv"
    path.write_text("\n".join(["time_s,ax_mg,ay_mg,az_mg", *rows]) + "\n")
    np.testing.assert_allclose(read_all(path).accelerometer.xyz, FORCE, atol=0.01)


def test_marks_between_thousands_may_come_after_many_rows_without(tmp_path: Path) -> None:
    heights = ["998"] * 300 + ["1\u202f006"] * 100
    table = "".join(f"{10 * i};{i % 7};20;{z}\n" for i, z in enumerate(heights))
    path = tmp_path / "r.csv"
    path.write_text(f"time_ms;ax_mg;ay_mg;az_mg\n{table}")
    assert read_all(path).accelerometer.xyz[-1, 2] == pytest.approx(1.006 * 9.80665)


def test_a_plain_table_is_recognised_by_its_first_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That no number has marks between thousands is seen there; all lines would take longer than the rest."""
    split: list[str] = []

    def counted(line: str, delimiter: str) -> list[str]:
        split.append(line)
        return line.split(delimiter)

    monkeypatch.setattr(rewritten, "quoted_cells", counted)
    path = tmp_path / "r.csv"
    path.write_text("t,ax,ay,az\n" + "".join(f"{i / 100},0.125,0.25,9.8{i % 10}\n" for i in range(1000)))
    open_trace(path)
    assert 0 < len(split) <= 50


def test_decimal_commas_of_few_different_values_are_no_names_of_devices(tmp_path: Path) -> None:
    force = np.round(FORCE / 9.80665, 2)
    rows = [[f"{t}", *(f"{v:.2f}".replace(".", ",") for v in a)] for t, a in zip(MS, force, strict=True)]
    path = tmp_path / "r.csv"
    path.write_text("time_ms;ax [g];ay [g];az [g]\n" + "\n".join(map(";".join, rows)) + "\n")
    np.testing.assert_allclose(read_all(path).accelerometer.xyz, force * 9.80665)


def test_a_first_row_of_whole_numbers_says_nothing_of_decimal_commas(tmp_path: Path) -> None:
    rows = [
        ";".join(f"{v:.4f}".replace(".", ",") for v in (t / 1000, *a)) for t, a in zip(MS, FORCE, strict=True)
    ]
    path = tmp_path / "r.csv"
    path.write_text("\n".join(["t (s);ax;ay;az", "0;0;0;10", *rows]) + "\n")
    np.testing.assert_array_equal(read_all(path).accelerometer.xyz[1:], FORCE)


def test_whole_thousands_among_other_numbers_are_not_taken_for_decimals(tmp_path: Path) -> None:
    table = "t,acc_x,acc_y,acc_z\n" + "".join(
        f"{i / 100},0.5,1.5,{c}\n" for i, c in enumerate(["998"] * 9000 + ['"1,006"'] * 10)
    )
    path = tmp_path / "r.csv"
    path.write_text(table)
    with pytest.raises(TraceError, match=r"r.csv:9002: column 'acc_z' holds '1 006', which is not a number"):
        read_all(path)


def test_a_faulty_line_is_named_as_it_stands_in_the_file(tmp_path: Path) -> None:
    rows = lines(LABELLED["blanks"])
    path = tmp_path / "r.txt"
    path.write_text("\n".join(["ready", *rows[:40], "t: 5 ax: 0.1", *rows[40:]]) + "\n")
    with pytest.raises(TraceError, match=r"r\.txt:42: 1 cells instead of 7"):
        read_all(path)
    path.write_text("time_ms,acc\n" + "\n".join(f'{t},"[1, 2, 9]"' for t in MS) + '\n1600,"[1, 2]"\n')
    with pytest.raises(TraceError, match=r"r\.txt:62: 3 cells instead of 4"):
        read_all(path)


def test_a_board_s_settings_are_no_row(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    rows = "\n".join(f"{t},{x},{y},{z}" for t, (x, y, z) in zip(MS, FORCE, strict=True))
    path.write_text(f"odr=100, range=8, gain=2\ntime_ms,acc_x,acc_y,acc_z\n{rows}\n")
    np.testing.assert_array_equal(read_all(path).accelerometer.xyz, FORCE)


def summed(sentence: str) -> str:
    """Return a sentence as NMEA 0183 frames it."""
    check = 0
    for letter in sentence:
        check ^= ord(letter)
    return f"${sentence}*{check:02X}"


GPS = summed("GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,")
SENTENCES = {
    "VectorNav's among others": (
        "",
        lambda t, a, w: f"{t},{summed(f'VNYMR,+010.1,-002.2,+003.3,+0.1,+0.2,-0.3,{a},{w}')}\n{GPS}",
    ),
    "with a check sum": ("", lambda t, a, w: summed(f"IMU,{t},{a},{w}")),
    "with a header": ("$IMU,time_ms,ax,ay,az,gx,gy,gz\n", lambda t, a, w: f"$IMU,{t},{a},{w}\n$BAT,{t},3.9"),
    "without the dollar": ("boot 1.2\n", lambda t, a, w: f"IMU,{t},{a},{w}\nGPS,{t},52.1,0.1"),
    "ArduPilot's": (
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
        "FMT, 135, 39, IMU, QBffffff, TimeUS,I,AccX,AccY,AccZ,GyrX,GyrY,GyrZ\n"
        + "PARM, 1, A_B, 0.5\n"
        * 3000,
        lambda t, a, w: (
            f"IMU, {t * 1000}, 0, {a}, {w}\nIMU, {t * 1000}, 1, 0.1,0.2,9.7, {w}\nBARO, {t * 1000}, 1.2"
        ),
    ),
}


@pytest.mark.parametrize(("before", "line"), SENTENCES.values(), ids=SENTENCES)
def test_lines_that_begin_with_their_kind(
    tmp_path: Path, before: str, line: Callable[[int, str, str], str]
) -> None:
    def cells(xyz: np.ndarray) -> str:
        return ",".join(map(repr, xyz.tolist()))

    rows = [line(int(t), cells(a), cells(w)) for t, a, w in zip(MS, FORCE, RATES, strict=True)]
    path = tmp_path / "r.log"
    path.write_text(before + "\n".join(rows) + "\n")
    assert_read(path)
    assert read_all(path).notes[0].startswith("r.log: lines of ")


def test_described_lines_that_are_not_there_are_refused(tmp_path: Path) -> None:
    described, *parameters = SENTENCES["ArduPilot's"][0].split("\n", 2)[1:]
    (tmp_path / "r.log").write_text("\n".join([described, "boot 1.2", described, *parameters]))
    with pytest.raises(TraceError, match=r"none of the first rows has 8 cells"):
        read_all(tmp_path / "r.log")


def test_lines_of_two_devices_are_not_read_as_one(tmp_path: Path) -> None:
    rows = [f"IMU{i % 2},{t},{a[0]},{a[1]},{a[2]}" for i, (t, a) in enumerate(zip(MS, FORCE, strict=True))]
    (tmp_path / "r.csv").write_text("\n".join(rows))
    with pytest.raises(TraceError, match="rows of several devices in turn"):
        read_all(tmp_path / "r.csv")
