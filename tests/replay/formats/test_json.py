"""JSON recordings: one object a line, arrays of objects, and objects that hold lists."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.tables import json_records
from stillcal.replay.formats.trace import Recording, open_trace, read_all
from tests.support.log_files import DATA, as_zip

T, FORCE, RATE = DATA[:, 0], DATA[:, 1:4], DATA[:, 4:]
EPOCH_MS = 1.7e12
Record = dict[str, Any]
Pack = Callable[[list[Record]], str]


def lines(records: list[Record]) -> str:
    return "\n".join(map(json.dumps, records)) + "\n"


def array(records: list[Record]) -> str:
    return json.dumps(records)


def array_of_lines(records: list[Record]) -> str:
    return "[\n" + ",\n".join(map(json.dumps, records)) + "\n]\n"


def indented(records: list[Record]) -> str:
    return json.dumps(records, indent=2)


def one_after_another(records: list[Record]) -> str:
    return "\n".join(json.dumps(record, indent=2) for record in records)


def in_an_object(records: list[Record]) -> str:
    return json.dumps({"device": "phone", "samples": records})


PACKS = [lines, array, array_of_lines, indented, one_after_another, in_an_object]


def samples() -> list[tuple[float, list[float], list[float]]]:
    return list(zip(T.tolist(), FORCE.tolist(), RATE.tolist(), strict=True))


def flat() -> list[Record]:
    axes = ("acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z")
    return [{"time": t, **dict(zip(axes, [*a, *w], strict=True))} for t, a, w in samples()]


def nested() -> list[Record]:
    return [
        {
            "ts": EPOCH_MS + 1e3 * t,
            "acc": dict(zip("xyz", a, strict=True)),
            "note": 'a "b" {[\\',
            "gyr": list(w),
        }
        for t, a, w in samples()
    ]


def of_texts() -> list[Record]:
    """Return records as Sensor Logger exports them: a record for each sensor, all values texts."""
    records: list[Record] = [{"sensor": "Metadata", "version": "3", "device name": "phone"}]
    for t, a, w in samples():
        stamp = {"time": str(round(1.7e18 + 1e9 * t)), "seconds_elapsed": repr(t)}
        records.append(
            {"sensor": "TotalAcceleration", **stamp, **dict(zip("zyx", map(repr, a[::-1]), strict=True))}
        )
        records.append({"sensor": "Gyroscope", **stamp, **dict(zip("xyz", map(repr, w), strict=True))})
        records.append({"sensor": "Barometer", "relativeAltitude": "0.5", "pressure": "1013.2", **stamp})
    return records


def in_messages() -> list[Record]:
    """Return messages as Sensor Logger sends them, ten samples of each sensor in one."""
    found: list[Record] = []
    for first in range(0, len(T), 10):
        payload = []
        for t, a, w in samples()[first : first + 10]:
            for name, xyz in (("accelerometeruncalibrated", a), ("gyroscopeuncalibrated", w)):
                values = dict(zip("xyz", xyz, strict=True))
                payload.append({"name": name, "time": round(1.7e18 + 1e9 * t), "values": values})
        found.append({"messageId": len(found), "deviceId": "phone", "payload": payload})
    return found


def read(folder: Path, text: str, name: str = "walk.json") -> Recording:
    path = folder / name
    path.write_text(text)
    return read_all(path)


def assert_same(recording: Recording) -> None:
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz, FORCE, rtol=1e-12)
    np.testing.assert_allclose(recording.gyroscope.xyz, RATE, rtol=1e-12)
    for sensor in (recording.accelerometer, recording.gyroscope):
        np.testing.assert_allclose(sensor.t - sensor.t[0], T, atol=1e-6)


@pytest.mark.parametrize("pack", PACKS)
@pytest.mark.parametrize("records", [flat, nested, of_texts, in_messages])
def test_records_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pack: Pack, records: Callable[[], list[Record]]
) -> None:
    assert_same(read(tmp_path, pack(records())))
    monkeypatch.setattr(json_records, "_PIECE", 5000)
    assert_same(read(tmp_path, pack(records())))


STAMP = 1e3 * T[::10] + 500
"""ms of messages of ten samples each."""


def by_radio(first: int, count: int = 10) -> tuple[list[Record], list[Record]]:
    accelerations, rates = (
        [dict(zip("xyz", row, strict=True)) for row in data[first : first + count].tolist()]
        for data in (FORCE, RATE)
    )
    return accelerations, rates


def with_one_stamp() -> list[Record]:
    """Return messages as Movesense sends them."""
    found = []
    for stamp, first in zip(STAMP.tolist(), range(0, len(T), 10), strict=True):
        accelerations, rates = by_radio(first)
        body = {"Timestamp": stamp, "ArrayAcc": accelerations, "ArrayGyro": rates}
        found.append({"Body": body, "Uri": "2000/Meas/IMU6/104", "Temperature": 20.0 + first})
    return found


def of_each_sensor() -> list[Record]:
    found = []
    for stamp, first in zip(STAMP.tolist(), range(0, len(T), 10), strict=True):
        accelerations, rates = by_radio(first)
        found.append({"acc": {"Timestamp": stamp, "ArrayAcc": accelerations}})
        found.append({"gyro": {"Timestamp": stamp, "ArrayGyro": rates}})
    return found


def of_vectors() -> list[Record]:
    return [
        {"ts": stamp, "acc": FORCE[i : i + 10].tolist(), "gyr": RATE[i : i + 10].tolist()}
        for stamp, i in zip(STAMP.tolist(), range(0, len(T), 10), strict=True)
    ]


def of_axes() -> list[Record]:
    columns = {
        f"{name}_{axis}": data[:, i]
        for name, data in (("acc", FORCE), ("gyr", RATE))
        for i, axis in enumerate("xyz")
    }
    return [
        {"time_ms": stamp} | {name: values[i : i + 10].tolist() for name, values in columns.items()}
        for stamp, i in zip(STAMP.tolist(), range(0, len(T), 10), strict=True)
    ]


@pytest.mark.parametrize("pack", PACKS)
@pytest.mark.parametrize("records", [with_one_stamp, of_each_sensor, of_vectors, of_axes])
def test_the_samples_of_a_message_are_spread_between_stamps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pack: Pack, records: Callable[[], list[Record]]
) -> None:
    recording = read(tmp_path, pack(records()))
    assert_same(recording)
    assert any("several samples in a message" in note for note in recording.notes)
    monkeypatch.setattr(json_records, "_PIECE", 5000)
    assert_same(read(tmp_path, pack(records())))


def test_lost_messages_leave_a_gap(tmp_path: Path) -> None:
    messages = with_one_stamp()
    recording = read(tmp_path, lines(messages[:20] + messages[40:]))
    kept = np.r_[0:200, 400 : len(T)]
    np.testing.assert_allclose(recording.accelerometer.t - recording.accelerometer.t[0], T[kept], atol=1e-6)
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE[kept])


def test_records_are_read_from_gzip_zip_and_with_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "walk.jsonl.gz").write_bytes(gzip.compress(b"\xef\xbb\xbf" + lines(flat()).encode()))
    assert_same(read_all(tmp_path / "walk.jsonl.gz"))
    assert_same(read_all(as_zip(tmp_path, {"walk.json": array(of_texts()), "readme.txt": "a walk"})))


def test_own_columns_are_read_as_they_are(tmp_path: Path) -> None:
    names = ("t", "ax", "ay", "az", "gx", "gy", "gz")
    recording = read(tmp_path, lines([dict(zip(names, row, strict=True)) for row in DATA.tolist()]))
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE)
    np.testing.assert_array_equal(recording.accelerometer.t, T)


def test_records_with_a_key_each_are_read(tmp_path: Path) -> None:
    keyed = {f"-N{i:05d}": record for i, record in enumerate(flat())}
    assert_same(read(tmp_path, json.dumps({"device 7": {"readings": keyed}})))
    by_time = {repr(record.pop("time")): record for record in flat()}
    assert_same(read(tmp_path, json.dumps(by_time)))


def test_a_list_for_each_sensor_is_read(tmp_path: Path) -> None:
    sensors = {
        "accelerometer": [{"t": t, **dict(zip("xyz", a, strict=True))} for t, a, _ in samples()],
        "gyroscope": [{"t": t, **dict(zip("xyz", w, strict=True))} for t, _, w in samples()],
        "steps": [{"t": t, "count": i} for i, t in enumerate(T.tolist())],
    }
    assert_same(read(tmp_path, json.dumps({"device": "phone", "sensors": sensors})))


@pytest.mark.parametrize("form", ["list", "columns", "split", "index"])
def test_data_frames_are_read(tmp_path: Path, form: str) -> None:
    names = ["time", "acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"]
    columns = dict(zip(names, DATA.T.tolist(), strict=True))
    document: Record = {
        "list": columns,
        "columns": {k: {str(i): v for i, v in enumerate(column)} for k, column in columns.items()},
        "split": {"columns": names, "index": list(range(len(T))), "data": DATA.tolist()},
        "index": {str(i): dict(zip(names, row, strict=True)) for i, row in enumerate(DATA.tolist())},
    }[form]
    assert_same(read(tmp_path, json.dumps(document)))


def test_edge_impulses_format_is_read(tmp_path: Path) -> None:
    sensors = [{"name": f"acc{axis}", "units": "m/s2"} for axis in "XYZ"]
    sensors += [{"name": f"gyr{axis}", "units": "d/s"} for axis in "XYZ"]
    values = np.column_stack([FORCE, np.degrees(RATE)]).tolist()
    payload: Record = {"device_name": "7", "interval_ms": 10, "sensors": sensors, "values": values}
    document = {"protected": {"ver": "v1", "alg": "none"}, "signature": "0", "payload": payload}
    recording = read(tmp_path, json.dumps(document))
    assert_same(recording)
    del payload["interval_ms"]
    with pytest.raises(TraceError, match="no column of time stamps"):
        read(tmp_path, json.dumps(document))


def test_nested_arrays_are_read(tmp_path: Path) -> None:
    document = {
        "t": T.tolist(),
        "acc": {"x": FORCE[:, 0].tolist(), "y": FORCE[:, 1].tolist()},
        "rate_hz": 100,
    }
    document["acc"]["z"] = FORCE[:, 2].tolist()  # type: ignore[index]
    document["gyr"] = RATE.tolist()
    np.testing.assert_array_equal(read(tmp_path, json.dumps(document)).accelerometer.xyz, FORCE)


def test_rows_of_a_time_and_three_axes_are_read_for_each_sensor(tmp_path: Path) -> None:
    sensors = {"acc": np.column_stack([T, FORCE]).tolist(), "gyr": np.column_stack([T, RATE]).tolist()}
    assert_same(read(tmp_path, json.dumps({"device": "phone", **sensors})))


def test_rows_without_names_are_counted(tmp_path: Path) -> None:
    recording = read(tmp_path, json.dumps(DATA.tolist()))
    assert_same(recording)
    with pytest.raises(TraceError, match="no column of time stamps"):
        read(tmp_path, json.dumps(FORCE.tolist()))


def test_dates_are_read(tmp_path: Path) -> None:
    records = flat()
    for i, record in enumerate(records):
        record["time"] = f"2026-03-01T10:00:{i // 100:02d}.{i % 100:02d}Z"
    np.testing.assert_allclose(np.diff(read(tmp_path, lines(records)).accelerometer.t), 0.01, atol=1e-6)
    records[300]["time"] = "soon"
    with pytest.raises(TraceError, match=r"walk\.json:301: field 'time' holds 'soon', which is not a date"):
        read(tmp_path, lines(records))


def test_a_gyroscopes_own_file_is_found(tmp_path: Path) -> None:
    (tmp_path / "gyr.jsonl").write_text(
        lines([{"t": t, **dict(zip("xyz", w, strict=True))} for t, _, w in samples()])
    )
    force = lines([{"t": t, **dict(zip("xyz", a, strict=True))} for t, a, _ in samples()])
    assert_same(read(tmp_path, force, "acc.jsonl"))
    with pytest.raises(TraceError, match=r"gyr\.jsonl: holds a gyroscope and no accelerometer"):
        read_all(tmp_path / "gyr.jsonl")


def test_a_column_map_is_used(tmp_path: Path) -> None:
    time, columns = (
        '[time]\ncolumn = "ts"\nunit = "ms"',
        'columns = ["acc.y", "acc.x", "acc.z"]\nunit = "m/s^2"',
    )
    (tmp_path / "map.toml").write_text(f"{time}\n[accelerometer]\n{columns}\n")
    (tmp_path / "walk.json").write_text(lines(nested()))
    recording = read_all(tmp_path / "walk.json", tmp_path / "map.toml")
    np.testing.assert_array_equal(recording.accelerometer.xyz, FORCE[:, [1, 0, 2]])


def test_missing_and_null_fields_are_empty_cells(tmp_path: Path) -> None:
    records = flat()
    for axis in "xyz":
        del records[5][f"gyr_{axis}"]
        records[7][f"acc_{axis}"] = None
    recording = read(tmp_path, lines(records))
    assert recording.gyroscope is not None
    assert (len(recording.accelerometer), len(recording.gyroscope)) == (len(T) - 1, len(T) - 1)
    records[9]["acc_y"] = None
    with pytest.raises(TraceError, match=r"walk\.json:10: field 'acc_y' is empty"):
        read(tmp_path, lines(records))


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('{"time": 3, "acc_x": ', r"walk\.json:302: is not JSON .*"),
        (
            '{"time": 3, "acc_x": "much", "acc_y": 0, "acc_z": 9}',
            r"walk\.json:302: field 'acc_x' holds 'much'",
        ),
        ('{"time": 3, "acc_x": NaN, "acc_y": 0, "acc_z": 9}', r"walk\.json:302: field 'acc_x' holds nan"),
        ("[1, 2, 3]", r"walk\.json:302: is no JSON object"),
        ('{"time": 3, "acc_x": {"raw": 1}, "acc_y": 0, "acc_z": 9}', r"walk\.json:302: field 'acc_x' holds"),
    ],
)
def test_a_faulty_line_is_named(tmp_path: Path, line: str, said: str) -> None:
    text = lines(flat()).split("\n")
    text.insert(301, line)
    with pytest.raises(TraceError, match=said):
        read(tmp_path, "\n".join(text))


@pytest.mark.parametrize("pack", PACKS)
def test_a_file_cut_short_is_refused(tmp_path: Path, pack: Pack) -> None:
    text = pack(flat())
    for length in (len(text) // 2, len(text) - 5):
        with pytest.raises(TraceError, match=r"walk\.json:\d+: (is not JSON|the JSON ends).*copy it again"):
            read(tmp_path, text[:length])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"temperature": [1, 2, 3], "name": "x"}', "no accelerometer found in its arrays"),
        ("[]", "no records"),
        ('{"schema": 1, "accelerometer": {"bias": [0, 0, 0]}}', "is a calibration, a store or a diagnosis"),
        ("{}", "no accelerometer found"),
        ('{"a":' * 100_000, "is not JSON"),
        ("[" * 100_000, "the JSON ends within a record"),
        ('[{"x": 1}, {"x": 2}]', "no accelerometer found by its names; the header has: x"),
        ('{"a": 1}\n{"a": 2}\n', "no accelerometer found by its names"),
        (
            json.dumps({f"acc{a}": [{"ts": i, "value": i} for i in range(9)] for a in "XYZ"}),
            "lists of records",
        ),
    ],
)
def test_json_that_is_no_recording_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TraceError, match=said):
        read(tmp_path, text)


def test_a_long_object_is_refused_before_it_fills_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "long.json"
    with path.open("wb") as file:
        file.write(b'{"t": [0.1,')
        file.truncate(10 << 30)
    with pytest.raises(TraceError, match="one JSON object of more than 64 MB; write one object a line"):
        open_trace(path)


def test_a_json_recording_beside_another_is_no_file_of_claims(tmp_path: Path) -> None:
    """Both are kept: neither is read as the maker's claims, nor written over by them."""
    recording = read(tmp_path, lines(flat()), "walk.jsonl")
    for pack in (array, lines, in_an_object):
        (tmp_path / "walk.json").write_text(pack(flat()))
        assert_same(read_all(tmp_path / "walk.jsonl"))
        with pytest.raises(TraceError, match=r"walk\.json: would be replaced by the maker's claims"):
            recording.save(tmp_path / "walk.csv")
        assert (tmp_path / "walk.json").read_text() == pack(flat())
        assert not (tmp_path / "walk.csv").exists()
    (tmp_path / "walk.json").write_text('{"nominal_rate_hz": 100}')
    assert open_trace(tmp_path / "walk.jsonl").claims.nominal_rate_hz == 100


def test_what_a_browser_tells_of_motion_is_read_with_gravity(tmp_path: Path) -> None:
    still = {"x": 0.01, "y": 0.0, "z": 0.02}
    records = [
        {
            "timestamp": 1e3 * t,
            "acceleration": still,
            "accelerationIncludingGravity": dict(zip("xyz", a, strict=True)),
        }
        for t, a, _ in samples()
    ]
    np.testing.assert_array_equal(read(tmp_path, lines(records)).accelerometer.xyz, FORCE)
