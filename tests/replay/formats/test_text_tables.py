"""Text tables as other people's tools write them: preambles, encodings, line ends, dates and times of day."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.tables import text as text_module
from stillcal.replay.formats.tables.dates import Dates, is_date
from stillcal.replay.formats.trace import Recording, read_all
from tests.support.log_files import DATA, text

NAMES = "time,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z"
TABLE = text(NAMES, DATA)
ACTIGRAPH = """\
------------ Data File Created By ActiGraph GT3X+ ActiLife v6.13.3 Firmware v2.5.0 \
date format M/d/yyyy at 100 Hz  Filter Normal -----------
Serial Number: NEO1F00000000
Start Time 10:00:00
Start Date 8/5/2021
Epoch Period (hh:mm:ss) 00:00:00
Download Time 12:00:00
Download Date 8/6/2021
Current Memory Address: 0
Current Battery Voltage: 4.07     Mode = 12
--------------------------------------------------
"""


def read(folder: Path, content: str | bytes) -> Recording:
    path = folder / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_all(path)


def assert_read(recording: Recording, *, within: float = 1e-6) -> None:
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz, DATA[:, 1:4], rtol=1e-9)
    np.testing.assert_allclose(recording.gyroscope.xyz, DATA[:, 4:], rtol=1e-9)
    t = recording.accelerometer.t
    np.testing.assert_allclose(t - t[0], DATA[:, 0], atol=within)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-8-sig"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(
    "table", [TABLE, TABLE.replace("time", "t").replace("acc_", "a").replace("gyr_", "g")]
)
def test_every_encoding_and_line_end_is_read(
    tmp_path: Path, table: str, encoding: str, line_end: str
) -> None:
    mark = "\ufeff" if encoding == "utf-16-le" else ""
    assert_read(read(tmp_path, (mark + table).replace("\n", line_end).encode(encoding)))


def test_utf_16_that_breaks_off_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=r"is no whole text in UTF-16.*save it as UTF-8"):
        read(tmp_path, TABLE.encode("utf-16")[:-1])


@pytest.mark.parametrize(
    "changed",
    [
        TABLE.replace("\n", ",\n"),
        TABLE.replace("\n", ",\n").replace("gyr_z,", "gyr_z"),
        TABLE.replace("gyr_z", "gyr_z,"),
        "logger 3\nwith a story\n" + TABLE.replace("\n", ",\n").replace("gyr_z,", "gyr_z"),
    ],
)
def test_a_delimiter_behind_the_last_cell_does_not_count(tmp_path: Path, changed: str) -> None:
    assert_read(read(tmp_path, changed))


def test_a_row_with_one_cell_too_many_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=r"log.csv:2: 8 cells instead of 7"):
        read(tmp_path, TABLE.replace("\n", ",1\n").replace("gyr_z,1", "gyr_z"))


@pytest.mark.parametrize("header", ["Accelerometer X,Accelerometer Y,Accelerometer Z", None])
def test_actigraphs_raw_data_are_read_at_the_rate_that_it_states(tmp_path: Path, header: str | None) -> None:
    rows = text("", DATA[:, 1:4] / 9.80665).lstrip("\n")
    recording = read(tmp_path, ACTIGRAPH + (f"{header}\n" if header else "") + rows)
    np.testing.assert_allclose(recording.accelerometer.xyz, DATA[:, 1:4], rtol=1e-9)
    np.testing.assert_allclose(recording.accelerometer.t, DATA[:, 0], atol=1e-9)
    assert any("100 Hz as stated" in note for note in recording.notes)


@pytest.mark.parametrize("lines", ["Update Rate: 100.0Hz\n", "Low-pass cutoff at 40 Hz\nODR = 100 Hz\n"])
def test_a_rate_stated_before_the_table_is_taken(tmp_path: Path, lines: str) -> None:
    table = text(NAMES.replace("time", "PacketCounter"), np.column_stack([np.arange(600), DATA[:, 1:]]))
    assert_read(read(tmp_path, f"// facts\n{lines}{table}"))


@pytest.mark.parametrize("lines", ["accel rate: 100 Hz\ngyro rate: 200 Hz\n", "cutoff at 40 Hz\n", ""])
def test_without_one_stated_rate_there_is_no_time(tmp_path: Path, lines: str) -> None:
    table = text(NAMES.replace("time", "PacketCounter"), np.column_stack([np.arange(600), DATA[:, 1:]]))
    with pytest.raises(TraceError, match="no column of time stamps"):
        read(tmp_path, f"// facts\n{lines}{table}")


@pytest.mark.parametrize(
    "lines",
    [
        "# Created on a Monday",
        "MPU6050 found!\n\nrange: 4 g",
        "#STANDING\n#2015\n@DATA",
        "# a, b, c, d, e, f, g",
    ],
)
@pytest.mark.parametrize("mark", [",", " ", "\t"])
def test_facts_before_a_table_without_a_header_are_none(tmp_path: Path, lines: str, mark: str) -> None:
    assert_read(read(tmp_path, text(lines, DATA, mark)))


PARTS = {
    "the sensor once": "time,Accelerometer,,,Gyroscope,,\ns,X,Y,Z,X,Y,Z",
    "with units": "time,acc,,,gyr,,\n,x,y,z,x,y,z\n[ms],[g],[g],[g],[deg/s],[deg/s],[deg/s]",
    "the sensor always": ",acc,acc,acc,gyr,gyr,gyr\n,x,y,z,x,y,z",
    "with the index's name": ",acc,acc,acc,gyr,gyr,gyr\n,x,y,z,x,y,z\ntime,,,,,,",
}


@pytest.mark.parametrize("header", PARTS.values(), ids=PARTS)
def test_names_may_stand_in_two_lines(tmp_path: Path, header: str) -> None:
    table = DATA / [1e-3, *[9.80665] * 3, *np.radians([1.0] * 3)] if "ms" in header else DATA
    assert_read(read(tmp_path, text(f"facts\n{header}", table)))


def test_titles_before_axes_that_come_again_are_theirs(tmp_path: Path) -> None:
    """Such a header is written by a script that is often used for ROS bags (bag_to_csv)."""
    header = "stamp,secs,nsecs,frame,orientation,x,y,z,w,angular_velocity,x,y,z,linear_acceleration,x,y,z"
    rows = (
        f",{17 + int(t)},{round(t % 1 * 1e9)},imu,,0,0,0,1,,{gyr},,{acc}"
        for t, *values in DATA.tolist()
        for acc, gyr in [[",".join(map(repr, half)) for half in (values[:3], values[3:])]]
    )
    assert_read(read(tmp_path, "\n".join([header, *rows, ""])))


def test_gyroflows_log_is_read_by_the_scales_that_it_states(tmp_path: Path) -> None:
    facts = (
        "GYROFLOW IMU LOG\nversion,1.3\nid,7\norientation,YxZ\ntscale,0.001\ngscale,0.001\nascale,0.0005\n"
    )
    counts = DATA[:, [0, 4, 5, 6, 1, 2, 3]] / [1e-3, *[1e-3] * 3, *[5e-4 * 9.80665] * 3]
    assert_read(read(tmp_path, facts + text("t,gx,gy,gz,ax,ay,az", counts)))
    with pytest.raises(TraceError, match="time stamps step by"):
        read(tmp_path, facts.replace("ascale", "note") + text("t,gx,gy,gz,ax,ay,az", counts))


def test_quoted_names_may_hold_the_delimiter(tmp_path: Path) -> None:
    header = NAMES.replace("time", '"Date Time, GMT-04:00"')
    rows = (f"2024-03-05 10:11:{12 + t:09.6f}," + ",".join(map(repr, values)) for t, *values in DATA.tolist())
    assert_read(read(tmp_path, "\n".join(['"Plot Title: 7"', header, *rows, ""])))


def test_lines_that_describe_rows_of_several_kinds_are_no_header(tmp_path: Path) -> None:
    facts = "% ACCE;time(s);Acc_X(m/s^2);Acc_Y(m/s^2);Acc_Z(m/s^2)\n% GYRO;time(s);Gyr_X;Gyr_Y;Gyr_Z"
    rows = (
        f"{kind};{t!r};{';'.join(map(repr, xyz))}"
        for t, *values in DATA.tolist()
        for kind, xyz in (("ACCE", values[:3]), ("GYRO", values[3:]))
    )
    assert_read(read(tmp_path, "\n".join([facts, *rows, ""])))


START = datetime(2021, 8, 25, 23, 59, 57)


def stamped(clock: Callable[[datetime], str]) -> str:
    rows = [
        ",".join([clock(START + timedelta(seconds=round(row[0], 6))), *map(repr, row[1:])])
        for row in DATA.tolist()
    ]
    return "\n".join([NAMES, *rows]) + "\n"


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("%H:%M:%S.%f", "in times of day"),
        ("%H:%M:%S:%f", "in times of day"),
        ("%I:%M:%S.%f %p", "in times of day"),
        ("%M:%S.%f", "in minutes and seconds"),
        ("%d.%m.%Y %H:%M:%S.%f", "in dates;"),
        ("%m/%d/%Y %I:%M:%S.%f %p", "in dates, the month first"),
        ("%d/%m/%Y %H:%M:%S.%f", "in dates;"),
        ("%Y/%m/%d %H:%M:%S.%f", "in dates;"),
        ("%d-%b-%Y %H:%M:%S.%f", "in dates;"),
        ("%d.%m.%y %H:%M:%S.%f", "in dates;"),
        ("%m/%d/%y %I:%M:%S.%f %p", "in dates, the month first"),
        ("%Y-%m-%dT%H:%M:%S.%fZ", "in dates;"),
        ('"%Y-%m-%d %H:%M:%S,%f"', "in dates;"),
    ],
)
def test_dates_and_times_of_day_go_on_past_midnight(tmp_path: Path, pattern: str, said: str) -> None:
    recording = read(tmp_path, stamped(lambda moment: moment.strftime(pattern)))
    assert_read(recording)
    assert any(said in note for note in recording.notes)


def test_milliseconds_behind_a_colon_are_counted(tmp_path: Path) -> None:
    """10:0:9:5 is 5 ms after 10:00:09; it was read as half a second."""

    def clock(at: datetime) -> str:
        return f"{at.hour}:{at.minute}:{at.second}:{at.microsecond // 1000}"

    assert_read(read(tmp_path, stamped(clock)))


def test_times_of_day_go_on_from_block_to_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_module, "BLOCK_BYTES", 4096)
    assert_read(read(tmp_path, stamped(lambda moment: moment.strftime("%H:%M:%S.%f"))))


def test_times_of_day_run_on_from_day_to_day() -> None:
    clock = Dates(b"12:00:00")
    np.testing.assert_allclose(clock.seconds([b"12:00:00", b"23:59:59", b"00:00:01"]), [43200, 86399, 86401])
    np.testing.assert_allclose(clock.seconds([b"20:00:00", b"04:00:00"]), [158400, 187200])


@pytest.mark.parametrize(
    "cell", ["24:00:00", "12:60:00", "13:00:00 PM", "05:01", "31.2.2021 10:00:00", "1:2"]
)
def test_what_is_no_time_is_none(cell: str) -> None:
    assert not is_date(cell.encode())


@pytest.mark.parametrize("above", ["", "# logger 3\n# 100 Hz\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_headers_of_joined_logs_are_passed_over_and_said_once(tmp_path: Path, above: str, mark: str) -> None:
    header, *lines = TABLE.splitlines()
    top = mark + above + header
    joined = [top, *lines[:300], top, *lines[300:302], top, *lines[302:]]
    recording = read(tmp_path, "\n".join(joined))
    np.testing.assert_array_equal(recording.accelerometer.xyz, DATA[:, 1:4])
    first, count = len(f"{above}{header}".splitlines()) + 301, 2 * len(f"{above}{header}".splitlines())
    (said,) = [note for note in recording.notes if "passed over" in note]
    assert f"{count} lines repeat the header" in said and f"first line {first})" in said


def test_the_line_of_a_faulty_row_counts_the_headers_before_it(tmp_path: Path) -> None:
    header, *lines = TABLE.splitlines()
    with pytest.raises(TraceError, match=r"log\.csv:604: column 'acc_x' holds 'oops'"):
        read(tmp_path, "\n".join([header, *lines[:300], header, *lines[300:], header, "9,oops,0,9.8,0,0,0"]))


def test_a_header_of_other_columns_within_a_table_is_refused(tmp_path: Path) -> None:
    header, *lines = TABLE.splitlines()
    other = header.replace("acc_x,acc_y", "acc_y,acc_x")
    with pytest.raises(TraceError, match=r"log\.csv:302: column 'time' holds 'time', which is not a number"):
        read(tmp_path, "\n".join([header, *lines[:300], other, *lines[300:]]))
