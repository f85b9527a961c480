"""Columns that are the axes of a sensor.

`acc_x [m/s^2]`, `gyroX`, `ax_g`, `a_RS_S_z [m s^-2]`, `accelerometer_m_s2[0]`, `linear_acceleration.x`: one
word of a name is the axis, some are a unit, some say the quantity, and the rest tells the sensors of one log
apart.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass
from typing import Literal

from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.formats.columns import Column
from stillcal.replay.formats.recognition.names.units import (
    FORCE,
    KNOWN_UNITS,
    OTHER_UNITS,
    TURNING,
    unit_at_end,
    unit_in_brackets,
)
from stillcal.replay.formats.recognition.names.vocabulary import (
    ACCELERATION,
    ANGULAR,
    ATTITUDE,
    BODY_RATES,
    FILLERS,
    GRAVITY,
    LETTERS,
    NO_AXES,
    OF_CORE_MOTION,
    RATE,
    RAW,
    ROTATION,
    TURNS,
    VAGUE,
    VECTOR,
    WITHOUT_GRAVITY,
)
from stillcal.replay.formats.recognition.names.words import cut

_AXES = {"x": 0, "y": 1, "z": 2, "0": 0, "1": 1, "2": 2}
_NUMBERED = re.compile(r"^(?:v|vals?|values?|data)([012])$")
"""Axes as Android counts the values of an event."""

_WITH_NUMBER = re.compile(r"^([a-z]*?)([xyz]?)(\d+)([xyz]?)$")
"""A sensor's word with its number, as in `acc1`, `ax1`, `a1x`, or an axis with it."""

_VECTORS = ({0, 1, 2}, {1, 2, 3})
"""Numbers by which tools without axes call a vector's columns: `acc_1`, `acc_2`, `acc_3` (MATLAB)."""

_AXIS_FIRST = re.compile(r"^([xyz])([a-z]{3,})$")
"""As MAVLink has it: xacc, ygyro."""

_AXIS_AT_END = re.compile(r"^([a-z]+?)([xyz])$")
_TURN_IN_ONE = re.compile(r"^(roll|pitch|yaw)(rate|speed)$")


@dataclass(frozen=True, slots=True)
class Axes:
    """Three columns of one sensor. label: what else the names say; unit: None where they do not.

    unit is none of KNOWN_UNITS where they say one that is not known.
    quantity: the words for what it measures. gravity: columns of gravity that are to be added, where the log
    keeps it apart; sign: -1 where it gives minus the specific force.
    """

    sensor: Sensor
    label: str
    columns: tuple[Column, Column, Column]
    unit: str | None
    quantity: str = ""
    gravity: tuple[Column, Column, Column] | None = None
    sign: Literal[-1, 1] = 1

    def listed(self) -> str:
        """Return the names of its columns, one after the other."""
        return " ".join(map(str, self.columns)) + (
            f" with {' '.join(map(str, self.gravity))} added" if self.gravity else ""
        )

    def called(self, words: Set[str]) -> bool:
        """Whether one of `words` is among those for what it measures."""
        return not words.isdisjoint(self.quantity.split("_"))


@dataclass(frozen=True, slots=True)
class _Word:
    sensor: Sensor
    axis: int
    label: str
    unit: str | None
    quantity: str


def find_axes(names: Sequence[str]) -> list[Axes]:
    """Return the sensors whose three axes are all there: raw ones first, else in the table's order.

    Those of a vague name are left out where the same sensor has a plain one.
    """
    found: dict[tuple[Sensor, str, str | None, str], dict[int, str]] = {}
    unnamed = []
    for name in names:
        word = axis_of(name)
        if word is None:
            unnamed.append(name)
        else:
            key = (word.sensor, word.label, word.unit, word.quantity)
            found.setdefault(key, {}).setdefault(word.axis, name)
    for word, columns in _vectors(unnamed):
        found.setdefault((word.sensor, word.label, word.unit, word.quantity), columns)
    axes = [
        Axes(sensor, label, (columns[0], columns[1], columns[2]), unit, quantity)
        for (sensor, label, unit, quantity), columns in found.items()
        if len(columns) == 3
    ]
    plain = {(a.sensor, a.label) for a in axes if not a.called(VAGUE)}
    certain = [a for a in axes if not a.called(VAGUE) or (a.sensor, a.label) not in plain]
    free = [a for a in certain if a.sensor is Sensor.ACCELEROMETER and a.called(WITHOUT_GRAVITY)]
    if all(a.sensor is Sensor.GYROSCOPE or a in free for a in certain):
        whole = _with_gravity_apart(names)
        certain = [a for a in certain if a.columns not in {w.columns for w in whole}] + whole
    return sorted(certain, key=lambda a: not a.called(RAW))


def _vectors(names: Sequence[str]) -> Iterator[tuple[_Word, dict[int, str]]]:
    """Yield sensors whose columns are numbered and no more than three."""
    numbered: dict[tuple[str, ...], dict[int, str]] = {}
    for name in names:
        *words, number = _numbers_apart(cut(name)[1]) or [""]
        if number.isdigit() and (ACCELERATION | RATE) - LETTERS & set(words):
            numbered.setdefault(tuple(words), {})[int(number)] = name
    for before, columns in numbered.items():
        word = axis_of(" ".join((*before, "x")))
        if word is not None and set(columns) in _VECTORS:
            yield word, dict(enumerate(name for _, name in sorted(columns.items())))


def _numbers_apart(words: Sequence[str]) -> list[str]:
    """Return words with the numbers of sensors and axes apart, behind them."""
    apart: list[str] = []
    for word in words:
        found = _WITH_NUMBER.match(word)
        sensor, before, number, after = found.groups() if found else ("", "", "", "")
        fits = bool(sensor in ACCELERATION | RATE if sensor else before) and not (before and after)
        apart += [part for part in (sensor, before, after, number) if part] if fits else [word]
    return apart


def _with_gravity_apart(names: Sequence[str]) -> list[Axes]:
    """Return the accelerometers whose gravity has columns of its own, beside those of what is left.

    Their sum is what the accelerometer read (Apple, CMDeviceMotion; Android, TYPE_LINEAR_ACCELERATION).
    """
    kinds: dict[tuple[bool, str, str | None], dict[int, str]] = {}
    of_apple = set()
    for name in names:
        bracket, words = cut(name)
        unit, _ = unit_in_brackets(name, bracket)
        axis, words = split_axis(bracket, words)
        stated, words = unit_at_end(words)
        said = set(words)
        gravity, free = bool(said & GRAVITY), bool(said & WITHOUT_GRAVITY and said & ACCELERATION)
        if axis is None or gravity == free:
            continue
        label = "_".join(w for w in words if w not in GRAVITY | WITHOUT_GRAVITY | ACCELERATION)
        kinds.setdefault((gravity, label, unit or stated), {})[axis] = name
        of_apple |= {label} if said & OF_CORE_MOTION else set()
    whole = {key: (c[0], c[1], c[2]) for key, c in kinds.items() if len(c) == 3}
    return [
        Axes(
            Sensor.ACCELEROMETER,
            label,
            columns,
            unit,
            gravity=whole[True, label, unit],
            sign=-1 if label in of_apple else 1,
        )
        for (gravity, label, unit), columns in whole.items()
        if not gravity and (True, label, unit) in whole
    ]


def axis_of(name: str) -> _Word | None:
    """Return which axis of which sensor a column is, None where it is none."""
    bracket, words = cut(name)
    unit, by_unit = unit_in_brackets(name, bracket)
    axis, words = split_axis(bracket, words)
    if axis is None:
        return None
    stated, words = unit_at_end(words)
    kinds = set(words)
    unit = unit or next(iter(OTHER_UNITS & {bracket, *words}), None)
    letter = bool(kinds & ACCELERATION & LETTERS) and not kinds & RATE - LETTERS
    acceleration = bool(kinds & ACCELERATION - LETTERS) or letter or by_unit in FORCE
    rate = bool(kinds & RATE) or {"ang", "vel"} <= kinds or by_unit in TURNING
    attitude = bool(kinds & VECTOR and kinds & ROTATION)
    other = attitude or bool(kinds & NO_AXES) or (acceleration and bool(kinds & ANGULAR))
    if other or not (acceleration or rate):
        return None
    sensor = Sensor.ACCELEROMETER if acceleration else Sensor.GYROSCOPE
    unit = unit or stated or ("g" if kinds & {"gforce", "gf"} else None)
    if unit in KNOWN_UNITS and (unit in FORCE) != acceleration:
        unit = None
    plain = ACCELERATION | RATE | FILLERS
    label, quantity = ("_".join(w for w in words if (w in plain) is said) for said in (False, True))
    return _Word(sensor, axis, label, unit, quantity)


def split_axis(bracket: str, words: list[str]) -> tuple[int | None, list[str]]:
    """Return the axis and the words without it, of which one is the number of a sensor (`imu[1].x`)."""
    number, words = [bracket] if bracket.isdigit() else [], _numbers_apart(words)
    for i in reversed(range(len(words))):
        if words[i] in ("x", "y", "z"):
            return _AXES[words[i]], [*words[:i], *words[i + 1 :], *number]
        numbered = _NUMBERED.match("".join(words[max(i - 1, 0) : i + 1])) or _NUMBERED.match(words[i])
        if numbered:
            before = words[: i if words[i][0].isalpha() else i - 1]
            return _AXES[numbered[1]], [*before, *words[i + 1 :], *number]
        turns = _TURN_IN_ONE.match(words[i])
        if turns or (words[i] in ATTITUDE and TURNS & set(words)):
            about = turns[1] if turns else words[i]
            return ATTITUDE[about], [*words[:i], "bodyrate", *words[i + 1 :], *number]
        if words[i] in BODY_RATES and len(words[i + 1 :]) <= 2:
            return BODY_RATES[words[i]], [*words[:i], "bodyrate", *words[i + 1 :], *number]
        sensor, axis = _joined(words[i])
        if axis:
            return _AXES[axis], [*words[:i], sensor, *words[i + 1 :], *number]
    return (_AXES[bracket], words) if bracket in _AXES else (None, words)


def _joined(word: str) -> tuple[str, str]:
    """Return the sensor and the axis that one word says, as `accx`, `xacc`; nothing of another word."""
    ends, begins = _AXIS_AT_END.match(word), _AXIS_FIRST.match(word)
    if ends and ends[1] in ACCELERATION | RATE:
        return ends[1], ends[2]
    if begins and begins[2] in ACCELERATION | RATE | {"axis"}:
        return begins[2], begins[1]
    return "", ""
