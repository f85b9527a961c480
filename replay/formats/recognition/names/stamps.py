"""Columns that may be the time, and thermometers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.columns import Column
from stillcal.replay.formats.recognition.names.units import LONG_TIME_UNITS, TIME_UNITS, spelled
from stillcal.replay.formats.recognition.names.vocabulary import (
    ARRIVAL,
    COUNTERS,
    LATE,
    NEITHER,
    OF_MESSAGE,
    THERMOMETER,
    TIME,
)
from stillcal.replay.formats.recognition.names.words import cut

_WITH_UNIT = re.compile(r"^(timestamp|time|stamp|elapsed|epoch)([mun]?s|[mun]?secs?|millis|micros|nanos)$")
_OF_A_CLOCK = re.compile(
    r"^(u|unix|utc|epoch|gps|sys|system|wall|local|host|phone|device|sensor|sample|boot|run|sim|ros)(time|timestamp)$"
)
"""Words that are two: `timestampms`, `unixtime`."""


@dataclass(frozen=True, slots=True)
class Stamps:
    """A column that may be the time. unit: None where its name does not say.

    fraction: a column that may hold what is to be added to whole seconds, and its unit.
    """

    column: Column
    label: str
    unit: Literal["s", "ms", "us", "ns", "min", "h", "days"] | None
    fraction: tuple[Column, Literal["ms", "us", "ns"]] | None = None


def find_stamps(names: Sequence[str]) -> list[Stamps]:
    """Return the columns that may be the time, the likeliest first.

    A message's own stamp (ROS: header) comes before the others. A column of seconds beside one of their
    fractions (`secs`, `nsecs`) stands for both before it stands alone.
    """
    found = []
    for place, name in enumerate(names):
        bracket, words = cut(name)
        words = [part for word in words for part in _parts(word)]
        named = any(w in TIME for w in words)
        known = TIME_UNITS | (LONG_TIME_UNITS if named else {})
        units = [known[w] for w in (bracket, *words) if w in known]
        rest = [w for w in words if w not in known and w not in TIME and w != OF_MESSAGE]
        is_time = (named or (bool(units) and not rest and not bracket)) and bool(
            units or not COUNTERS & set(rest)
        )
        by_unit = bracket in TIME_UNITS
        other = set(rest) & (NEITHER - LATE) or is_thermometer(bracket, words)
        if (is_time or by_unit) and not other:
            late = (not is_time, bool(set(words) & (ARRIVAL | LATE)))
            stamps = Stamps(name, "_".join(rest), units[0] if units else None)
            found.append((late, OF_MESSAGE not in words, place, stamps))
    alone = [stamps for *_, stamps in sorted(found, key=lambda f: f[:3])]
    return [both for stamps in alone for both in (*_with_fraction(stamps, alone), stamps)]


def _parts(word: str) -> Sequence[str]:
    """Return a word, or the two that it is."""
    found = _WITH_UNIT.match(word) or _OF_A_CLOCK.match(word)
    return found.groups() if found else (word,)


def _with_fraction(seconds: Stamps, others: Sequence[Stamps]) -> list[Stamps]:
    """Return seconds with each column of the same label that may hold their fraction."""
    if seconds.unit not in ("s", None):
        return []
    alike = (s for s in others if s.label == seconds.label)
    return [replace(seconds, fraction=(s.column, s.unit)) for s in alike if s.unit in {"ms", "us", "ns"}]


def find_thermometer(names: Sequence[str], label: str) -> tuple[str, Literal["degC", "K", "degF"]] | None:
    """Return the column of temperatures of the sensor with that label, or the only one, and its unit."""
    found = []
    for name in names:
        bracket, words = cut(name)
        if is_thermometer(bracket, words):
            units = {spelled(word).removeprefix("deg") for word in (bracket, *words)}
            kelvin = bool({"k", "kelvin"} & units)
            fahrenheit = bool({"f", "fahrenheit"} & units)
            unit: Literal["degC", "K", "degF"] = "K" if kelvin else "degF" if fahrenheit else "degC"
            found.append((label not in words and label != "", name, unit))
    found.sort(key=lambda f: f[0])
    return (found[0][1], found[0][2]) if found and (not found[0][0] or len(found) == 1) else None


def is_plausible_temperature(values: Array, unit: str) -> bool:
    """Whether values (n,) of a thermometer's column, in `unit`, are temperatures that a sensor can have."""
    low, high = {"degC": (-60.0, 150.0), "K": (210.0, 430.0), "degF": (-80.0, 300.0)}[unit]
    known = values[np.isfinite(values)]
    return bool(known.size and low < np.median(known) < high)


def is_thermometer(bracket: str, words: Sequence[str]) -> bool:
    """Whether a column holds temperatures: by a word, or by a unit, as in T [°C]."""
    unit = spelled(bracket)
    of_t = list(words) == ["t"] and unit.removeprefix("deg") in {"c", "f", "k"}
    by_unit = unit in THERMOMETER or of_t
    return bool(set(words) & THERMOMETER) or list(words[-2:]) == ["deg", "c"] or by_unit
