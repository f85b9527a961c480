"""Lines that begin with their kind: `$VNYMR,...*69` among `$GPGGA,...`, `IMU, ...` among `GPS, ...`.

Those of the first kind that holds an inertial sensor are kept. What VectorNav's sentences hold is known (user
manual of the VN-100), and ArduPilot's text logs say it themselves (`FMT`).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

_MAG, _ACC, _GYR = (tuple(f"{word}_{axis}" for axis in "xyz") for word in ("mag", "acc", "gyr"))
_FIELDS = {
    "VNYMR": ("yaw", "pitch", "roll", *_MAG, *_ACC, *_GYR),
    "VNQMR": ("q0", "q1", "q2", "q3", *_MAG, *_ACC, *_GYR),
    "VNMAR": (*_MAG, *_ACC, *_GYR),
    "VNIMU": (*_MAG, *_ACC, *_GYR, "temperature", "pressure"),
}
"""VectorNav's sentences, in m/s^2 and rad/s."""

_SENTENCE = re.compile(
    r"^(?P<before>[^$]{0,60}?)[,;\s]*\$(?P<kind>[A-Za-z]\w*)\s*,(?P<rest>.*?)(?P<sum>\*[0-9A-Fa-f]{2})?;?\s*$"
)
"""What stands before a sentence is when it was received; behind the star is its check sum."""

_PLAIN = re.compile(r"^(?P<before>)\s*(?P<kind>[A-Z][A-Z0-9_]{1,11})\s*,(?P<rest>.*)$")
_DESCRIPTION = "FMT"
_INSTANCE = "I"
"""The column by which ArduPilot tells apart sensors of one kind."""

_FEWEST = 3
_INERTIAL = "IMU"


@dataclass(frozen=True, slots=True)
class Sentences:
    """How lines of one kind are kept and others are emptied. names: of the columns, where they are known."""

    kept: Callable[[str], str]
    names: list[str] | None
    said: str


def sentences(lines: Sequence[str]) -> Sentences | None:
    """Return which lines of a text to keep, and how; None where its lines do not begin with their kind."""
    filled = [line for line in lines if line.strip()]
    for pattern in (_SENTENCE, _PLAIN):
        found = [match for match in map(pattern.match, filled) if match]
        if len(found) >= max(_FEWEST, len(filled) / 2):
            return _of(pattern, found)
    return None


def _of(pattern: re.Pattern[str], found: Sequence[re.Match[str]]) -> Sentences | None:
    kinds = Counter(match["kind"].upper() for match in found)
    described = _described(found) if pattern is _PLAIN else {}
    known = [*(kind for kind in kinds if kind in _FIELDS), *(k for k in described if k == _INERTIAL)]
    inertial = [kind for kind in kinds if _INERTIAL in kind]
    summed = pattern is _SENTENCE and any(match["sum"] for match in found)
    kind = next(iter(known or inertial or (kinds if len(kinds) == 1 else ())), None)
    devices = not known and len(inertial) > 1
    if kind is None or devices or not (known or summed or len(kinds) > 1):
        return None
    own = next((match for match in found if match["kind"].upper() == kind), None)
    names = list(described.get(kind) or _FIELDS.get(kind) or ()) or None
    if own is not None and names is not None and own["before"].strip():
        names = ["time", *names]
    if own is not None and names is not None and len(_cells(own)) != len(names):
        names = None
    place = names.index(_INSTANCE) if names and _INSTANCE in names else None
    others = [other for other in kinds if other != kind]
    said = f"lines of {kind} are read" + (f"; passed over: {', '.join(others[:8])}" if others else "")
    return Sentences(_keeper(pattern, kind, place), names, said)


def _described(found: Sequence[re.Match[str]]) -> dict[str, list[str]]:
    """Return the columns that ArduPilot's descriptions say each kind of line has."""
    rows = ([cell.strip() for cell in m["rest"].split(",")] for m in found if m["kind"] == _DESCRIPTION)
    return {row[2]: row[4:] for row in rows if len(row) > 4}


def _cells(match: re.Match[str]) -> list[str]:
    before = match["before"].strip()
    return [*([before] if before else []), *match["rest"].split(",")]


def _keeper(pattern: re.Pattern[str], kind: str, place: int | None) -> Callable[[str], str]:
    """Return what makes cells of a line of one kind, and of its first instance, and empties others.

    place: of the cell that numbers the instances, None where there is none. Lines of no kind stay.
    """
    first: list[str] = []

    def kept(line: str) -> str:
        match = pattern.match(line)
        if match is None:
            return line
        if match["kind"].upper() != kind:
            return ""
        cells = _cells(match)
        if place is not None and len(cells) > place:
            instance = cells[place].strip()
            if instance != (first or [instance])[0]:
                return ""
            first[:] = [instance]
        return ",".join(cells)

    return kept
