"""Lengths of time as people say them."""

from __future__ import annotations


def duration(seconds: float | None) -> str:
    """Return a length of time (s) in words, in its two largest units.

    >>> duration(5025.0), duration(42.4), duration(None)
    ('1 h 23 min', '42 s', '-')
    """
    if seconds is None:
        return "-"
    whole = round(seconds)
    for unit, name, part, smaller in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if whole >= unit:
            rest = whole % unit // part
            return f"{whole // unit} {name}" + (f" {rest} {smaller}" if rest else "")
    return f"{whole} s"
