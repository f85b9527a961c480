"""Dates and times of day, as loggers and spreadsheets write them, in seconds.

Dates: 2026-03-01, 2026/3/1, 1.3.2026 (day first), 3/1/2026 (month first, unless the first number is none),
and 01-Mar-2026; a year that stands last may have two digits. Times: 10:00:00.02, 10:00:00,020, 10:00:00:020,
9:5:1.5 PM; up to three digits behind a colon are ms (10:0:0:5). Without a date also 05:01.5, minutes and
seconds; a time then goes on past midnight, or past the hour.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from functools import lru_cache

import numpy as np

from stillcal.calib_core.arrays import Array

_DAY = r"(?P<day>\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d\d(?:\d\d)?|\d\d?-[A-Za-z]{3}-\d\d(?:\d\d)?)"
_DAY += r"(?:[T_]|,? )\s*"
_CLOCK = r"(?P<one>\d{1,2}):(?P<two>[0-5]?\d)(?::(?P<three>[0-5]?\d))?(?:(?P<mark>[.,:])(?P<part>\d{1,9}))?"
_WHOLE = re.compile(rf"\s*(?:{_DAY})?{_CLOCK}\s?(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?\s*")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_EPOCH = date(1970, 1, 1).toordinal()
_DAY_S, _HOUR_S = 86400, 3600


def is_date(cell: bytes) -> bool:
    """Whether a cell is a date with a time of day, or a time of day."""
    return _nanoseconds(cell, day_first=_day_first(cell)) is not None


def kind_of_dates(first: bytes) -> str:
    """Return what a column of dates that begins with a cell is called in messages."""
    found = _matched(first)
    if found is None or found["day"] is None:
        return "times of day" if found is None or found["three"] else "minutes and seconds"
    month_first = "/" in found["day"] and not _day_first(first) and not found["day"][:4].isdigit()
    return "dates, the month first" if month_first else "dates"


def dates_in_seconds(cells: Sequence[bytes]) -> Array:
    """Return dates as s since 1970, (n,), to a microsecond; of cells that are dates (`is_date`)."""
    return Dates(cells[0]).seconds(cells) if cells else np.empty(0)


class NotADateError(ValueError):
    """A cell is no date. index: which one."""

    def __init__(self, index: int) -> None:
        super().__init__(index)
        self.index = index


class Dates:
    """Reads one column of dates from its start, in pieces. first: its first cell."""

    def __init__(self, first: bytes) -> None:
        found = _matched(first)
        self._day_first = _day_first(first)
        minutes = found is not None and found["three"] is None
        dated = found is None or found["day"] is not None
        self._period = 0 if dated else _HOUR_S if minutes else _DAY_S
        self._last: float | None = None
        self._turns = 0.0

    def seconds(self, cells: Sequence[bytes]) -> Array:
        """Return the cells as s since 1970, or since midnight, (n,). Raises NotADateError."""
        numbers = [_nanoseconds(cell, day_first=self._day_first) for cell in cells]
        if None in numbers:
            raise NotADateError(numbers.index(None))
        seconds = np.array(numbers, dtype=np.int64) / 1e9
        return self._going_on(seconds) if self._period and seconds.size else seconds

    def _going_on(self, seconds: Array) -> Array:
        """Return times of day with a day, or an hour, added wherever they begin anew."""
        before = seconds[0] if self._last is None else self._last
        turns = np.cumsum(np.maximum(np.round(-np.diff(seconds, prepend=before) / self._period), 0.0))
        self._last = float(seconds[-1])
        turns += self._turns
        self._turns = float(turns[-1])
        return np.asarray(seconds + self._period * turns)


def _matched(cell: bytes) -> re.Match[str] | None:
    try:
        return _WHOLE.fullmatch(cell.decode("ascii"))
    except UnicodeDecodeError:
        return None


def _day_first(cell: bytes) -> bool:
    """Whether the day stands before the month in a date of numbers that ends with its year."""
    found = _matched(cell)
    if found is None or found["day"] is None:
        return False
    return "." in found["day"] or int(re.split(r"\D", found["day"])[0]) > 12


def _nanoseconds(cell: bytes, *, day_first: bool) -> int | None:
    """Return a date as ns since 1970, a time of day as ns since midnight, None where it is neither."""
    found = _matched(cell)
    if found is None:
        return None
    one, two, three, part = found["one"], found["two"], found["three"], found["part"]
    if found["day"] is None and three is None:
        seconds = 60 * int(one) + int(two) if part and not found["half"] and not found["zone"] else None
    else:
        seconds = None if three is None else _of_day(int(one), int(two), int(three), found["half"])
    days = 0 if found["day"] is None else _days(found["day"], day_first)
    if seconds is None or days is None:
        return None
    zone = found["zone"]
    if zone and zone != "Z":
        east = 3600 * int(zone[1:3]) + 60 * int(zone[-2:])
        seconds -= east if zone[0] == "+" else -east
    counted = found["mark"] == ":" and len(part) <= len("999")
    return (days * _DAY_S + seconds) * 1_000_000_000 + int(
        f"{part}000000" if counted else (part or "0").ljust(9, "0")
    )


def _of_day(hours: int, minutes: int, seconds: int, half: str | None) -> int | None:
    if half is not None:
        if not 1 <= hours <= 12:
            return None
        hours = hours % 12 + (12 if half in ("PM", "pm", "Pm", "pM") else 0)
    return None if hours > 23 else 3600 * hours + 60 * minutes + seconds


@lru_cache(maxsize=64)
def _days(text: str, day_first: bool) -> int | None:
    """Return the days since 1970 of a date, None where there is no such day."""
    first, second, third = re.split(r"[-/.]", text)
    try:
        if second.isalpha():
            year, month, day = _year(third), _MONTHS.index(second.lower()) + 1, int(first)
        elif len(first) == 4:
            year, month, day = int(first), int(second), int(third)
        else:
            year, month, day = (
                _year(third),
                int(second if day_first else first),
                int(first if day_first else second),
            )
        return date(year, month, day).toordinal() - _EPOCH
    except ValueError:
        return None


def _year(text: str) -> int:
    """Return a year, that of this century where it has two digits."""
    return int(text) + (2000 if len(text) == 2 else 0)
