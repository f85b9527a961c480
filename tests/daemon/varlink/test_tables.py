"""Tables in questions: bounded before they are converted, converted and described as the library would."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from asyncvarlink.conversion import ConversionError, VarlinkType
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.static.settings import Ledger
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.service.energy_ledger import Day
from stillcal.daemon.service.saved_state import SavedState, decode, encode
from stillcal.daemon.store.document import StoreDocument
from stillcal.daemon.varlink import views
from stillcal.daemon.varlink.rows import MAX_ROWS, Encoded, Rows, too_large
from stillcal.daemon.varlink.types import EnergyDay, Entry, Stillness
from stillcal.replay.trials.faults.fit import gathered
from tests.support.asking import NAME, ask, connected, stored
from tests.support.living import answering, within_reason

LIBRARY = VarlinkType.from_type_annotation(list[list[float]])

anything = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=2), inner, max_size=2),
    max_leaves=12,
)


@given(anything)
def test_what_it_takes_the_library_takes_too_and_makes_the_same_of(value: Any) -> None:
    try:
        rows = Rows().fromjson(value)
    except ConversionError:
        return
    assert rows == LIBRARY.fromjson(value)
    assert all(len(row) == 3 and all(isinstance(x, float) for x in row) for row in rows)


def test_it_is_described_as_the_library_describes_it() -> None:
    assert Rows().as_varlink == LIBRARY.as_varlink
    assert Rows().optional().as_varlink == LIBRARY.optional().as_varlink


@pytest.mark.parametrize(("rows", "taken"), [(MAX_ROWS, True), (MAX_ROWS + 1, False)])
def test_a_table_has_a_thousand_rows_at_most(rows: int, taken: bool) -> None:
    table = [[1, 2.5, -3]] * rows
    if taken:
        assert len(Rows().fromjson(table)) == rows
    else:
        with pytest.raises(ConversionError):
            Rows().fromjson(table)


def test_two_full_tables_are_a_question_and_more_brackets_are_none() -> None:
    full = json.dumps({"parameters": {"samples": [[1, 2, 3]] * MAX_ROWS, "force": [[1, 2, 3]] * MAX_ROWS}})
    assert not too_large(full.encode())
    assert too_large(full.encode() + b"[]")
    assert too_large(b'{"a":' * 9) and not too_large(b'{"a":' * 8)


def test_an_oversized_table_is_refused_and_the_connection_goes_on(folder: Path, make_record: Any) -> None:
    stored(folder, make_record(1))

    async def test() -> None:
        async with answering(folder):
            line = await connected(folder)
            for rows in ([[1, 1, 1]] * 20_000, [[]] * 60_000, [[1, 1]], [[1, 2, "x"]], [[10**400, 0, 0]]):
                said = await ask(line, "Correct", parameters={"sensor": "gyroscope", "samples": rows})
                assert said["error"] == "org.varlink.service.InvalidParameter"
            few = {"sensor": "gyroscope", "samples": [[1, 2, 3]]}
            assert len((await ask(line, "Correct", parameters=few))["parameters"]["samples"]) == 1

    within_reason(test())


def test_long_answers_are_written_as_the_library_writes_them(make_record: Any) -> None:
    document = StoreDocument()
    for number in range(3):
        document = document.after_publishing(make_record(number), 32)
    state = SavedState(EngineState(pool=gathered(1, attitudes=6, each=2)))
    pool = decode(encode(state)).engine.pool  # with plain numbers
    view = SimpleNamespace(pool=pool, ledger=Ledger(), rests_held=12, record=document.current)
    daemon: Any = SimpleNamespace(view=view, now=2e6)
    still = views.stillness(daemon, 10)
    first, record = pool.held[-1], make_record(2)
    force = record.apply(first.rest.specific_force[None], Sensor.ACCELEROMETER)
    assert still.rests[0].residual == pytest.approx(float(np.linalg.norm(force)) - first.gravity.value)
    days = [Day(number, samples=3) for number in range(4)]
    assert [[day.number for day in views.energy(days, limit)] for limit in (0, 2, 9)] == [
        [],
        [2, 3],
        [0, 1, 2, 3],
    ]
    for kind, answer in (
        (Stillness, still),
        (list[Entry], views.history(document, 9)),
        (list[EnergyDay], views.energy(days, 9)),
    ):
        library = VarlinkType.from_type_annotation(kind)  # type: ignore[arg-type]
        ours = Encoded(kind)
        assert ours.as_varlink == library.as_varlink
        assert msgspec.json.encode(ours.tojson(answer)) == msgspec.json.encode(library.tojson(answer))


def test_the_description_is_the_one_that_was_published(folder: Path) -> None:
    async def test() -> str:
        async with answering(folder):
            reader, writer = await connected(folder)
            about = {
                "method": "org.varlink.service.GetInterfaceDescription",
                "parameters": {"interface": NAME},
            }
            writer.write(json.dumps(about).encode() + b"\0")
            answer = json.loads((await reader.readuntil(b"\0"))[:-1])
            return str(answer["parameters"]["description"])

    description = asyncio.run(test())
    correct = re.search(r"method Correct(.*?) -> (.*)", description)
    assert correct is not None
    assert correct[1] == (
        "(sensor: (accelerometer, gyroscope), samples: [][]float, temperature_c: ?float, force: ?[][]float, "
        "smooth_hz: ?float)"
    )
    assert correct[2] == "(samples: [][]float, delay_s: ?float)"
