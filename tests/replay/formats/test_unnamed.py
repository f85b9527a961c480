"""Tables without a header: what their columns are, by what the rows hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import read_all

N = 60
RNG = np.random.default_rng(4)
FORCE = np.round(RNG.normal([0.2, 0.1, 9.8], 0.05, (N, 3)), 4)
RATES = np.round(RNG.normal(0, 0.05, (N, 3)), 4)
MS = np.arange(N) * 10 + 1000


def written(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def joined(mark: str, *cells: object) -> str:
    return mark.join(map(str, cells))


@pytest.mark.parametrize(
    ("mark", "words", "accuracy"),
    [(",", ("accelerometer", "gyroscope"), ()), (" ", ("ACC", "GYR"), ()), (";", ("ACCE", "GYRO"), (3,))],
)
@pytest.mark.parametrize("name_first", [True, False])
def test_rows_named_by_their_sensor_need_no_header(
    tmp_path: Path, mark: str, words: tuple[str, str], accuracy: tuple[int, ...], name_first: bool
) -> None:
    lines = [joined(mark, "MAGN", 990, 40.1, 7, 8, 9, 10)]  # of another width
    for time, force, rates in zip(MS, FORCE, RATES, strict=True):
        for word, stamp, xyz in ((words[0], time, force), (words[1], time + 3, rates)):
            first = (word, stamp) if name_first else (stamp, word)
            lines.append(joined(mark, *first, *xyz, *accuracy))
    recording = read_all(written(tmp_path / "r.txt", lines if name_first else lines[1:]))
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)
    np.testing.assert_allclose(recording.accelerometer.t, MS / 1000)
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.gyroscope.xyz, RATES)
    np.testing.assert_allclose(recording.gyroscope.t, (MS + 3) / 1000)


def test_labels_and_columns_in_which_nothing_changes_are_no_axes(tmp_path: Path) -> None:
    rows = zip(MS, FORCE, RATES, strict=True)
    lines = [joined(",", 33, "Jogging", time, 3, *force, 4, *rates) for time, force, rates in rows]
    recording = read_all(written(tmp_path / "r.txt", lines))
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.gyroscope.xyz, RATES)
    np.testing.assert_allclose(recording.accelerometer.t, MS / 1000)


def test_letters_of_what_a_person_does_name_no_sensor(tmp_path: Path) -> None:
    rows = zip(MS, FORCE, RATES, strict=True)
    lines = [joined(",", 1600, "AGB"[i // 20], time, *force) for i, (time, force, _) in enumerate(rows)]
    recording = read_all(written(tmp_path / "r.txt", lines))
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)


def test_letters_may_name_the_sensors_of_rows(tmp_path: Path) -> None:
    lines = [
        joined(",", letter, time, *xyz)
        for time, force, rates in zip(MS, FORCE, RATES, strict=True)
        for letter, xyz in (("A", force), ("G", rates), ("M", (7, 8, 9)))
    ]
    recording = read_all(written(tmp_path / "r.txt", lines))
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)
    assert recording.gyroscope is not None
    np.testing.assert_array_equal(recording.gyroscope.xyz, RATES)


@pytest.mark.parametrize("start", ["2024-03-01 10:00:0{s:.3f},", "10:00:0{s:.3f} "])
def test_a_date_may_be_the_time(tmp_path: Path, start: str) -> None:
    lines = [
        start.format(s=ms / 1000) + joined(start[-1], *force) for ms, force in zip(MS, FORCE, strict=True)
    ]
    recording = read_all(written(tmp_path / "r.csv", lines))
    np.testing.assert_allclose(np.diff(recording.accelerometer.t), 0.01, atol=1e-6)


def test_other_counts_of_columns_are_refused(tmp_path: Path) -> None:
    lines = [joined(",", t, *f, *r[:2]) for t, f, r in zip(MS, FORCE, RATES, strict=True)]
    with pytest.raises(TraceError, match="has no header, and of its 6 columns 5 may be axes"):
        read_all(written(tmp_path / "r.csv", lines))


def test_rows_named_by_their_sensor_with_more_than_three_values_are_refused(tmp_path: Path) -> None:
    lines = [joined(",", "acc", t, *f, r[0]) for t, f, r in zip(MS, FORCE, RATES, strict=True)]
    with pytest.raises(TraceError, match="has no header, and of its 6 columns 4 may be axes"):
        read_all(written(tmp_path / "r.csv", lines))


def test_two_sensors_of_the_size_of_gravity_are_not_told_apart(tmp_path: Path) -> None:
    lines = [joined(",", t, *f, *f[::-1]) for t, f in zip(MS, FORCE, strict=True)]
    with pytest.raises(TraceError, match=r"which of columns 1, 2, 3 and 4, 5, 6 .* is not clear by size"):
        read_all(written(tmp_path / "r.csv", lines))


def test_rates_that_never_change_are_no_gyroscopes(tmp_path: Path) -> None:
    lines = [joined(",", t, *f, 0, 0, 0) for t, f in zip(MS, FORCE, strict=True)]
    recording = read_all(written(tmp_path / "r.csv", lines))
    assert recording.gyroscope is None
    assert "passed over, since a gyroscope has noise on all axes: 4 5 6" in recording.notes[0]


def test_the_mark_of_utf_8_is_no_part_of_a_first_row(tmp_path: Path) -> None:
    lines = [joined(",", t, *f) for t, f in zip(MS, FORCE, strict=True)]
    (tmp_path / "r.csv").write_text("\n".join(lines) + "\n", encoding="utf-8-sig")
    np.testing.assert_array_equal(read_all(tmp_path / "r.csv").accelerometer.xyz, FORCE)


def test_columns_that_are_called_by_their_count_have_no_names(tmp_path: Path) -> None:
    lines = [joined(",", time, *force) for time, force in zip(MS, FORCE, strict=True)]
    recording = read_all(written(tmp_path / "r.csv", ["0,1,2,3", *lines]))
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)


def test_empatica_says_its_rate_in_its_second_row(tmp_path: Path) -> None:
    counts = np.round(FORCE / 9.80665 * 64).astype(int)
    start = "1700000000.000000, 1700000000.000000, 1700000000.000000"
    lines = [start, "32.000000, 32.000000, 32.000000", *(joined(",", *row) for row in counts)]
    recording = read_all(written(tmp_path / "ACC.csv", lines))
    np.testing.assert_allclose(recording.accelerometer.xyz, counts * 9.80665 / 64)
    np.testing.assert_allclose(recording.accelerometer.t, np.arange(N) / 32)
