"""How results show themselves in a notebook: plain tables of HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(rows: Iterable[Sequence[str]], caption: str = "", head: Sequence[str] = ()) -> str:
    """Return a table of text cells, escaped. caption: above it; head: the columns' titles, if any."""
    title = f'<caption style="text-align:left">{escape(caption)}</caption>' if caption else ""
    top = _row(head, "th") if head else ""
    return f"<table>{title}{top}{''.join(_row(row, 'td') for row in rows)}</table>"


def _row(cells: Sequence[str], tag: str) -> str:
    style = ' style="text-align:left"'
    return f"<tr>{''.join(f'<{tag}{style}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"
