"""Reading recordings: streams, events, claims, gaps, empty cells, two files on one run of time."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.calib_core.streams.events import Charging, Location
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.merge import Spans, cut, merged
from stillcal.replay.formats.recognition.opened import is_rest_table
from stillcal.replay.formats.rest_table import read_rest_table
from stillcal.replay.formats.trace import open_trace, read_all

HEADER = "t,ax,ay,az,gx,gy,gz"


def still(n: int, rate: float = 100.0, seed: int = 0) -> np.ndarray:
    """Return rows of a phone lying on its back: t, force, rate."""
    rng = np.random.default_rng(seed)
    t = 10 + np.arange(n) / rate
    force = rng.normal([0.1, -0.2, 9.8], 0.02, (n, 3))
    return np.column_stack([t, force, rng.normal(0, 0.001, (n, 3))])


def put(path: Path, rows: np.ndarray, header: str = HEADER) -> Path:
    text = "".join(",".join(map(repr, row)) + "\n" for row in rows.tolist())
    data = (header + "\n" + text).encode()
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)
    return path


@pytest.mark.parametrize("name", ["r.csv", "r.csv.gz"])
def test_reads_the_numbers_of_the_contract_to_the_last_bit(tmp_path: Path, name: str) -> None:
    rows = still(500)
    recording = read_all(put(tmp_path / name, rows))
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.accelerometer.t, rows[:, 0])
    np.testing.assert_array_equal(recording.accelerometer.xyz, rows[:, 1:4])
    np.testing.assert_array_equal(recording.gyroscope.xyz, rows[:, 4:7])
    assert recording.notes == []


def test_columns_stand_in_any_order_and_unknown_ones_are_ignored(tmp_path: Path) -> None:
    rows = still(50)
    path = tmp_path / "r.csv"
    lines = [f"walk{i},{r[3]!r},{r[1]!r},0.5,{r[0]!r},{r[2]!r},21.5\n" for i, r in enumerate(rows.tolist())]
    path.write_text("label,az,ax,other,t,ay,temperature\n" + "".join(lines))
    trace = open_trace(path)
    recording = read_all(path)
    np.testing.assert_array_equal(recording.accelerometer.xyz, rows[:, 1:4])
    assert not trace.has_gyroscope and recording.gyroscope is None
    assert recording.accelerometer.temperature is not None
    assert set(recording.accelerometer.temperature) == {21.5}


@pytest.mark.parametrize("ending", ["\r\n", "\n\n", "\n"])
def test_line_ends_blank_lines_and_a_byte_order_mark_do_not_matter(tmp_path: Path, ending: str) -> None:
    rows = still(40)
    text = HEADER + "\n" + ending.join(",".join(map(repr, r)) for r in rows.tolist()) + ending
    path = tmp_path / "r.csv"
    path.write_bytes(b"\xef\xbb\xbf" + b"\n" * ending.count("\n\n") + text.encode())
    np.testing.assert_array_equal(read_all(path).accelerometer.xyz, rows[:, 1:4])


def test_a_last_line_without_line_end_is_read_when_it_is_whole(tmp_path: Path) -> None:
    path = put(tmp_path / "r.csv", still(40))
    path.write_bytes(path.read_bytes().rstrip(b"\n"))
    assert len(read_all(path).accelerometer) == 40


def test_numbers_that_json_does_not_know_are_read(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("t,ax,ay,az\n" + "".join(f"{i},+.5,-1.,9.5E0\n" for i in range(20)))
    np.testing.assert_array_equal(read_all(path).accelerometer.xyz[3], [0.5, -1.0, 9.5])


@settings(max_examples=25, deadline=None)
@given(max_rows=st.integers(1, 400), size=st.integers(200, 5000))
def test_chunks_of_any_size_join_to_the_same_recording(
    tmp_path_factory: pytest.TempPathFactory, max_rows: int, size: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "chunks.csv"
    rows = still(300)
    if not path.exists():
        put(path, rows)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stillcal.replay.formats.tables.text.BLOCK_BYTES", size)
        chunks = list(open_trace(path).chunks(max_rows=max_rows))
    assert max(len(c.accelerometer) for c in chunks) <= max_rows
    np.testing.assert_array_equal(Samples.joined(c.accelerometer for c in chunks).xyz, rows[:, 1:4])
    np.testing.assert_array_equal(Samples.joined(c.gyroscope for c in chunks).xyz, rows[:, 4:7])


def test_a_trace_can_be_read_again_and_counts_its_bytes(tmp_path: Path) -> None:
    path = put(tmp_path / "r.csv.gz", still(300))
    trace = open_trace(path)
    assert trace.bytes_read == 0
    assert [len(c.accelerometer) for c in trace] == [len(c.accelerometer) for c in trace]
    assert trace.bytes_read == trace.size_bytes == path.stat().st_size


def test_a_gap_of_twelve_hours_is_a_note_not_an_error(tmp_path: Path) -> None:
    rows = still(200)
    rows[120:, 0] += 12 * 3600
    recording = read_all(put(tmp_path / "r.csv", rows))
    assert len(recording.accelerometer) == 200
    assert recording.notes == ["r.csv: 1 gaps in time, the longest 43200 s before line 122"]


def test_a_repeated_stamp_is_left_out_and_counted(tmp_path: Path) -> None:
    rows = still(200)
    rows[[50, 90], 0] = rows[[49, 89], 0]
    recording = read_all(put(tmp_path / "r.csv", rows))
    assert len(recording.accelerometer) == 198
    assert recording.notes == [
        "r.csv: 2 samples repeat the previous time stamp and were skipped (first in line 52)"
    ]


def test_a_temperature_carries_over_and_arrival_keeps_its_delay(tmp_path: Path) -> None:
    cells = ["", "21.5", "", "22", ""]
    arrivals = ["100.5", "", "102.25", "", ""]
    rows = [f"{i},0,0,9.8,{c},{a}\n" for i, (c, a) in enumerate(zip(cells, arrivals, strict=True))]
    path = tmp_path / "r.csv"
    path.write_text("t,ax,ay,az,temperature,t_arrival\n" + "".join(rows))
    samples = read_all(path).accelerometer
    assert samples.temperature is not None and samples.t_arrival is not None
    assert samples.temperature.tolist() == [21.5, 21.5, 21.5, 22, 22]
    assert samples.t_arrival.tolist() == [100.5, 101.5, 102.25, 103.25, 104.25]


def test_before_any_temperature_is_known_samples_carry_none(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("t,ax,ay,az,temperature\n" + "".join(f"{i},0,0,9.8,nan\n" for i in range(20)))
    assert read_all(path).accelerometer.temperature is None


def test_rows_may_lack_one_sensor(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text(HEADER + "\n" + "".join(f"{i},0,0,9.8,,,\n{i}.5,,,,0.01,0,0\n" for i in range(20)))
    recording = read_all(path)
    assert recording.gyroscope is not None
    assert recording.accelerometer.t.tolist() == list(range(20))
    assert recording.gyroscope.t.tolist() == [i + 0.5 for i in range(20)]


def test_events_come_in_time_order_with_the_chunk_they_fall_into(tmp_path: Path) -> None:
    path = put(tmp_path / "r.csv.gz", still(1000))
    lines = [
        {"t": 99.0, "event": "charging", "on": False},
        {"t": 1.0, "event": "charging", "on": True},
        {"t": 15.0, "event": "location", "latitude": 46.5, "longitude": 6.6, "altitude": 400},
        {"t": 16.0, "event": "reboot", "why": "not known to this version"},
    ]
    (tmp_path / "r.events.jsonl").write_text("\n".join(map(json.dumps, lines)) + "\n\n")
    trace = open_trace(path)
    assert trace.events == [Charging(1.0, True), Location(15.0, 46.5, 6.6, 400.0), Charging(99.0, False)]
    chunks = list(trace.chunks(max_rows=200))
    assert [event for c in chunks for event in c.events] == trace.events
    assert [len(c.events) for c in chunks] == [1, 0, 1, 0, 1]


def test_claims_are_read_and_unknown_ones_ignored(tmp_path: Path) -> None:
    path = put(tmp_path / "r.csv", still(20))
    (tmp_path / "r.json").write_text('{"device": "X", "nominal_rate_hz": 100, "colour": "red"}')
    claims = open_trace(path).claims
    assert (claims.device, claims.nominal_rate_hz, claims.gravity) == ("X", 100.0, None)


def test_counts_become_si_by_the_claims(tmp_path: Path) -> None:
    rows = still(50)
    counts = rows.copy()
    counts[:, 1:4] = rows[:, 1:4] * 400 + [100, 200, 300]
    counts[:, 4:7] = rows[:, 4:7] * 1000 - 7
    (tmp_path / "r.json").write_text(
        '{"accel_unit": 0.0025, "accel_zero": [100, 200, 300], "gyro_unit": 0.001, "gyro_zero": -7}'
    )
    recording = read_all(put(tmp_path / "r.csv", counts))
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz, rows[:, 1:4], atol=1e-12)
    np.testing.assert_allclose(recording.gyroscope.xyz, rows[:, 4:7], atol=1e-12)


def two_files(folder: Path) -> tuple[Path, Path, np.ndarray, np.ndarray]:
    slow, fast = still(400, rate=50.0), still(1600, rate=200.0, seed=1)
    fast[:, 0] += 0.0013
    accelerometer = put(folder / "a.csv", slow[:, :4], "t,ax,ay,az")
    gyroscope = put(folder / "g.csv", fast[:, [0, 4, 5, 6]], "t,gx,gy,gz")
    return accelerometer, gyroscope, slow, fast


def test_two_files_are_merged_so_that_neither_runs_ahead(tmp_path: Path) -> None:
    accelerometer, gyroscope, slow, fast = two_files(tmp_path)
    chunks = list(open_trace(accelerometer, gyro=gyroscope).chunks(max_rows=100))
    np.testing.assert_array_equal(Samples.joined(c.accelerometer for c in chunks).t, slow[:, 0])
    np.testing.assert_array_equal(Samples.joined(c.gyroscope for c in chunks).t, fast[:, 0])
    assert max(len(c.gyroscope) for c in chunks) <= 100
    reached = -np.inf
    for chunk in chunks:
        times = np.concatenate([chunk.accelerometer.t, chunk.gyroscope.t])
        assert times.min() > reached
        reached = times.max()


def test_two_files_hold_at_most_a_block_of_the_one_ahead(tmp_path: Path) -> None:
    """A gyroscope that starts late does not make the reader gather the accelerometer's file."""
    accelerometer, gyroscope, _, fast = two_files(tmp_path)
    late = fast[fast[:, 0] > 14]
    put(gyroscope, late[:, [0, 4, 5, 6]], "t,gx,gy,gz")
    trace = open_trace(accelerometer, gyro=gyroscope)
    first = next(iter(merged(trace._files, 64)))
    assert len(first[0]) == 64 and len(first[1]) == 0


def test_two_files_that_never_meet_in_time_are_refused(tmp_path: Path) -> None:
    accelerometer, gyroscope, _, fast = two_files(tmp_path)
    fast[:, 0] += 1000
    put(gyroscope, fast[:, [0, 4, 5, 6]], "t,gx,gy,gz")
    with pytest.raises(TraceError, match="do not overlap"):
        read_all(accelerometer, gyro=gyroscope)


def test_a_rest_table_with_all_columns(tmp_path: Path) -> None:
    path = tmp_path / "rests.csv"
    path.write_text(
        "n,ax,ay,az,sax,say,saz,t,duration,gx,gy,gz,sgx,sgy,sgz,temperature\n"
        "100,0.1,0.2,9.8,0.01,0.02,0.03,5.0,1.5,0.001,0.002,0.003,0.02,0.04,0.06,\n"
        "400,9.7,0.2,0.1,0.01,0.02,0.03,9.0,4.0,0.001,0.002,0.003,0.02,0.04,0.06,25\n"
    )
    first, second = read_rest_table(path)
    assert (first.t_start, first.t_end, first.n, first.temperature) == (5.0, 6.5, 100, None)
    assert second.temperature == 25.0
    np.testing.assert_allclose(first.force_uncertainty, [0.001, 0.002, 0.003])
    np.testing.assert_allclose(second.force_uncertainty, [0.0005, 0.001, 0.0015])
    assert first.rate is not None and first.rate.tolist() == [0.001, 0.002, 0.003]
    assert first.rate_uncertainty is not None
    np.testing.assert_allclose(first.rate_uncertainty, [0.002, 0.004, 0.006])


def test_a_scatter_without_a_count_says_nothing_of_the_means(tmp_path: Path) -> None:
    """It was their uncertainty, 50 times too much for 2500 samples, and hid what the rows show."""
    path = tmp_path / "rests.csv"
    path.write_text("ax,ay,az,sax,say,saz\n0.12,0.2,9.81,0.5,0.5,0.5\n9.7,0.21,0.1,0.5,0.5,0.5\n")
    rests = read_rest_table(path)
    np.testing.assert_allclose([r.force_uncertainty for r in rests], 0.01 / 12**0.5)
    np.testing.assert_allclose([r.force_sd for r in rests], 0.5)


def test_a_rest_table_of_means_only_knows_their_rounding(tmp_path: Path) -> None:
    path = tmp_path / "rests.csv"
    path.write_text("ax;ay;az\n0.12;0.2;9.81\n9.7;0.21;0.1")
    rests = read_rest_table(path)
    assert [(r.t_start, r.duration, r.n) for r in rests] == [(0.0, 0.0, 1), (1.0, 0.0, 1)]
    np.testing.assert_allclose([r.force_uncertainty for r in rests], 0.01 / 12**0.5)
    assert rests[0].rate is None


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("ax,ay\n1,2\n", "no column 'az'"),
        ("ax,ay,az\n", "header only"),
        ("ax,ay,az\n0,0,0\n0,0,0\n", "zero"),
        ("t,ax,ay,az\n0,0,0,1\n9,0,1,0.02\n", "the forces seem to be in g"),
        ("ax,ay,az\n0,0,1000\n0,990,20\n", "the forces seem to be in mg"),
        ("ax,ay,az\n1,2,3\n1,nan,3\n", "t.csv:3: column 'ay'"),
        ("ax,ay,az\n1,2,3\n1,,3\n", "t.csv:3: column 'ay'"),
    ],
)
def test_a_bad_rest_table_is_refused(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(TraceError, match=what):
        read_rest_table(path)
    with pytest.raises(TraceError, match=r"holds no samples; .* stillcal diagnose and stillcal replay"):
        open_trace(path, "rest")


@pytest.mark.parametrize("cell", ["nan", "inf", "", "none"])
def test_a_rest_table_with_a_cell_that_is_no_number_is_known_as_one(tmp_path: Path, cell: str) -> None:
    """It was taken for a recording, which has no column of time stamps."""
    (tmp_path / "r.csv").write_text(f"ax,ay,az\n0,0,9.9\n0,9.8,0\n9.8,{cell},0\n0,0,-9.8\n")
    assert is_rest_table(tmp_path / "r.csv")
    with pytest.raises(TraceError, match=r"r\.csv:4: .*'ay'"):
        read_rest_table(tmp_path / "r.csv")


@pytest.mark.parametrize("cell", ["", "NaN", "nan"])
def test_a_sample_of_which_all_cells_are_empty_or_nan_is_none(tmp_path: Path, cell: str) -> None:
    rows = [line.split(",") for line in [HEADER, *(",".join(map(repr, row)) for row in still(300).tolist())]]
    for i in range(1, 301, 3):
        rows[i][1:4] = rows[i + 1][4:7] = [cell] * 3
    (tmp_path / "r.csv").write_text("\n".join(map(",".join, rows)))
    recording = read_all(tmp_path / "r.csv")
    assert recording.gyroscope is not None
    assert (len(recording.accelerometer), len(recording.gyroscope)) == (200, 200)
    assert recording.notes == ["r.csv: 200 rows have no sample of one sensor (empty cells)"]
    rows[5][3] = cell
    (tmp_path / "r.csv").write_text("\n".join(map(",".join, rows)))
    with pytest.raises(TraceError, match=r"r\.csv:6: column 'az' (holds nan|is empty)"):
        read_all(tmp_path / "r.csv")


def test_a_sensor_that_was_on_for_a_part_of_the_time_is_told_of(tmp_path: Path) -> None:
    lines = [HEADER, *(",".join(map(repr, row)) for row in still(3000).tolist())]
    (tmp_path / "both.csv").write_text("\n".join(lines))
    assert read_all(tmp_path / "both.csv").notes == []
    lines[1501:] = [",".join([*line.split(",")[:4], "", "", ""]) for line in lines[1501:]]
    (tmp_path / "part.csv").write_text("\n".join(lines))
    _, note = read_all(tmp_path / "part.csv").notes
    assert note == "part.csv: the gyroscope has samples from 0.0 to 15.0 s only, of 30.0 s"
    assert len(read_all(tmp_path / "part.csv", stop=20.0).notes) == 1, "5 s alone are not told of"


def spans_of(*streams: tuple[Sensor, np.ndarray], rows: int = 700) -> list[str]:
    """Return what is said of sensors with these stamps, s, which are seen in runs."""
    seen = Spans()
    for pair in cut({sensor: Samples(sensor, t, np.zeros((t.size, 3))) for sensor, t in streams}, rows):
        seen.see(*pair)
    return list(seen.said())


def test_a_hole_of_one_sensor_is_told_of_and_one_of_both_is_not() -> None:
    t = np.arange(0.0, 100.0, 0.1)
    holed = t[(t < 20.0) | ((t > 35.0) & (t < 50.0)) | (t > 62.0)]
    said = spans_of((Sensor.ACCELEROMETER, t), (Sensor.GYROSCOPE, holed))
    where = "from 19.9 to 35.1 s, where the accelerometer has"
    assert said == [f"the gyroscope has no samples {where} (the longest of 2 holes, 27.4 s together)"]
    assert spans_of((Sensor.ACCELEROMETER, holed), (Sensor.GYROSCOPE, holed)) == []
    assert spans_of((Sensor.ACCELEROMETER, t[t < 30.0]), (Sensor.GYROSCOPE, t[(t < 25.0) | (t > 45.0)])) == [
        "the accelerometer has samples from 0.0 to 29.9 s only, of 99.9 s"
    ]
    longer = t[(t < 20.0) | (t > 75.0)]
    assert spans_of((Sensor.ACCELEROMETER, longer), (Sensor.GYROSCOPE, holed)) == [
        "the accelerometer has no samples from 35.1 to 49.9 s, where the gyroscope has"
        " (the longest of 2 holes, 27.8 s together)"
    ]
