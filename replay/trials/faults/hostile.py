"""Messages that are well formed and mean no good: any value in any field, generated from the definitions.

Nothing here lists what to try. A strategy is made from the type of every field of every message that a phone
may send (hypothesis prefers the ends of a type's range, its zeros, infinities and NaN), so that a message or
a field that is added to the wire is tried as well.
"""

from __future__ import annotations

import struct
import types
import typing
from collections.abc import Iterator
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Message, PhoneMessage
from stillcal.daemon.wire.sample_blocks import Coding

ROWS, RUN = 6, 12
"""Samples in a block and messages in a run, at most."""


def any_message() -> st.SearchStrategy[Message]:
    """Return a strategy for any message that a phone may send."""
    return st.one_of([_samples() if kind is Samples else _record(kind) for kind in get_args(PhoneMessage)])


def any_style() -> st.SearchStrategy[WireSettings]:
    """Return a strategy for how messages may be written."""
    return st.builds(WireSettings, form=st.sampled_from(Form), coding=st.sampled_from(Coding))


def runs(number: int, start: int) -> Iterator[bytes]:
    """Yield so many messages as bytes, in runs that one encoder wrote. start: seed."""
    written: list[bytes] = []

    @seed(start)
    @settings(
        max_examples=max(number // 2, 1),
        phases=[Phase.generate],
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.lists(any_message(), min_size=1, max_size=RUN), any_style())
    def write(messages: list[Message], style: WireSettings) -> None:
        if len(written) < number:
            written.extend(encoded(messages, style))

    while len(written) < number:
        write()
        start += 1
    yield from written[:number]


def encoded(messages: list[Message], style: WireSettings) -> list[bytes]:
    """Write messages; what this style cannot write, such as an infinite stamp as ticks, is left out."""
    encoder, written = WireEncoder(style), []
    for message in messages:
        try:
            with np.errstate(all="ignore"):
                written.append(encoder.encode(message))
        except (ValueError, OverflowError, struct.error):
            continue
    return written


def _record(kind: type) -> st.SearchStrategy[Any]:
    hints = get_type_hints(kind, include_extras=True)
    return st.builds(kind, **{name: _values(hint) for name, hint in hints.items()})


def _samples() -> st.SearchStrategy[Samples]:
    rows = st.lists(st.tuples(*[st.floats()] * 6), min_size=1, max_size=ROWS)
    return st.builds(_block, st.sampled_from(Sensor), rows, st.booleans(), st.booleans())


def _block(sensor: Sensor, rows: list[tuple[float, ...]], warm: bool, stamped: bool) -> Samples:
    table = np.array(rows)
    temperature, arrival = frozen(table[:, 4]), frozen(table[:, 5])
    return Samples(
        sensor,
        frozen(table[:, 0]),
        frozen(table[:, 1:4]),
        temperature if warm else None,
        arrival if stamped else None,
    )


def _values(hint: Any) -> st.SearchStrategy[Any]:
    """Return a strategy for the values of a field of this type. Raises TypeError for one it does not know."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is typing.Annotated:
        return st.integers(0, 2**32 - 1)
    if origin in (typing.Union, types.UnionType):
        return st.one_of([_values(a) for a in arguments])
    if origin is typing.Literal:
        return st.sampled_from(arguments)
    if origin is dict:
        keys = st.sampled_from(["device", "nominal_rate_hz"]) | st.text(max_size=20)
        return st.dictionaries(keys, _values(arguments[1]), max_size=4)
    if origin is list:
        return st.lists(_values(arguments[0]), max_size=4)
    plain = {
        float: st.floats(),
        int: st.integers(0, 2**32 - 1),
        bool: st.booleans(),
        str: st.text(max_size=40),
        type(None): st.none(),
    }
    if hint not in plain:
        raise TypeError(f"no values are known for {hint}")
    return plain[hint]
