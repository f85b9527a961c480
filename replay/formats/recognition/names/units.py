"""Units as people write them, in brackets or as the last words of a name."""

from __future__ import annotations

import re
from typing import Literal

from stillcal.replay.formats.recognition.names.vocabulary import ACCELERATION, THERMOMETER

TIME_UNITS: dict[str, Literal["s", "ms", "us", "ns"]] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisec", "milliseconds", "millisecond"), "ms"),
    **dict.fromkeys(("us", "µs", "usec", "usecs", "micros", "microsec", "microseconds", "microsecond"), "us"),
    **dict.fromkeys(
        ("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanoseconds", "nanosecond"), "ns"
    ),
}
LONG_TIME_UNITS: dict[str, Literal["min", "h", "days"]] = {
    **dict.fromkeys(("min", "mins", "minute", "minutes"), "min"),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), "h"),
    **dict.fromkeys(("day", "days"), "days"),
}
"""Units that stand beside a word for time only: min is a minimum too."""

UNITS = {
    **dict.fromkeys(("m/s2", "m/s/s", "ms2", "mps2", "ms-2", "m/ssquared"), "m/s^2"),
    **dict.fromkeys(("cm/s2", "cms2", "cms-2", "gal"), "cm/s^2"),
    **dict.fromkeys(("gs", "g's", "gn"), "g"),
    "mg": "mg",
    **dict.fromkeys(("ug", "µg", "μg"), "ug"),
    **dict.fromkeys(("rad/s", "rads", "radps", "rads-1", "rad", "1/s"), "rad/s"),
    **dict.fromkeys(("mrad/s", "mrads", "mrads-1"), "mrad/s"),
    **dict.fromkeys(("deg/s", "degs", "dps", "deg", "degs-1", "d/s"), "deg/s"),
    **dict.fromkeys(("mdps", "mdeg/s"), "mdeg/s"),
}
"""Units as `spelled` gives them."""

_SPELLINGS = (
    (re.compile(r"[\s_()^*·]"), ""),
    (re.compile("²"), "2"),
    (re.compile("⁻"), "-"),
    (re.compile("¹"), "1"),
    (re.compile("°|º|degrees?"), "deg"),
    (re.compile("radians?"), "rad"),
    (re.compile("met(er|re)s?"), "m"),
    (re.compile("seconds?|secs?"), "s"),
    (re.compile("per"), "/"),
)
_LIKE_A_UNIT = re.compile(r"^[a-zµμ]*(/(s|h|hr|min)|(s|h)-\d)")
"""What a bracket holds that is a unit of acceleration or rate, though maybe none that is known."""

OTHER_UNITS = {"lsb", "lsbs", "count", "counts", "adc", "digit", "digits", "rpm"}
"""Words of axes for units that are not known here: raw counts, turns a minute."""

FORCE = {"m/s^2", "cm/s^2", "g", "mg", "ug"}
TURNING = {"rad/s", "mrad/s", "deg/s", "mdeg/s"}
KNOWN_UNITS = FORCE | TURNING
_PER_TIME = re.compile(r"/ ?s|s ?\^? ?-[12]|dps")
"""Units in brackets that tell the quantity where no word does: not "deg", which angles have too."""

_GRAVITIES = re.compile(r"[\[(]m?g[\])]")
"""The same for g and mg; a capital G is gauss."""


def is_unit(text: str) -> bool:
    """Whether a text is a unit of acceleration, rate, time or temperature."""
    word = text.lower()
    return word == "g" or spelled(word) in UNITS or word in TIME_UNITS or spelled(word) in THERMOMETER


def spelled(unit: str) -> str:
    """Return a unit in small letters in the one spelling in which units are looked up."""
    for pattern, spelling in _SPELLINGS:
        unit = pattern.sub(spelling, unit)
    return unit


def unit_in_brackets(name: str, bracket: str) -> tuple[str | None, str | None]:
    """Return the unit in the brackets of a name, and the same where it tells the quantity without a word."""
    written = spelled(bracket)
    unit = UNITS.get(written) or ("g" if bracket == "g" else None)
    telling = unit if _PER_TIME.search(bracket) or _GRAVITIES.search(name) else None
    if unit is None and _LIKE_A_UNIT.match(written):
        unit = bracket
    return unit, telling


def unit_at_end(words: list[str]) -> tuple[str | None, list[str]]:
    """Return the unit that the last words are, and the words before."""
    for count in (3, 2, 1):
        tail = spelled("".join(words[-count:])) if len(words) > count else ""
        if tail in UNITS:
            return UNITS[tail], words[:-count]
    if len(words) > 1 and words[-1] == "g" and set(words[:-1]) & ACCELERATION:
        return "g", words[:-1]
    return None, words
