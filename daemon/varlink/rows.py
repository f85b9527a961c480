"""Numbers in questions and answers: tables checked and converted at once, and bounded before that.

asyncvarlink converts a table number by number, at a hundred times the cost. Here a table that is too long is
refused by its brackets, before any of it becomes a Python object.
"""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from asyncvarlink.conversion import ConversionError, SimpleVarlinkType, VarlinkType

MAX_ROWS = 1000
"""Samples that one call corrects; more take more calls."""

MAX_BRACKETS = 2 * (MAX_ROWS + 1)
"""Lists within a question: two tables of MAX_ROWS rows."""

MAX_OBJECTS = 8
"""Objects within a question: itself, its parameters, and some to spare."""

_Row = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
_TABLE = Annotated[list[_Row], msgspec.Meta(max_length=MAX_ROWS)]


class Number(SimpleVarlinkType):
    """A number as varlink's int or float. JSON's true and false are none, although Python's are numbers."""

    def fromjson(self, obj: Any, oobstate: Any = None) -> Any:
        """Return the number. Raises ConversionError."""
        if isinstance(obj, bool):
            raise ConversionError.expected(self.as_varlink, obj)
        return super().fromjson(obj, oobstate)


class Rows(VarlinkType):
    """A table of at most MAX_ROWS rows [x, y, z], as varlink's [][]float."""

    as_type = list[list[float]]
    as_varlink = "[][]float"

    def tojson(self, obj: Any, oobstate: Any = None) -> Any:
        """Return the rows as they are."""
        return obj

    def fromjson(self, obj: Any, oobstate: Any = None) -> Any:
        """Return rows of floats. Raises ConversionError."""
        try:
            return msgspec.convert(obj, _TABLE)
        except (msgspec.ValidationError, OverflowError) as error:
            raise ConversionError(str(error)) from None


class Encoded(VarlinkType):
    """An answer that msgspec writes as it is: records, or JSON already, made once for all clients.

    described: the annotation that the interface's description shows.
    """

    def __init__(self, described: Any) -> None:
        shown = VarlinkType.from_type_annotation(described)
        self.as_type, self.as_varlink = shown.as_type, shown.as_varlink
        self.typedefs = shown.typedefs

    def tojson(self, obj: Any, oobstate: Any = None) -> Any:
        """Return what msgspec writes (msgspec.Raw is JSON already)."""
        return obj

    def fromjson(self, obj: Any, oobstate: Any = None) -> Any:
        """Return the record as it is."""
        return obj


def too_large(question: bytes) -> bool:
    """Say whether a question has more lists or objects than can be meant; a text's brackets count."""
    return question.count(b"[") > MAX_BRACKETS or question.count(b"{") > MAX_OBJECTS
