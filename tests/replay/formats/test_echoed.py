"""Messages as ROS prints them, in the layouts of `rostopic echo` (ROS 1) and `ros2 topic echo`."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import Recording, read_all
from tests.support.log_files import DATA

T, FORCE, RATE = DATA[:, 0], DATA[:, 1:4], DATA[:, 4:]
NS = np.round((1.7e9 + T) * 1e9).astype(np.int64)


def vector(values: np.ndarray) -> str:
    return "".join(f"  {axis}: {value!r}\n" for axis, value in zip("xyz", values.tolist(), strict=True))


def ros1(i: int) -> str:
    secs, nsecs = divmod(int(NS[i]), 1_000_000_000)
    stamp = f"header: \n  seq: {i}\n  stamp: \n    secs: {secs}\n    nsecs: {nsecs:9d}\n"
    none = "covariance: [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n"
    turning = f"angular_velocity: \n{vector(RATE[i])}angular_velocity_{none}"
    pushing = f"linear_acceleration: \n{vector(FORCE[i])}linear_acceleration_{none}"
    return f'{stamp}  frame_id: "imu"\n{turning}{pushing}'


def ros2(i: int) -> str:
    sec, nanosec = divmod(int(NS[i]), 1_000_000_000)
    stamp = f"header:\n  stamp:\n    sec: {sec}\n    nanosec: {nanosec}\n  frame_id: imu_link\n"
    none = "covariance:\n" + "- -1.0\n" * 9
    turning = f"angular_velocity:\n{vector(RATE[i])}angular_velocity_{none}"
    return f"{stamp}{turning}linear_acceleration:\n{vector(FORCE[i])}linear_acceleration_{none}"


def read(folder: Path, text: str) -> Recording:
    path = folder / "imu.txt"
    path.write_text(text)
    return read_all(path)


def assert_read(recording: Recording) -> None:
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)
    np.testing.assert_array_equal(recording.gyroscope.xyz, RATE)
    np.testing.assert_allclose(recording.accelerometer.t, NS / 1e9, atol=1e-6)


@pytest.mark.parametrize("message", [ros1, ros2])
@pytest.mark.parametrize("before", ["", "---\n"])
def test_printed_messages_are_read(tmp_path: Path, message: Callable[[int], str], before: str) -> None:
    text = before + "".join(f"{message(i)}---\n" for i in range(len(T)))
    assert_read(read(tmp_path, text))
    assert_read(read(tmp_path, text.replace("\n", "\r\n")))
    packed = tmp_path / "imu.txt.gz"
    packed.write_bytes(gzip.compress(text.encode()))
    assert_read(read_all(packed))


NONE = [0.0] * 9
AXES = (("orientation", "xyzw"), ("angular_velocity", "xyz"), ("linear_acceleration", "xyz"))


@pytest.mark.parametrize("tool", ["rostopic echo -p", "ros2 topic echo --csv"])
def test_messages_printed_as_csv_are_read(tmp_path: Path, tool: str) -> None:
    lines = []
    if tool == "rostopic echo -p":
        names = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
        for quantity, axes in AXES:
            names += [f"field.{quantity}.{axis}" for axis in axes]
            names += [f"field.{quantity}_covariance{i}" for i in range(9)]
        lines.append(",".join(names))
    for i, (rate, force) in enumerate(zip(RATE.tolist(), FORCE.tolist(), strict=True)):
        ns = int(NS[i])
        stamp = [ns + 400, i, ns] if tool == "rostopic echo -p" else [ns // 10**9, ns % 10**9]
        values = [*stamp, "imu_link", 0.0, 0.0, 0.0, 1.0, *NONE, *rate, *NONE, *force, *NONE]
        lines.append(",".join(map(str, values)))
    assert_read(read(tmp_path, "\n".join(lines) + "\n"))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_messages_with_the_mark_of_an_encoding_are_read(tmp_path: Path, encoding: str) -> None:
    text = "".join(f"{ros2(i)}---\n" for i in range(len(T)))
    path = tmp_path / "imu.txt"
    path.write_bytes(text.replace("\n", "\r\n").encode(encoding))
    assert_read(read_all(path))


def test_values_that_are_not_finite_and_lists_of_several_lines(tmp_path: Path) -> None:
    none = "orientation:\n  x: .nan\n  y: -.inf\norientation_covariance: [-1.0, 0.0,\n  0.0,\n  0.0]\n"
    text = "".join(f"{ros2(i).replace('angular', none + 'angular', 1)}---\n" for i in range(len(T)))
    assert_read(read(tmp_path, text))
    with pytest.raises(TraceError, match=r"imu.txt:1: field 'angular_velocity.z' holds nan, .* not a finite"):
        read(tmp_path, text.replace(f"  z: {RATE[0, 2].item()!r}\n", "  z: .NaN\n", 1))


@pytest.mark.parametrize("message", [ros1, ros2])
def test_a_last_message_that_is_not_whole_is_left_out(tmp_path: Path, message: Callable[[int], str]) -> None:
    count = 12
    before = "".join(f"{message(i)}---\n" for i in range(count))
    last = message(count)
    whole_from = last.index("linear_acceleration_covariance")
    for end in range(0, len(last), 13):
        recording = read(tmp_path, before + last[:end])
        assert len(recording.accelerometer) == count + (end >= whole_from)
        np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE[: len(recording.accelerometer)])
        lines = len(last[:end].strip().splitlines())
        said = f"imu.txt: ends within a message: its {lines} line{' is' if lines == 1 else 's are'} left out"
        assert (said in recording.notes) is (0 < end < whole_from)


LOST = "A message was lost!!!\n\ttotal count change:1\n\ttotal count: 1---\n"
WARNING = "WARNING: topic [/imu] does not appear to be published yet\n"
LOGGED = "[WARN] [1700000000.100000000] [_ros2cli_42]: New publisher discovered on topic '/imu'\n"


@pytest.mark.parametrize("said", [LOST, WARNING, LOGGED, "^C"])
def test_warnings_among_messages_are_left_out_and_counted(tmp_path: Path, said: str) -> None:
    parts = [f"{ros2(i)}---\n" for i in range(len(T))]
    lines = said.count("\n")
    if lines:
        first_axis = parts[40].index("  y:")
        parts[40] = parts[40][:first_axis] + said + parts[40][first_axis:]
    recording = read(tmp_path, "".join([said if lines else "", *parts, said]))
    assert_read(recording)
    if lines:
        assert (
            f"imu.txt: {3 * lines} lines are no part of a message (first in line 1): left out"
            in recording.notes
        )


def test_a_message_that_a_warning_broke_is_left_out_and_its_line_named(tmp_path: Path) -> None:
    parts = [f"{ros2(i)}---\n" for i in range(len(T))]
    line = sum(part.count("\n") for part in parts[:40]) + 1
    parts[40] = parts[40].replace("\n  z:", f"{WARNING}  z:", 1)
    recording = read(tmp_path, "".join(parts))
    np.testing.assert_array_equal(recording.accelerometer.xyz, np.delete(FORCE, 40, axis=0))
    assert f"imu.txt: 1 message is not whole (first in line {line}): left out" in recording.notes
