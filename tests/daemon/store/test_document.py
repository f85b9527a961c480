"""The store's JSON: its layout, its checksum, its refusals, its migrations."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.codec import jsonable
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.store.document import (
    MIGRATIONS,
    SCHEMA,
    WIDTH,
    Fault,
    StoreDocument,
    StoreFormatError,
    calibration_json,
    checksum,
    fewest_parameters,
    parse,
    pretty,
    render,
)
from tests.support.store_documents import published

GOLDEN = Path(__file__).parents[2] / "golden"


def with_checksum(value: dict) -> bytes:
    return json.dumps(value | {"checksum": checksum(value)}).encode()


def test_what_is_written_is_read_back_to_the_last_bit(document):
    again, schema = parse(render(document))
    assert schema == SCHEMA
    assert render(again) == render(document)
    assert np.array_equal(again.current.accelerometer.bias, document.current.accelerometer.bias)
    assert again.current.id == document.current.id


def test_an_outside_tool_applies_it_from_the_top_level_keys(document, make_record):
    value = json.loads(render(document))
    raw = np.array([0.3, -1.2, 9.9])
    part = value["accelerometer"]
    corrected = np.array(part["scale"]) @ (raw - np.array(part["bias"]))
    assert value["schema"] == 1
    assert {
        "scale",
        "bias",
        "gravity",
        "parameters",
        "covariance",
        "rms_residual",
        "n_rests",
        "n_states",
    } <= set(part)
    assert {"scale", "bias"} <= set(value["gyroscope"])
    assert len(value["states"]) == 2
    np.testing.assert_allclose(corrected, make_record(2).apply(raw, Sensor.ACCELEROMETER), rtol=1e-15)


def test_an_outside_tool_checks_the_checksum_with_its_own_json(document):
    value = json.loads(render(document))
    stated = value.pop("checksum")
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"))
    assert stated == "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()


def test_no_nan_or_infinity_is_ever_written(document):
    def refuse(name):
        raise AssertionError(name)

    value = json.loads(render(document), parse_constant=refuse)
    assert value["accelerometer"]["covariance"][1][1] is None
    assert value["accelerometer"]["covariance"][2][2] is None


def test_vectors_stand_on_one_line_and_keys_on_their_own(document):
    lines = render(document).decode().splitlines()
    assert '    "bias": [0.02, -0.2, 0.3],' in lines
    assert '  "schema": 1,' in lines


plain_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(), inner, max_size=5),
    max_leaves=40,
)


@given(plain_values)
def test_pretty_is_the_same_json(value):
    assert json.loads(pretty(value)) == value


@given(st.binary(max_size=200))
def test_random_bytes_are_refused_and_never_crash(data):
    with pytest.raises(StoreFormatError):
        parse(data)


def test_one_bit_of_the_schema_does_not_lose_the_calibration(make_record):
    good = render(StoreDocument(current=make_record(1)))
    assert b'"schema": 1,' in good
    with pytest.raises(StoreFormatError, match="schema 0, which had no checksum") as refused:
        parse(good.replace(b'"schema": 1,', b'"schema": 0,', 1))
    assert refused.value.fault == Fault.CORRUPT


@given(st.data())
def test_any_changed_byte_is_noticed_or_changes_nothing(make_record, data):
    good = render(StoreDocument(current=make_record(1)))
    at = data.draw(st.integers(0, len(good) - 1))
    bad = good[:at] + bytes([good[at] ^ data.draw(st.integers(1, 255))]) + good[at + 1 :]
    try:
        document, _ = parse(bad)
    except StoreFormatError:
        return
    assert render(document) == good


@given(st.data())
def test_any_truncation_is_noticed(make_record, data):
    good = render(StoreDocument(current=make_record(1))).rstrip()
    with pytest.raises(StoreFormatError) as refusal:
        parse(good[: data.draw(st.integers(0, len(good) - 1))])
    assert refusal.value.fault is Fault.UNREADABLE


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"", Fault.UNREADABLE),
        (b"[" * 100_000, Fault.UNREADABLE),
        (b'{"schema": NaN}', Fault.UNREADABLE),
        (b"[1, 2]", Fault.FOREIGN),
        (b'{"name": "somebody else"}', Fault.FOREIGN),
        (b'{"schema": 1, "rows": []}', Fault.FOREIGN),
        (b'{"schema": true, "accelerometer": null}', Fault.FOREIGN),
        (b'{"schema": -1, "accelerometer": null}', Fault.FOREIGN),
        (b'{"schema": 2, "findings": []}', Fault.FOREIGN),
        (b'{"schema": 2, "checksum": "sha256:0"}', Fault.NEWER),
        (b'{"schema": 1, "accelerometer": null, "gyroscope": null, "checksum": "sha256:0"}', Fault.CORRUPT),
        (b'{"accel": {"S": [[1, 2], [3, 4]], "b": [0, 0, 0]}}', Fault.INVALID),
        (b'{"accel": 5}', Fault.INVALID),
    ],
)
def test_what_is_no_good_store_is_named(data, fault):
    with pytest.raises(StoreFormatError) as refusal:
        parse(data)
    assert refusal.value.fault is fault


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("accelerometer", "bias"), [1.0, 2.0]),
        (("accelerometer", "bias", 1), None),
        (("accelerometer", "scale", 0), [0.0, 0.0, 0.0]),
        (("accelerometer", "scale", 0, 0), 30.0),
        (("accelerometer", "gravity"), -9.81),
        (("accelerometer", "gravity"), 1.0),
        (("accelerometer", "unit"), "g"),
        (("accelerometer", "parameters"), "nine"),
        (("accelerometer", "covariance"), [[1.0, 2.0, 3.0]]),
        (("accelerometer", "covariance", 0, 0), -1.0),
        (("accelerometer", "n_states"), 13),
        (("gyroscope", "unit"), "deg/s"),
        (("gravity", "value"), 3.7),
        (("states", 0, "specific_force"), [1.0]),
        (("units", "force"), "g"),
        (("history", 0, "what"), "lost"),
        (("history",), None),
    ],
)
def test_contents_that_make_no_sense_are_refused_despite_a_right_checksum(document, keys, value):
    whole = json.loads(render(document))
    place = whole
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    with pytest.raises(StoreFormatError) as refusal:
        parse(with_checksum(whole))
    assert refusal.value.fault is Fault.INVALID


def test_a_store_without_a_calibration_is_whole(make_record):
    document = StoreDocument().after_rejecting(make_record(1), "too few rests", 32)
    again, _ = parse(render(document))
    assert again.current is None
    assert [entry.what for entry in again.history] == ["rejected"]


def test_keys_that_a_later_minor_version_adds_do_no_harm(document):
    value = json.loads(render(document))
    value["colour"] = "blue"
    value["accelerometer"]["colour"] = "blue"
    assert parse(with_checksum(value))[0].current.id == document.current.id


def test_every_earlier_schema_has_a_migration_and_a_golden_store():
    assert sorted(MIGRATIONS) == list(range(SCHEMA))
    assert all((GOLDEN / f"store-schema-{n}.json").exists() for n in range(SCHEMA + 1))


def test_schema_0_is_migrated():
    data = (GOLDEN / "store-schema-0.json").read_bytes()
    old = json.loads(data)
    document, schema = parse(data)
    assert schema == 0
    assert jsonable(document.current.accelerometer)["scale"] == old["accel"]["S"]
    assert jsonable(document.current.accelerometer)["bias"] == old["accel"]["b"]
    assert jsonable(document.current.gyroscope)["bias"] == old["gyro"]["b"]
    assert document.current.accelerometer.parameters == 9
    assert document.current.acceptance.how == "migration"
    assert parse(render(document))[1] == SCHEMA


def test_schema_0_with_one_sensor_only_is_migrated():
    gyro = json.loads((GOLDEN / "store-schema-0.json").read_bytes())["gyro"]
    document, _ = parse(json.dumps({"gyro": gyro}).encode())
    assert document.current.accelerometer is None
    assert document.current.gyroscope is not None


def test_schema_1_as_once_written_is_still_read():
    data = (GOLDEN / "store-schema-1.json").read_bytes()
    document, schema = parse(data)
    assert schema == 1
    assert document.current.accelerometer.bias.tolist() == [0.02, -0.2, 0.3]
    assert [entry.what for entry in document.history] == ["replaced", "rejected"]
    again, _ = parse(render(document))
    assert render(again) == render(document)


@pytest.mark.parametrize(
    ("scale", "parameters"),
    [
        (np.diag([1.0, 1.1, 0.9]), 6),
        (np.eye(3) + np.triu(np.full((3, 3), 0.01), 1), 9),
        (np.eye(3) + np.tril(np.full((3, 3), 0.01), -1), 9),
        (np.eye(3) + 0.01, 9),
        (np.eye(3) + 0.01 * np.arange(9).reshape(3, 3), 12),
    ],
)
def test_the_fewest_parameters_that_give_a_matrix(scale, parameters):
    assert fewest_parameters(scale) == parameters


def test_figures_survive_as_finite_or_unknown(make_record):
    again = parse(render(StoreDocument(current=make_record(1))))[0].current
    assert math.isclose(again.accelerometer.bias_uncertainty[0], 1e-3)
    assert np.isnan(again.accelerometer.bias_uncertainty[1:]).all()


# Its layout and its schemas, to the column


def test_nothing_current_is_said_in_full():
    value = calibration_json(None)
    assert list(value)[:4] == ["schema", "format", "model", "units"]
    assert (value["schema"], value["id"]) == (1, None)
    assert (value["accelerometer"], value["gyroscope"], value["states"]) == (None, None, [])


@pytest.mark.parametrize("more", [0, 1])
def test_a_value_fills_110_columns_and_no_more(more):
    assert WIDTH == 110
    inner = {"k": "x" * (WIDTH - 4 - len('"key": {"k": ""}') + more)}
    text = pretty({"outer": {"key": inner, "list": [[1], [2]], "long": "y" * WIDTH}})
    line = next(line for line in text.splitlines() if '"key"' in line)
    assert (len(line.rstrip(",")) == WIDTH) == (more == 0)
    assert json.loads(text) == {"outer": {"key": inner, "list": [[1], [2]], "long": "y" * WIDTH}}


@pytest.mark.parametrize("more", [0, 1])
def test_a_list_of_vectors_fills_110_columns_and_no_more(more):
    rows = [[1], ["x" * (WIDTH - 2 - len('"m": [[1], [""]]') + more)]]
    text = pretty({"m": rows, "z": 0})
    assert ('"m": [[1], [' in text) == (more == 0)
    assert max(map(len, text.splitlines())) <= WIDTH + 1
    assert json.loads(text) == {"m": rows, "z": 0}


def test_the_document_itself_is_never_one_line(make_record):
    assert pretty({"a": [1], "b": {"c": [[1], [2]]}}).splitlines() == [
        "{",
        '  "a": [1],',
        '  "b": {"c": [[1], [2]]}',
        "}",
    ]


def test_a_vector_stays_on_one_line_however_long():
    long = list(range(100))
    assert f'  "v": {json.dumps(long)},' in pretty({"v": long, "w": 1}).splitlines()


def test_a_store_of_the_gyroscope_alone_is_read(make_record):
    document = published(replace(make_record(1), accelerometer=None))
    again = parse(render(document))[0].current
    assert again.accelerometer is None and again.gyroscope is not None


@pytest.mark.parametrize("missing", ["accelerometer", "gyroscope", "checksum"])
def test_a_schema_1_without_its_keys_is_foreign(make_record, missing):
    value = json.loads(render(published(make_record(1))))
    del value[missing]
    with pytest.raises(StoreFormatError, match="but not a stillcal store") as refusal:
        parse(json.dumps(value).encode())
    assert refusal.value.fault is Fault.FOREIGN


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_either_sensor_makes_a_schema_0(sensor):
    data = json.dumps({sensor: {"S": np.eye(3).tolist(), "b": [0.1, 0.2, 0.3]}}).encode()
    document, schema = parse(data)
    assert schema == 0
    found = document.current.accelerometer if sensor == "accel" else document.current.gyroscope
    assert found.bias.tolist() == [0.1, 0.2, 0.3]
    if sensor == "accel":
        assert found.gravity == 9.80665
