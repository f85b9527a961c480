"""Blocks of text read by Arrow's compiled reader, where it is installed and a file is long enough to gain.

It gives the same bits as cells.py and accepts no more; what it does not accept is read there, which names
the faulty row.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.tables.numbers import of_arrow, side_by_side
from stillcal.replay.formats.tables.table import EMPTY

LONG_BYTES = 1 << 27
"""Shorter files are read sooner than Arrow is imported, unless something else has imported it."""

Reader = Callable[[bytes, int, Sequence[int]], Array | None]
"""Given lines with commas between cells, how many they are, and places of columns, returns (rows, k).

None where it cannot read them."""


def compiled_reader(size_bytes: int, width: int) -> Reader | None:
    """Return a reader of rows of `width` cells, None for a short file or without Arrow."""
    if "pyarrow" not in sys.modules and (size_bytes < LONG_BYTES or find_spec("pyarrow") is None):
        return None
    import pyarrow as pa  # noqa: PLC0415 - an extra
    from pyarrow import csv  # noqa: PLC0415 - an extra

    # Blocks are short: Ctrl-C is obeyed between them, and Arrow need not watch for it.
    pa.enable_signal_handlers(False)
    names = [str(place) for place in range(width)]
    parsing = csv.ParseOptions(quote_char=False, double_quote=False)

    def read(text: bytes, count: int, places: Sequence[int]) -> Array | None:
        wanted = {names[place]: pa.float64() for place in places}
        reading = csv.ReadOptions(use_threads=False, block_size=len(text) + 1, column_names=names)
        converting = csv.ConvertOptions(
            column_types=wanted, include_columns=list(wanted), null_values=[""], check_utf8=False
        )
        try:
            table = csv.read_csv(pa.py_buffer(text), reading, parsing, converting)
        except pa.ArrowInvalid:
            return None
        if table.num_rows != count:
            return None
        return side_by_side([of_arrow(table.column(names[p]).combine_chunks(), EMPTY) for p in places])

    return read
