"""The page's tables. On a narrow screen every row becomes a block, each cell labelled by its column.

Cells are trusted HTML: the caller escapes text that came from a file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from html import escape
from typing import Any

import numpy as np

from stillcal.calib_core.diagnosis.model.records import Finding, Parameter
from stillcal.replay.diagnosis.wording import number, readable

STYLE = """
.scroll{overflow-x:auto}table{border-collapse:collapse;font-size:.9rem}
th,td{overflow-wrap:normal;text-align:left;vertical-align:top;
 padding:.25rem .9rem .25rem 0;border-bottom:1px solid #ddd}
@media(max-width:44rem){
 thead{display:none}table,tbody,tr,td{display:block}tr{border-bottom:1px solid #bbb;padding:.4rem 0}
 td{display:flex;gap:.8rem;border:0;padding:.1rem 0;overflow-wrap:anywhere}td:empty{display:none}
 td::before{content:attr(data-head);color:#555;flex:0 0 9.5rem}
 td:first-child{font-weight:600}td:first-child::before{content:none}}
"""

LEAST, MOST = 6, 16
"""Statistics of a comparison that are shown, so many if none differs and if many do."""

SMALLEST_P = 1e-300
"""A smaller p-value is printed as less than this: floating-point numbers end near it."""


def table(heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Return a table of trusted cells; the first of a row is its name."""
    head = "".join(f'<th scope="col">{h}</th>' for h in heads)
    body = "".join(f"<tr>{''.join(_cells(heads, row))}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _cells(heads: tuple[str, ...], row: tuple[str, ...]) -> Iterator[str]:
    for head, cell in zip(heads, row, strict=True):
        yield f'<td data-head="{escape(head)}">{cell}</td>'


def parameters(finding: Finding) -> str:
    """Return a finding's parameters, every number in a row of its own with its interval."""
    rows = [
        (escape(name), number(value), interval, escape(readable(p.unit)))
        for key, p in finding.parameters.items()
        for name, value, interval in _numbers(key, p)
    ]
    return table(("parameter", "value", "95 % interval", "unit"), rows)


def _numbers(name: str, parameter: Parameter) -> Iterator[tuple[str, float, str]]:
    pairs = np.asarray(parameter.ci95, dtype=np.float64).reshape(-1, 2)
    for (place, value), (low, high) in zip(_flat(parameter.value), pairs.tolist(), strict=True):
        yield f"{name} {place}".strip(), value, _interval(low, high)


def _flat(value: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Give every number of a nested list with its place, by axes where there are three."""
    if not isinstance(value, list):
        yield place, float(value)
        return
    for i, part in enumerate(value):
        yield from _flat(part, place + ("xyz"[i] if len(value) == 3 else f"{' ' * bool(place)}{i + 1}"))


def _interval(low: float, high: float) -> str:
    return "exact" if low == high else f"{number(low)} to {number(high)}"


def p_words(p: float, level: float | None = None) -> str:
    """Return a p value; below `level` it is marked."""
    if p >= 0.995:
        text = "1"
    elif p >= 0.001:
        text = f"{p:.2g}"
    else:
        text = f"{p:.0e}" if p > SMALLEST_P else f"&lt; {SMALLEST_P:.0e}"
    return f'<span class="no">{text}</span>' if level is not None and p < level else text


def comparison(before: dict[str, Any], after: dict[str, Any] | None = None) -> str:
    """Return the tests that differ most, for one simulation or for one before and one after."""
    sides = [before] if after is None else [before, after]
    tests = [{(t["statistic"], t["channel"]): t for t in side["tests"]} for side in sides]
    keys = sorted({k: 0 for side in tests for k in side}, key=lambda k: _least(tests, k))
    level = before["level"]
    differing = sum(_least(tests, k) < level for k in keys)
    shown_keys = keys[: min(max(differing, LEAST), MOST)]
    times = ("",) if after is None else (" before", " after")
    value_heads = (f"{what}{time}" for time in times for what in ("simulated", "p"))
    heads = ("statistic", "channel", "unit", "recorded", *value_heads)
    what = (
        f"All {len(keys)} tests"
        if len(shown_keys) == len(keys)
        else f"{len(shown_keys)} of {len(keys)} tests"
    )
    note = (
        f"<p>{what}, most different first. The p-values are corrected for their number; below {level:g}"
        " the simulation is rejected.</p>"
    )
    return note + table(heads, [_compared(tests, key, level) for key in shown_keys])


def _least(tests: list[dict[tuple[str, str], Any]], key: tuple[str, str]) -> float:
    return min(float(side[key]["p_value"]) for side in tests if key in side)


def _compared(tests: list[dict[tuple[str, str], Any]], key: tuple[str, str], level: float) -> tuple[str, ...]:
    one = next(side[key] for side in tests if key in side)
    cells = [
        escape(one["statistic"].replace("_", " ")),
        escape(one["channel"]),
        escape(readable(one["unit"])),
    ]
    cells.append(number(one["recorded"]))
    for side in tests:
        t = side.get(key)
        cells += ["", ""] if t is None else [number(t["simulated"]), p_words(t["p_corrected"], level)]
    return tuple(cells)
