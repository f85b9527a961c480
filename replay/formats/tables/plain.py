"""Text as it is read here: in UTF-8, with line ends that have a newline. What differs is copied into that."""

from __future__ import annotations

import codecs
import io
import itertools
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

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

    def pieces(file: BinaryIO) -> Iterator[bytes]:
        # newline=None: every kind of line end becomes a newline.
        text = io.TextIOWrapper(file, encoding="utf-16" if wide else "latin-1", newline=None)
        while piece := text.read(_PIECE):
            yield piece.encode("utf-8" if wide else "latin-1")

    return _copied(source, pieces)


def copied_by_lines(source: Source, rewrite: Callable[[str], str]) -> Source:
    """Return a copy of a text with each of its lines rewritten. Raises TraceError where it cannot be made.

    A last line without its line end has none in the copy, so that it is seen to be cut short.
    """

    def pieces(file: BinaryIO) -> Iterator[bytes]:
        lines = io.TextIOWrapper(file, encoding="latin-1", newline="\n")
        first = next(lines, "").removeprefix(codecs.BOM_UTF8.decode("latin-1"))
        for line in itertools.chain([first], lines):
            end = "\n" if line.endswith("\n") else ""
            yield (rewrite(line.removesuffix("\n")) + end).encode("latin-1")

    return _copied(source, pieces)


def _copied(source: Source, pieces: Callable[[BinaryIO], Iterator[bytes]]) -> Source:
    """Return a copy in a temporary file, made of the pieces that are made of the unpacked bytes."""
    copy = tempfile.NamedTemporaryFile(prefix="stillcal-")  # noqa: SIM115 - lives as long as the source
    try:
        with source.open() as file:
            for piece in pieces(unpacked(file)):
                copy.write(piece)
        copy.flush()
    except UNREADABLE as error:
        raise damaged(source.path, error) from None
    except UnicodeError as error:
        raise TraceError(source.path, f"is no whole text in UTF-16 ({error})", "save it as UTF-8") from None
    except OSError as error:
        raise cannot_open(source.path, error) from None
    stored = Path(copy.name)
    return replace(source, size=stored.stat().st_size, opener=lambda: stored.open("rb"), keep=copy)
