"""Column maps: the formats known by name, and maps that a user writes, on logs made here."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.diagnosis.condense import read_condensed
from stillcal.replay.formats.columns import builtin_formats, load_map, parse_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import open_trace, read_all

OWN = """
[time]
column = "time"
[accelerometer]
columns = ["x", "y", "z"]
unit = "m/s^2"
"""


def own_map(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text)
    return path


PAGE = (Path(__file__).parents[3] / "docs" / "formats.md").read_text()


def table(path: Path, header: str, rows: int, line: str) -> Path:
    """Write a log whose line i is `line` with {i} and {s} (i hundredths of a second) filled in."""
    head = header + "\n" if header else ""
    path.write_text(head + "".join(line.format(i=i, s=f"{i / 100:.2f}") + "\n" for i in range(rows)))
    return path


def test_the_formats_of_the_contract_are_there_and_valid() -> None:
    contract = {"csv", "hhar", "imu_tk", "imucal", "mikoff", "phyphox", "sensorlogger"}
    assert contract <= set(builtin_formats())


def test_the_table_of_formats_in_the_docs_has_their_descriptions() -> None:
    rows = [f"| `{name}` | {load_map(name).description} |" for name in builtin_formats()]
    assert "| `--format` | what |\n|---|---|\n" + "\n".join(rows) + "\n\n" in PAGE


def test_the_map_printed_in_the_docs_is_valid() -> None:
    example = PAGE.split("```toml\n")[1].split("```")[0]
    assert parse_map(example.encode(), Path("example.toml")).time.unit == "ms"


def test_an_unknown_format_names_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(
        TraceError, match=r"no such format; name one of .*csv, empatica, hhar, imu_tk.*, rest, or the path"
    ):
        open_trace(tmp_path / "r.csv", "hharr")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[time", "not TOML"),
        (OWN.replace('column = "time"', ""), "rate_hz is needed"),
        (OWN.replace('column = "time"', "rate_hz = 0.0"), "rate_hz"),
        (OWN + "sings = [1, 1, -1]", "unknown field `sings`"),
        (OWN + "signs = [1, 1, 2]", "Invalid enum value 2"),
        (OWN + "counts_per_unit = 400.0", "goes with unit 'counts'"),
        (OWN.replace("m/s^2", "deg/s"), "a unit of rate"),
        (OWN.replace("m/s^2", "m/s2"), "Invalid enum value 'm/s2'"),
        ("header = false\n" + OWN, "columns are numbers"),
        ('delimiter = "ab"\n' + OWN, "delimiter"),
        (OWN + "[select]\ncolumns = ['a']\nvalues = ['1', '2']", "as many values as columns"),
        (OWN + "[gyroscope]\ncolumns = [1, 2, 3]\nunit = 'g'", "a unit of acceleration"),
    ],
)
def test_a_bad_map_says_what_is_wrong_with_it(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TraceError, match=said) as caught:
        open_trace(tmp_path / "r.csv", own_map(tmp_path, text))
    assert caught.value.file == tmp_path / "own.toml"


def test_units_signs_axes_and_a_thermometer_in_kelvin(tmp_path: Path) -> None:
    path = table(
        tmp_path / "r.txt",
        "# made by hand\nms;up;left;out;p;q;r;T;when",
        50,
        "{i}0;1000;10;20;90;0;-180;300.15;{i}1",
    )
    text = """
        delimiter = ";"
        skip_lines = 1
        [time]
        column = "ms"
        unit = "ms"
        arrival = "when"
        arrival_unit = "ms"
        [accelerometer]
        columns = ["left", "up", "out"]
        signs = [-1, 1, 1]
        unit = "mg"
        [gyroscope]
        columns = ["p", "q", "r"]
        unit = "deg/s"
        [temperature]
        column = "T"
        unit = "K"
    """
    recording = read_all(path, own_map(tmp_path, text))
    samples = recording.accelerometer
    assert recording.gyroscope is not None and samples.temperature is not None
    np.testing.assert_allclose(samples.t, np.arange(50) / 100)
    np.testing.assert_allclose(samples.xyz[7], [-0.0980665, 9.80665, 0.196133])
    np.testing.assert_allclose(recording.gyroscope.xyz[7], [np.pi / 2, 0, -np.pi])
    np.testing.assert_allclose(samples.temperature, 27.0)
    assert samples.t_arrival is not None
    np.testing.assert_allclose(samples.t_arrival[7], 0.071)


def test_quoted_cells_with_delimiters_in_them(tmp_path: Path) -> None:
    path = table(tmp_path / "r.csv", 'note,time,x,y,"z"', 30, '"walk, run",{s},"0","0",9.8')
    np.testing.assert_allclose(read_all(path, own_map(tmp_path, OWN)).accelerometer.xyz[4], [0, 0, 9.8])


@pytest.mark.parametrize(("mark", "decimal"), [(",", "."), (";", "."), ("\t", "."), (";", ","), ("\t", ",")])
def test_phyphox_in_each_of_its_exports(tmp_path: Path, mark: str, decimal: str) -> None:
    def export(name: str, quantity: str, values: list[str]) -> Path:
        names = ["Time (s)", *(quantity.format(axis) for axis in "xyz"), "Absolute"]
        cells = mark.join(["{s}E0", *values, "1.0"])
        path = table(tmp_path / name, mark.join(f'"{n}"' for n in names), 60, cells)
        head, body = path.read_text().split("\n", 1)
        path.write_text(head + "\n" + body.replace(".", decimal))
        return path

    path = export("Accelerometer.csv", "Acceleration {} (m/s^2)", ["1.5E-1", "-2.0E-1", "9.81E0"])
    export("Gyroscope.csv", "Gyroscope {} (rad/s)", ["1.0E-3", "2.0E-3", "3.0E-3"])
    recording = read_all(path, "phyphox")
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz[5], [0.15, -0.2, 9.81])
    np.testing.assert_allclose(recording.gyroscope.xyz[5], [0.001, 0.002, 0.003])
    np.testing.assert_allclose(recording.accelerometer.t[5], 0.05)


def test_phyphox_of_one_sensor_alone(tmp_path: Path) -> None:
    """ "Acceleration (with g)" exports one file; its numbers have exponents, its first time is 0."""
    head = ",".join(f'"{n}"' for n in ("Time (s)", *(f"Acceleration {a} (m/s^2)" for a in "xyz"), "Absolute"))
    path = table(tmp_path / "Raw Data.csv", head, 60, "{s}E0,3.555450439E-1,3.094482422E-1,1.006282043E1,1E1")
    recording = read_all(path, "phyphox")
    np.testing.assert_allclose(recording.accelerometer.xyz[9], [0.3555450439, 0.3094482422, 10.06282043])
    assert recording.gyroscope is None


@pytest.mark.parametrize(
    ("column", "cell", "celsius"), [("Temperature (°C)", "21.5", 21.5), ("Temperature (K)", "9", None)]
)
def test_a_thermometer_beside_the_columns_of_a_known_format_is_read(
    tmp_path: Path, column: str, cell: str, celsius: float | None
) -> None:
    """An experiment of one's own has it in one table with phyphox's own columns; 9 K no sensor has."""
    names = [
        "Time (s)",
        *(f"Acceleration {a} (m/s^2)" for a in "xyz"),
        *(f"Gyroscope {a} (rad/s)" for a in "xyz"),
    ]
    path = table(tmp_path / "r.csv", "\t".join([*names, column]), 60, "\t".join(["{s}", *"009111", cell]))
    recording = read_all(path)
    assert recording.gyroscope is not None
    if celsius is None:
        assert recording.accelerometer.temperature is None
    else:
        assert recording.accelerometer.temperature is not None
        np.testing.assert_allclose(recording.accelerometer.temperature, celsius)


def test_a_zip_without_a_recording_says_what_it_holds(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "export.zip", "w") as archive:
        archive.writestr("Accelerometer.csv", "Time (s)\n")
    with pytest.raises(TraceError, match=r"holds no recording that is known \(Accelerometer.csv\)"):
        open_trace(tmp_path / "export.zip")


def test_sensor_logger_on_ios_is_in_g_with_the_other_sign(tmp_path: Path) -> None:
    path = sensor_logger(tmp_path, "AccelerometerUncalibrated.csv", z="-1.0")
    sensor_logger(tmp_path, "GyroscopeUncalibrated.csv", z="0.3")
    recording = read_all(path)
    assert "read as sensorlogger_ios" in recording.notes[0]
    np.testing.assert_array_equal(
        recording.accelerometer.xyz, read_all(path, "sensorlogger_ios").accelerometer.xyz
    )
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz[0], -9.80665 * np.array([0.1, 0.2, -1.0]))
    np.testing.assert_allclose(recording.gyroscope.xyz[0], [0.1, 0.2, 0.3])
    with pytest.raises(TraceError, match="it seems to be g"):
        read_all(path, "sensorlogger")
    total = sensor_logger(tmp_path, "TotalAcceleration.csv")
    with pytest.raises(TraceError, match=r"--format sensorlogger"):
        open_trace(total, "sensorlogger_ios")


def sensor_logger(folder: Path, name: str, z: str = "9.81") -> Path:
    line = "1700000000{i:02d}0000000,{s}," + z + ",0.2,0.1"
    return table(folder / name, "time,seconds_elapsed,z,y,x", 90, line)


def test_sensor_logger_with_gravity(tmp_path: Path) -> None:
    path = sensor_logger(tmp_path, "TotalAcceleration.csv")
    sensor_logger(tmp_path, "Gyroscope.csv", z="0.3")
    recording = read_all(path, "sensorlogger")
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz[0], [0.1, 0.2, 9.81])
    np.testing.assert_allclose(recording.gyroscope.xyz[0], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 0.01, atol=1e-6)


def test_sensor_logger_without_gravity_is_refused(tmp_path: Path) -> None:
    path = sensor_logger(tmp_path, "Accelerometer.csv")
    with pytest.raises(TraceError, match=r"takes gravity out .* give TotalAcceleration\.csv"):
        open_trace(path, "sensorlogger")


def test_sensor_logger_without_gyroscope_says_so(tmp_path: Path) -> None:
    path = sensor_logger(tmp_path, "TotalAcceleration.csv")
    recording = read_all(path, "sensorlogger")
    assert recording.gyroscope is None
    assert recording.notes == ["TotalAcceleration.csv: no gyroscope file beside it (name it with --gyro)"]


def hhar(folder: Path, sensor: str, rows: list[tuple[int, int, str]]) -> Path:
    """Write an HHAR file of (arrival ms, creation, device) rows."""
    path = folder / f"Phones_{sensor}.csv"
    value = "0.1,0.2,9.8" if sensor == "accelerometer" else "0.01,0.02,0.03"
    path.write_text("".join(f"{i},{a},{c},{value},a,m,{d},sit\n" for i, (a, c, d) in enumerate(rows)))
    return path


@pytest.mark.parametrize(("unit", "per_s"), [("ns", 10**9), ("us", 10**6), ("ms", 10**3)])
def test_hhar_finds_the_unit_of_each_device_s_stamps(tmp_path: Path, unit: str, per_s: int) -> None:
    path = hhar(tmp_path, "accelerometer", [(i * 10, 5 * per_s + i * per_s // 100, "d") for i in range(300)])
    np.testing.assert_allclose(read_all(path, "hhar").accelerometer.t, 5 + np.arange(300) / 100)


def test_hhar_uses_arrival_where_the_stamps_are_no_clock(tmp_path: Path) -> None:
    path = hhar(tmp_path, "accelerometer", [(i * 10, 77, "d") for i in range(300)])
    recording = read_all(path, "hhar")
    np.testing.assert_allclose(recording.accelerometer.t, np.arange(300) / 100)
    assert "arrival times are used" in recording.notes[1]


def test_hhar_takes_the_first_device_from_both_files_and_says_so(tmp_path: Path) -> None:
    one = [(i * 10, i * 10**7, "one") for i in range(300)]
    other = [(i * 10, i * 10**7, "other") for i in range(200)]
    path = hhar(tmp_path, "accelerometer", [*one, *other])
    hhar(tmp_path, "gyroscope", [*other, *one])
    recording = read_all(path, "hhar")
    assert recording.gyroscope is not None
    assert len(recording.accelerometer) == len(recording.gyroscope) == 300
    assert recording.notes[0].endswith("only the rows of a one are read, 200 others skipped")


def test_hhar_puts_late_rows_back_but_refuses_a_clock_set_back(tmp_path: Path) -> None:
    rows = [(i * 10, i * 10**7, "d") for i in range(2000)]
    late = [*rows[:50], rows[53], *rows[50:53], *rows[54:]]
    recording = read_all(hhar(tmp_path, "accelerometer", late), "hhar")
    np.testing.assert_allclose(recording.accelerometer.t, np.arange(2000) / 100)
    assert "1 rows were out of time order" in recording.notes[1]
    reset = [(a, c if a < 15_000 else c - 10**10, d) for a, c, d in rows]
    with pytest.raises(TraceError, match=r"csv:1501: time runs backwards by 9\.99 s"):
        read_all(hhar(tmp_path, "accelerometer", reset), "hhar")


def test_imu_tk_counts_by_nominal_values_and_by_claims(tmp_path: Path) -> None:
    path = table(tmp_path / "acc.mat", "", 60, "   {s}e+00   3.2768e+04   3.2357e+04   3.67981e+04")
    table(tmp_path / "gyro.mat", "", 60, " {s}  32768  39026  32768 ")
    recording = read_all(path, "imu_tk")
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz[0], [0, -1, 4030.1 / 411])
    np.testing.assert_allclose(recording.gyroscope.xyz[0], [0, 1, 0])
    (tmp_path / "acc.json").write_text('{"accel_unit": 0.0025, "accel_zero": 32757}')
    np.testing.assert_allclose(read_all(path, "imu_tk").accelerometer.xyz[0], [0.0275, -1, 10.10275])


@pytest.mark.parametrize("repeats", ["keep", "refuse"])
def test_repeated_stamps_as_the_map_says(tmp_path: Path, repeats: str) -> None:
    path = tmp_path / "r.csv"
    path.write_text("time,x,y,z\n" + "".join(f"{i // 2},0,0,9.8\n" for i in range(40)))
    format = own_map(tmp_path, f'repeats = "{repeats}"\n' + OWN)
    if repeats == "keep":
        assert len(read_all(path, format).accelerometer) == 40
    else:
        with pytest.raises(TraceError, match=r"r\.csv:3: the time stamp repeats"):
            read_all(path, format)


def test_rows_that_came_twice_are_counted_where_stamp_and_readings_repeat(tmp_path: Path) -> None:
    """One arrives later than its first, one is cut away; another reading at one stamp is none."""
    rows = [f"{i / 100:.2f},{i % 9},0,9.8,{i / 100 + 0.001:.4f}\n" for i in range(20_000)]
    rows[5] += rows[5].replace("0.0510", "0.0530")
    rows[7] += rows[7].replace(",7,", ",7.5,")
    for i in range(9_000, 9_300):
        rows[i] *= 2
    rows[19_000] *= 2
    path = tmp_path / "r.csv"
    path.write_text("t,ax,ay,az,t_arrival\n" + "".join(rows))
    assert read_all(path).delivered_twice == 302
    for cut in (open_trace(path, stop=150.0), open_trace(path, start=1.0)):
        assert cut.recording("r").delivered_twice == 301
        assert read_condensed(cut, path).delivered_twice == 301
