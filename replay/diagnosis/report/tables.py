"""The page's tables. On a narrow screen every row becomes a block, each cell labelled by its column.

Cells are trusted HTML: the caller escapes text that came from a file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from html import escape

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


def table(heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Return a table of trusted cells; the first of a row is its name."""
    head = "".join(f'<th scope="col">{h}</th>' for h in heads)
    body = "".join(f"<tr>{''.join(_cells(heads, row))}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _cells(heads: tuple[str, ...], row: tuple[str, ...]) -> Iterator[str]:
    for head, cell in zip(heads, row, strict=True):
        yield f'<td data-head="{escape(head)}">{cell}</td>'
