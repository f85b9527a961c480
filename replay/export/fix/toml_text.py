"""Values in TOML, changed in its text where it is laid out plainly: one key a line below its table's heading.

Comments and the order of everything stay. Whoever calls this must read the result back and compare: a layout
that is not plain (values over several lines, inline tables) is not understood here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from stillcal.replay.phone.phone import toml_text

HEADING = re.compile(r"^\s*\[")
Table = Mapping[str, Any]


def edited(text: str, before: Table, after: Table) -> str:
    """Return the text with those values changed in which two nested tables differ."""
    lines = text.splitlines()
    _table(lines, "", before, after)
    return "\n".join(lines) + "\n"


def _table(lines: list[str], name: str, before: Table, after: Table) -> None:
    for key in {**before, **after}:
        old, new = before.get(key), after.get(key)
        inner = f"{name}.{key}" if name else key
        if old == new:
            continue
        if isinstance(old or new, Mapping):
            _table(lines, inner, old or {}, new or {})
        elif _is_rows(old) or _is_rows(new):
            _rows(lines, inner, old or (), new or ())
        else:
            _key(lines, f"[{name}]" if name else "", 0, key, new)


def _is_rows(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and isinstance(value[0], Mapping)


def _rows(lines: list[str], name: str, before: Sequence[Table], after: Sequence[Table]) -> None:
    heading = f"[[{name}]]"
    for index in range(max(len(before), len(after)) - 1, -1, -1):
        if index >= len(after):
            start, end = _block(lines, heading, index)
            del lines[start:end]
        elif index < len(before):
            for key in {**before[index], **after[index]}:
                if before[index].get(key) != after[index].get(key):
                    _key(lines, heading, index, key, after[index].get(key))
    for row in after[len(before) :]:
        lines += [heading, *toml_text(dict(row)).splitlines()]


def _block(lines: Sequence[str], heading: str, index: int) -> tuple[int, int]:
    """Return a table's lines with its heading: the top of the file for "", (n, n) where there is none."""
    starts = [i for i, line in enumerate(lines) if line.partition("#")[0].strip() == heading]
    if heading and index >= len(starts):
        return len(lines), len(lines)
    start = starts[index] if heading else 0
    following = range(start + bool(heading), len(lines))
    return start, next((i for i in following if HEADING.match(lines[i])), len(lines))


def _key(lines: list[str], heading: str, index: int, key: str, value: Any) -> None:
    """Set a key, add it, or take it out where its value is None."""
    start, end = _block(lines, heading, index)
    if start == end and heading:
        lines.append(heading)
        start, end = len(lines) - 1, len(lines)
    place = re.compile(rf"^\s*{re.escape(key)}\s*=")
    at = next((i for i in range(start, end) if place.match(lines[i])), None)
    if value is None:
        if at is not None:
            del lines[at]
        return
    fresh = toml_text({key: value}).strip()
    if at is None:
        while end > start and not lines[end - 1].strip():
            end -= 1
        lines.insert(end, fresh)
    else:
        comment = re.search(r"\s+#[^\"']*$", lines[at])
        lines[at] = fresh + (comment[0] if comment else "")
