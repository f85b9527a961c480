"""Text from outside, made fit for a terminal and a log."""

from __future__ import annotations


def printable(text: str) -> str:
    r"""Return a text on one line in which nothing moves a cursor: what is not printable is escaped.

    >>> printable("a phone\x1b[2J")
    'a phone\\x1b[2J'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def is_utf8(text: str) -> bool:
    r"""Return whether a word of the command line was UTF-8: Python keeps other bytes as surrogates.

    >>> is_utf8("ü"), is_utf8("\udcff")
    (True, False)
    """
    return not any("\ud800" <= c <= "\udfff" for c in text)
