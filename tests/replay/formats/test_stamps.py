"""Which column is the time of a table of unknown make, and in which unit."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import Recording, read_all

N = 400
RNG = np.random.default_rng(5)
FORCE = np.round(RNG.normal([0.2, 0.1, 9.8], 0.05, (N, 3)), 4)
SECONDS = np.arange(N) * 0.01


def read(
    folder: Path, columns: dict[str, list[str]], force: np.ndarray = FORCE, called: str = "acc_"
) -> Recording:
    names = [*columns, *(called + axis for axis in "xyz")]
    rows = zip(*columns.values(), *(map(str, axis) for axis in force.T), strict=True)
    path = folder / "r.csv"
    path.write_text("\n".join(map(",".join, [names, *rows])) + "\n")
    return read_all(path)


def texts(values: np.ndarray, form: str = ".9f") -> list[str]:
    return [format(value, form) for value in values]


@pytest.mark.parametrize(
    ("name", "stamps", "step"),
    [
        ("time", texts(1_700_000_000 + SECONDS * 100, ".0f"), 1.0),  # whole seconds at 1 Hz
        ("time", texts(1_700_000_000_000 + SECONDS * 1000, ".0f"), 0.01),
        ("timestamp", texts(1_300_000_000 + SECONDS * 1e6, ".0f"), 0.01),  # us since the start
        ("time", texts(45352.25 + SECONDS / 86400, ".10f"), 0.01),  # a spreadsheet's days
        ("time (min)", texts(SECONDS / 60), 0.01),
        ("Elapsed Time (h)", texts(SECONDS / 3600, ".11f"), 0.01),
        ("Temps (s)", texts(SECONDS), 0.01),
        ("GpsTow", texts(300_000 + SECONDS), 0.01),
        ("Abszisse [s]", texts(SECONDS), 0.01),
        ("world time [s]", texts(SECONDS), 0.01),
        ("global_time", texts(SECONDS), 0.01),
        ("unixtime", texts(1_700_000_000 + SECONDS), 0.01),
        ("utime", texts(1.3e15 + SECONDS * 1e6, ".0f"), 0.01),
    ],
)
def test_the_unit_of_times(tmp_path: Path, name: str, stamps: list[str], step: float) -> None:
    recording = read(tmp_path, {name: stamps})
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), step, rtol=2e-3)
    assert (f"(by its steps, {1 / step:.3g} Hz)" in recording.notes[0]) == (name[-1] not in ")]")


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (texts(SECONDS * 100, ".0f"), r"steps of 1, which shows no unit of time; say the unit in its name"),
        (texts(SECONDS * 50, ".6f"), r"steps of 0\.5, which shows no unit"),  # 2 Hz, or 2 kHz in ms
        (texts(SECONDS * 100 + RNG.uniform(0, 0.1, N), ".6f"), "which shows no unit"),  # 1 Hz, or 1 kHz in ms
        (texts(SECONDS / 80), r"steps of 0\.000125, which shows no unit"),
        ([f"2024-03-01 10:00:{int(s):02d}" for s in SECONDS], "of the stamps in column 'time' repeat"),
    ],
)
def test_what_shows_no_time_is_refused(tmp_path: Path, stamps: list[str], said: str) -> None:
    with pytest.raises(TraceError, match=said):
        read(tmp_path, {"time": stamps})


def test_a_messages_own_stamp_goes_before_the_time_of_recording(tmp_path: Path) -> None:
    late = texts(1.7e18 + SECONDS * 1e9 + RNG.uniform(0, 5e6, N), ".0f")
    own = texts(1.7e18 + SECONDS * 1e9, ".0f")
    columns = {"%time": late, "field.header.seq": texts(SECONDS, ".0f"), "field.header.stamp": own}
    recording = read(tmp_path, columns, called="field.linear_acceleration.")
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 0.01, atol=1e-6)


@pytest.mark.parametrize("name", ["timestampms", "timems", "elapsedms", "time_millisec"])
def test_a_unit_may_stand_close_to_the_time(tmp_path: Path, name: str) -> None:
    recording = read(tmp_path, {name: texts(SECONDS * 1e3)})
    np.testing.assert_allclose(recording.accelerometer.t, SECONDS)
    assert f"time {name} in ms;" in recording.notes[0]


def test_a_unit_of_time_alone_goes_behind_a_time(tmp_path: Path) -> None:
    recording = read(tmp_path, {"latency [ms]": texts(SECONDS * 2000 + 3), "phone time [s]": texts(SECONDS)})
    np.testing.assert_allclose(recording.accelerometer.t, SECONDS)


def test_dates_need_not_stand_first(tmp_path: Path) -> None:
    dates = [f"2024-03-01 10:00:{s:06.3f}" for s in SECONDS]
    recording = read(tmp_path, {"note": ["-"] * N, "when": dates})
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 0.01, atol=1e-6)


def test_times_since_1970_at_1_hz_may_have_a_slow_clock(tmp_path: Path) -> None:
    """They were taken for ms, and the recording for one at 1 kHz."""
    recording = read(tmp_path, {"timestamp": texts(1.75e9 + SECONDS * 100.0 * 1.003, ".4f")})
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 1.003, atol=1e-3)


def test_ticks_are_no_times_where_there_are_times(tmp_path: Path) -> None:
    recording = read(
        tmp_path, {"Clock:Tick#": texts(SECONDS * 4.5e6, ".0f"), "Clock:offsetTime": texts(SECONDS, ".3f")}
    )
    np.testing.assert_allclose(recording.accelerometer.t, SECONDS)


@pytest.mark.parametrize("beside", ["Date", "node clock (s)"])
def test_steps_show_no_unit_that_times_beside_them_contradict(tmp_path: Path, beside: str) -> None:
    ticks = texts(np.floor(SECONDS * 32768), ".0f")  # such as 0.33 ms if they were us
    clock = [f"2026-03-01 10:00:0{t:.2f}" for t in SECONDS] if beside == "Date" else texts(SECONDS)
    recording = read(tmp_path, {"node_timestamp": ticks, beside: clock})
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 0.01, atol=1e-6)
    again = read(tmp_path, {"node_timestamp": texts(SECONDS * 1000, ".0f"), beside: clock})
    assert "time node_timestamp in ms" in again.notes[0]


def test_steps_that_are_too_short_for_the_times_beside_them_show_no_unit_either(tmp_path: Path) -> None:
    """Ticks of 20 a second would be ms, and the recording 50 times as fast as it is."""
    recording = read(tmp_path, {"timestamp": texts(SECONDS * 2000, ".0f"), "clock_s": texts(SECONDS * 100)})
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 1.0)


def test_dates_that_go_on_by_a_minute_only_contradict_no_times(tmp_path: Path) -> None:
    minutes = [f"2026-03-01 10:0{int(t > SECONDS[N // 2])}" for t in SECONDS]
    recording = read(tmp_path, {"timestamp": texts(SECONDS * 1e3, ".0f"), "Date": minutes})
    assert "time timestamp in ms" in recording.notes[0]


def test_what_is_no_clock_contradicts_no_times(tmp_path: Path) -> None:
    latency = texts(RNG.uniform(3, 400, N))
    recording = read(tmp_path, {"timestamp": texts(SECONDS * 1e3, ".0f"), "latency [ms]": latency})
    assert "time timestamp in ms" in recording.notes[0]


@pytest.mark.parametrize("late", ["Phone timestamp [ms]", "Timestamp_RAW", "system time (ms)"])
def test_the_sensors_own_times_go_before_anothers(tmp_path: Path, late: str) -> None:
    others = texts(np.sort(SECONDS + RNG.uniform(0, 0.02, N)) * 1000, ".0f")
    recording = read(tmp_path, {late: others, "sensor timestamp [ns]": texts(SECONDS * 1e9, ".0f")})
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 0.01, atol=1e-6)
    assert "time sensor timestamp [ns]" in recording.notes[0]


def test_whole_seconds_without_a_unit_and_their_fraction(tmp_path: Path) -> None:
    whole = texts(np.floor(SECONDS + 1e-9), ".0f")
    parts = [f"{round(s * 1000) % 1000}" for s in SECONDS]
    recording = read(tmp_path, {"timestamp": whole, "timestamp_ms": parts})
    np.testing.assert_allclose(recording.accelerometer.t, SECONDS, atol=1e-9)


def test_acceleration_that_swings_about_zero_is_without_gravity(tmp_path: Path) -> None:
    stride = np.sin(2 * np.pi * 1.8 * SECONDS)[:, None] * [1.0, 0.6, 0.9]
    time = {"time_s": texts(SECONDS)}
    with pytest.raises(TraceError, match="swing about zero: gravity was taken out"):
        read(tmp_path, time, stride)  # as large as 1 g is in g
    shaken = read(tmp_path, time, stride + np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(np.linalg.norm(shaken.accelerometer.xyz.mean(axis=0)), 9.8, atol=0.3)


def test_columns_without_gravity_are_named(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("time_s,gravity_x,gravity_y,user_acc_x,user_acc_y,user_acc_z,gyr_x,gyr_y,gyr_z\n")
    with path.open("a") as file:
        file.writelines(f"{t:.2f},0,0,0.1,0,0,0.1,0.2,0.3\n" for t in SECONDS)
    with pytest.raises(
        TraceError, match=r"no acceleration with gravity, only user_acc_x.*gravity in columns"
    ):
        read_all(path)


@pytest.mark.parametrize(
    ("free", "gravity", "unit"),
    [
        ("userAcceleration.x", "gravity.x", -9.80665),
        ("motionUserAccelerationX(G)", "motionGravityX(G)", -9.80665),
        ("user_acc_x(G)", "gravity_x(G)", -9.80665),
        ("linear_acceleration_x_m_s2", "gravity_x_m_s2", 1.0),
    ],
)
def test_gravity_in_columns_of_its_own_is_added(tmp_path: Path, free: str, gravity: str, unit: float) -> None:
    """Core Motion, as MotionSense, SensorLog and OxIOD have it, in g with its sign; Android's in m/s^2."""
    motion = np.column_stack([np.sin(SECONDS * k) for k in (1.0, 2.0, 3.0)])
    down = np.full((SECONDS.size, 3), [0.0, 0.6, 0.8]) * 9.80665
    columns = {"time_s": texts(SECONDS)}
    for name, values in ((gravity, down), (free, motion)):
        for axis in range(3):
            named = re.sub("[xX](?=$|[(]|_m)", lambda x, i=axis: chr(ord(x[0]) + i), name)
            columns[named] = texts(values[:, axis] / unit)
    path = tmp_path / "r.csv"
    path.write_text("\n".join(map(",".join, [list(columns), *zip(*columns.values(), strict=True)])))
    recording = read_all(path)
    np.testing.assert_allclose(recording.accelerometer.xyz, motion + down, atol=1e-6)
    assert "added in" in " ".join(recording.notes)


def test_what_has_no_noise_is_no_gyroscope(tmp_path: Path) -> None:
    """GENEActiv's rows: light, button and temperature stand behind the axes."""
    path = tmp_path / "r.csv"
    path.write_text(
        "".join(f"{t:.2f},{x},{y},{z},10,0,24.1\n" for t, (x, y, z) in zip(SECONDS, FORCE, strict=True))
    )
    recording = read_all(path)
    assert recording.gyroscope is None
    assert "passed over, since a gyroscope has noise on all axes: 4 5 6" in recording.notes[0]


@pytest.mark.parametrize(
    "count", [{}, {"sample": texts(SECONDS * 100, ".0f")}, {"t": texts(SECONDS * 100, ".0f")}]
)
@pytest.mark.parametrize("said", ["100Hz", "100.0 hz"])
def test_the_rate_of_a_table_without_time_stamps_is_said(
    tmp_path: Path, count: dict[str, list[str]], said: str
) -> None:
    with pytest.raises(TraceError, match="--format 100Hz"):
        read(tmp_path, count)
    recording = read_all(tmp_path / "r.csv", said)
    np.testing.assert_allclose(recording.accelerometer.t, SECONDS, atol=1e-9)
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)
    assert "no time stamps, 100 Hz as stated" in recording.notes[0]


def test_a_rate_that_was_said_goes_for_json_and_before_one_that_is_assumed(tmp_path: Path) -> None:
    rows = [dict(zip(("acc_x", "acc_y", "acc_z"), row, strict=True)) for row in FORCE.tolist()]
    (tmp_path / "r.jsonl").write_text("\n".join(map(json.dumps, rows)))
    turning = RNG.normal(0, 0.1, FORCE.shape)
    (tmp_path / "r.txt").write_text(
        "".join(f"{' '.join(map(repr, row))}\n" for row in np.hstack([FORCE, turning]).tolist())
    )
    for name in ("r.jsonl", "r.txt"):
        t = read_all(tmp_path / name, "50Hz").accelerometer.t
        np.testing.assert_allclose(np.diff(t), 0.02, atol=1e-9)
    (tmp_path / "r.bin").write_bytes(b"PK\x05\x06" + bytes(18))
    with pytest.raises(TraceError, match="has its own times; leave --format out"):
        read_all(tmp_path / "r.bin", "50Hz")
