"""A daemon's answer as text for a terminal: names with values, and lists of records as tables."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

from stillcal.daemon.system.printable import printable

WIDTH = 24
"""Characters of the column of names; the longest, slow_rotation_deg_per_h, has 23."""

MOST_ROWS = 32
"""Rows of a table that are printed; --json has all."""

WIDE = 32
"""Characters from which on a column of text stands last, where it disturbs no other.

Where there are several such columns, each has lines of its own below its row.
"""

SEVERAL = 2
LINE = 100
"""Characters of a line of such a text."""

LEFT_OUT = ("json", "statement")
"""Columns that tables leave out: for programs, or made of the other columns. --json has them."""


def lines(value: Any, indent: str = "") -> Iterator[str]:
    """Yield a value as indented lines."""
    if isinstance(value, dict):
        for key, item in value.items():
            if isinstance(item, dict) or _is_table(item):
                yield f"{indent}{key}"
                yield from lines(item, indent + "  ")
            elif _is_of_texts(item):
                yield f"{indent}{key}"
                yield from (f"{indent}  {printable(text)}" for text in item)
            else:
                yield f"{indent}{key:<{WIDTH}} {_text(item)}"
    elif _is_table(value):
        yield from (indent + row for row in _table(value))
    elif isinstance(value, list):
        yield from (indent + _text(item) for item in value or [None])
    else:
        yield from (indent + printable(line) for line in str(value).split("\n"))


def _is_table(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(item, list | dict) for item in value)


def _is_of_texts(value: Any) -> bool:
    """Whether a value is several texts, of which one at least is as long as a sentence."""
    texts = isinstance(value, list) and len(value) > 1 and all(isinstance(item, str) for item in value)
    return texts and max(map(len, value)) > WIDE


def _table(rows: Sequence[Any]) -> Iterator[str]:
    """Yield records, or lists of numbers, as aligned columns; records have a line of their names."""
    shown = rows[:MOST_ROWS]
    if isinstance(shown[0], dict):
        names = [key for key in dict.fromkeys(key for row in shown for key in row) if key not in LEFT_OUT]
        columns = [[name, *(_named(name, row.get(name)) for row in shown)] for name in names]
        columns.sort(key=_is_wide)
    else:
        columns = [[_text(row[i]) if i < len(row) else "" for row in shown] for i in range(len(shown[0]))]
    wide = [column for column in columns if _is_wide(column)]
    beside = columns if len(wide) < SEVERAL else [column for column in columns if column not in wide]
    widths = [max(map(len, column)) for column in beside]
    for number, cells in enumerate(zip(*beside, strict=True)):
        yield "  ".join(f"{cell:<{width}}" for cell, width in zip(cells, widths, strict=True)).rstrip()
        for name, *texts in wide if len(beside) < len(columns) and number else ():
            head = f"  {name}: "
            text, indent = head + texts[number - 1], " " * len(head)
            yield from textwrap.wrap(text, LINE, subsequent_indent=indent, break_on_hyphens=False)
    if len(rows) > MOST_ROWS:
        yield f"({len(rows) - MOST_ROWS} more: --json prints all)"


def _is_wide(column: Sequence[str]) -> bool:
    return max(map(len, column)) > WIDE


def _named(name: str, value: Any) -> str:
    """Return a field of a record as text."""
    likely = name == "probability" and isinstance(value, float)
    return f"{value:.2f}" if likely else _text(value)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return "  ".join(_text(item) for item in value) or "-"
    if isinstance(value, dict):
        return "  ".join(f"{key} {_text(item)}" for key, item in value.items())
    if value is None or value == "":
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else printable(str(value))
