"""Text as it is read here: in UTF-8, with line ends that have a newline. What differs is copied into that."""

from __future__ import annotations

import codecs
import io
import tempfile
from dataclasses import replace
from pathlib import Path

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.sources import UNREADABLE, Source, cannot_open, damaged, unpacked

UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
"""Marks with which text in UTF-16 begins."""

_PIECE = 1 << 20


def plain_text(source: Source) -> Source:
    """Return the source of a text, copied where it is in UTF-16 or its lines end as on the old Macintosh.

    Raises TraceError where the copy cannot be made.
    """
    head = source.head()
    wide = head.startswith(UTF16)
    if not wide and (b"\r" not in head or b"\n" in head):
        return source
    copy = tempfile.NamedTemporaryFile(prefix="stillcal-")  # noqa: SIM115 - lives as long as the source
    try:
        with source.open() as file:
            # newline=None: every kind of line end becomes a newline.
            encoding = "utf-16" if wide else "latin-1"
            text = io.TextIOWrapper(unpacked(file), encoding=encoding, newline=None)
            while piece := text.read(_PIECE):
                copy.write(piece.encode("utf-8" if wide else "latin-1"))
        copy.flush()
    except UNREADABLE as error:
        raise damaged(source.path, error) from None
    except UnicodeError as error:
        raise TraceError(source.path, f"is no whole text in UTF-16 ({error})", "save it as UTF-8") from None
    except OSError as error:
        raise cannot_open(source.path, error) from None
    stored = Path(copy.name)
    return replace(source, size=stored.stat().st_size, opener=lambda: stored.open("rb"), keep=copy)
