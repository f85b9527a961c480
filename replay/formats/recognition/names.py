"""Which columns of a table are time, acceleration, rate and temperature, by how people name them.

`acc_x [m/s^2]`, `gyroX`, `ax_g`, `a_RS_S_z [m s^-2]`, `accelerometer_m_s2[0]`, `linear_acceleration.x`: a
name is cut into words, of which one is the axis, some are a unit, some say the quantity, and the rest tells
the sensors of one log apart.
"""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from typing import Literal

from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.formats.columns import Column

_ACCELERATION = {
    *(
        "a",
        "acc",
        "acce",
        "accel",
        "accelerometer",
        "accelerometers",
        "acceleration",
        "accelerations",
        "accl",
        "alpha",
    ),
    *("force", "gforce", "gf"),
    *("beschleunigung", "aceleracion", "accelerazione", "aceleracao", "versnelling", "przyspieszenie"),
    *("beschleunigungssensor", "acelerometro", "accelerometro", "accelerometre"),
    *("versnellingsmeter", "akcelerometr"),
}
_ANGULAR = {"angular", "rotation", "angolare", "angulaire", "katowa", "katowe"}
"""Words that make an acceleration an angular one."""

_RATE = {
    *(
        "w",
        "g",
        "gyr",
        "gyro",
        "gyros",
        "gyroscope",
        "gyroscopes",
        "omega",
        "rotationrate",
    ),
    *("rot", "angvel", "angrate", "turnrate", "bodyrate"),
    *("drehrate", "winkelgeschwindigkeit", "gyroskop", "giroscopio", "giroscopo", "zyroskop"),
    *("gyroscoop", "hoeksnelheid"),
    *_ANGULAR,
}
_NEITHER = {
    *(
        "mag",
        "magnetometer",
        "magnetic",
        "gravity",
        "grav",
        "free",
        "user",
        "bias",
        "drift",
        "offset",
        "sigma",
    ),
    *(
        "std",
        "var",
        "variance",
        "covariance",
        "cov",
        "setpoint",
        "sp",
        "desired",
        "des",
        "target",
        "cmd",
        "commanded",
        "quat",
        "orientation",
        "position",
        "pos",
        "integral",
    ),
}
_NO_AXES = _NEITHER | {"earth", "world", "global"}
"""Words of axes that are no sensor's. The last three mean axes fixed to the ground; a time may have them."""

FILLERS = {
    "velocity",
    "vel",
    "rate",
    "speed",
    "linear",
    "specific",
    "raw",
    "uncal",
    "uncalibrated",
    "per",
    "axis",
}
"""Words that say nothing by which sensors of one log differ."""

_RAW = {"raw", "uncal", "uncalibrated"}
_OTHER_VECTORS = {
    *("quaternion", "quaternions", "attitude", "ahrs", "euler", "compass"),
    *("direction", "directions", "normals", "velocity", "velocities"),
}
"""Words for what holds x, y, z of no sensor, which may be of gravity's size too: 1 or 9.8."""

_OF_ROTATION = {"w", "qw", "q0", "heading"}
"""Names beside x, y, z that are then a quaternion's or a pose's; so are the angles of an attitude."""

_ATTITUDE = {"roll": 0, "pitch": 1, "yaw": 2}
_TURNS = {"rate", "rates", "speed", "velocity", "vel", "gyro", "gyr", "gyroscope", "angular", "omega"}
"""Words that make roll, pitch and yaw rates about x, y and z; without one they are angles."""

_BODY_RATES = {"p": 0, "q": 1, "r": 2}
"""Rates about x, y and z as flight mechanics calls them (ISO 1151-1). All three must be there.

The word by which both kinds go on is `bodyrate`."""

_VAGUE = {"linear", "alpha", "rot", "rotation", "rotationrate", "bodyrate"}
"""Words that also stand for acceleration without gravity, angles, angular acceleration, filtered rates."""

SENSOR_WORDS = {Sensor.ACCELEROMETER: _ACCELERATION - _VAGUE, Sensor.GYROSCOPE: _RATE - _VAGUE}
"""Words that stand for a sensor and nothing else."""

_TIME = {
    *(
        "t",
        "time",
        "timestamp",
        "timestamps",
        "stamp",
        "ts",
        "elapsed",
        "epoch",
        "clock",
        "uptime",
        "datetime",
    ),
    *("zeit", "tijd", "tid", "tempo", "tiempo", "temps", "czas"),
    *("zeitstempel", "tijdstempel", "czasu"),
    "tow",  # GPS time of week
}
_TIME_UNITS: dict[str, Literal["s", "ms", "us", "ns"]] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "milliseconds", "millisecond"), "ms"),
    **dict.fromkeys(("us", "µs", "usec", "usecs", "micros", "microseconds", "microsecond"), "us"),
    **dict.fromkeys(
        ("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanoseconds", "nanosecond"), "ns"
    ),
}
_LONG_TIME_UNITS: dict[str, Literal["min", "h", "days"]] = {
    **dict.fromkeys(("min", "mins", "minute", "minutes"), "min"),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), "h"),
    **dict.fromkeys(("day", "days"), "days"),
}
"""Units that stand beside a word for time only: min is a minimum too."""

_COUNTERS = {"tick", "ticks", "count", "counter", "index", "seq", "number", "frame"}
"""Words of numbers that go forward with the samples, in no unit of time unless one is stated."""

_OF_MESSAGE = "header"
"""The word of a message's own stamp (ROS)."""

_LATE = {"offset"}
"""Words of times that count from another one: they serve where there is no other."""

_ARRIVAL = {"arrival", "utc", "received", "host", "log", "unix"}
_THERMOMETER = {
    *("temp", "temperature", "celsius", "degc", "degf"),
    *("temperatur", "temperatura", "temperatuur"),
}
_RATES_HZ = {
    "fs",
    "hz",
    "samplingrate",
    "samplerate",
    "ratehz",
    "samplingfrequency",
    "samplefrequency",
    "freq",
}

_WITHOUT_GRAVITY = {"free", "user", "linear"}
"""Words for acceleration from which gravity was taken."""

_UNITS = {
    **dict.fromkeys(("m/s2", "m/s/s", "ms2", "mps2", "ms-2", "m/ssquared"), "m/s^2"),
    **dict.fromkeys(("cm/s2", "cms2", "cms-2", "gal"), "cm/s^2"),
    **dict.fromkeys(("gs", "g's", "gn"), "g"),
    "mg": "mg",
    **dict.fromkeys(("ug", "µg", "μg"), "ug"),
    **dict.fromkeys(("rad/s", "rads", "radps", "rads-1", "rad", "1/s"), "rad/s"),
    **dict.fromkeys(("mrad/s", "mrads", "mrads-1"), "mrad/s"),
    **dict.fromkeys(("deg/s", "degs", "dps", "deg", "degs-1"), "deg/s"),
    **dict.fromkeys(("mdps", "mdeg/s"), "mdeg/s"),
}
"""Units as `_spelled` gives them."""

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

_OTHER_UNITS = {"lsb", "lsbs", "count", "counts", "adc", "digit", "digits", "rpm"}
"""Words of axes for units that are not known here: raw counts, turns a minute."""

_FORCE = {"m/s^2", "cm/s^2", "g", "mg", "ug"}
_TURNING = {"rad/s", "mrad/s", "deg/s", "mdeg/s"}
KNOWN_UNITS = _FORCE | _TURNING
_PER_TIME = re.compile(r"/ ?s|s ?\^? ?-[12]|dps")
"""Units in brackets that tell the quantity where no word does: not "deg", which angles have too."""
_GRAVITIES = re.compile(r"[\[(]m?g[\])]")
"""The same for g and mg; a capital G is gauss."""

OWN = {"t", "ax", "ay", "az"}
"""Columns by which a table is stillcal's own."""

_OWN_RATES = ("gx", "gy", "gz")

_AXES = {"x": 0, "y": 1, "z": 2, "0": 0, "1": 1, "2": 2}
_NUMBERED = re.compile(r"^(?:v|vals?|values?|data)([012])$")
"""Axes as Android counts the values of an event."""

_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[^A-Za-z0-9°µ²^']+")
_AXIS_AT_END = re.compile(r"^([a-z]+?)([xyz])$")
_LONG_WORD = re.compile(
    rf"({'|'.join(sorted((w for w in _ACCELERATION | _RATE if len(w) > 8), key=len, reverse=True))})",
    re.IGNORECASE,
)
_WITH_GRAVITY = re.compile(r"_?(?:including|incl|with)[_ ]?g(?:ravity)?(?![a-z])", re.IGNORECASE)
"""As browsers call what an accelerometer reads: accelerationIncludingGravity (W3C, Device Orientation)."""
_ROTATION = {"rotation", "rot"}
_VECTOR = {"vector", "vec"}
"""Words that make a rotation an attitude: Android's rotation vector is a part of a quaternion."""

_TURN_IN_ONE = re.compile(r"^(roll|pitch|yaw)(rate|speed)$")


@dataclass(frozen=True, slots=True)
class Axes:
    """Three columns of one sensor. label: what else the names say; unit: None where they do not.

    unit is none of KNOWN_UNITS where they say one that is not known.
    quantity: the words for what it measures.
    """

    sensor: Sensor
    label: str
    columns: tuple[Column, Column, Column]
    unit: str | None
    quantity: str = ""

    def listed(self) -> str:
        """Return the names of its columns, one after the other."""
        return " ".join(map(str, self.columns))

    def called(self, words: Set[str]) -> bool:
        """Whether one of `words` is among those for what it measures."""
        return not words.isdisjoint(self.quantity.split("_"))


@dataclass(frozen=True, slots=True)
class Stamps:
    """A column that may be the time. unit: None where its name does not say.

    fraction: a column that may hold what is to be added to whole seconds, and its unit.
    """

    column: Column
    label: str
    unit: Literal["s", "ms", "us", "ns", "min", "h", "days"] | None
    fraction: tuple[Column, Literal["ms", "us", "ns"]] | None = None


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
    for name in names:
        word = _axis_of(name)
        if word is not None:
            key = (word.sensor, word.label, word.unit, word.quantity)
            found.setdefault(key, {}).setdefault(word.axis, name)
    axes = [
        Axes(sensor, label, (columns[0], columns[1], columns[2]), unit, quantity)
        for (sensor, label, unit, quantity), columns in found.items()
        if len(columns) == 3
    ]
    plain = {(a.sensor, a.label) for a in axes if not a.called(_VAGUE)}
    certain = (a for a in axes if not a.called(_VAGUE) or (a.sensor, a.label) not in plain)
    return sorted(certain, key=lambda a: not a.called(_RAW))


def find_stamps(names: Sequence[str]) -> list[Stamps]:
    """Return the columns that may be the time, the likeliest first.

    A message's own stamp (ROS: header) comes before the others. A column of seconds beside one of their
    fractions (`secs`, `nsecs`) stands for both before it stands alone.
    """
    found = []
    for place, name in enumerate(names):
        bracket, words = _words(name)
        named = any(w in _TIME for w in words)
        known = _TIME_UNITS | (_LONG_TIME_UNITS if named else {})
        units = [known[w] for w in (bracket, *words) if w in known]
        rest = [w for w in words if w not in known and w not in _TIME and w != _OF_MESSAGE]
        is_time = (named or (bool(units) and not rest and not bracket)) and bool(
            units or not _COUNTERS & set(rest)
        )
        by_unit = bracket in _TIME_UNITS
        other = set(rest) & (_NEITHER - _LATE) or _is_thermometer(bracket, words)
        if (is_time or by_unit) and not other:
            late = bool(set(words) & (_ARRIVAL | _LATE)) or not is_time
            stamps = Stamps(name, "_".join(rest), units[0] if units else None)
            found.append((late, _OF_MESSAGE not in words, place, stamps))
    alone = [stamps for *_, stamps in sorted(found, key=lambda f: f[:3])]
    return [both for stamps in alone for both in (*_with_fraction(stamps, alone), stamps)]


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
        bracket, words = _words(name)
        if _is_thermometer(bracket, words):
            units = {_spelled(word).removeprefix("deg") for word in (bracket, *words)}
            kelvin = bool({"k", "kelvin"} & units)
            fahrenheit = bool({"f", "fahrenheit"} & units)
            unit: Literal["degC", "K", "degF"] = "K" if kelvin else "degF" if fahrenheit else "degC"
            found.append((label not in words and label != "", name, unit))
    found.sort(key=lambda f: f[0])
    return (found[0][1], found[0][2]) if found and (not found[0][0] or len(found) == 1) else None


def _is_thermometer(bracket: str, words: Sequence[str]) -> bool:
    """Whether a column holds temperatures: by a word, or by a unit, as in T [°C]."""
    unit = _spelled(bracket)
    of_t = list(words) == ["t"] and unit.removeprefix("deg") in {"c", "f", "k"}
    by_unit = unit in _THERMOMETER or of_t
    return bool(set(words) & _THERMOMETER) or list(words[-2:]) == ["deg", "c"] or by_unit


def spaced(text: str) -> str:
    """Return a text with the sensors' long words apart from others, as in `totalacceleration`."""

    def apart(found: re.Match[str]) -> str:
        before, after = text[: found.start()][-1:], text[found.end() :][:1]
        return f"{' ' * before.isalnum()}{found[0]}{' ' * after.isalnum()}"

    return _LONG_WORD.sub(apart, text)


def qualified(names: Sequence[str], container: str) -> list[str]:
    """Return names, those of axes with what holds them (a file's or a group's name) where that tells more.

    `x`, `data[0]` of a file or a group `accel` are `accel.x`, `accel.data[0]`.
    """
    if find_axes(names):
        return list(names)
    longer = [name if _split_axis(*_words(name))[0] is None else f"{container}.{name}" for name in names]
    return longer if find_axes(longer) else list(names)


def named_after(names: Sequence[str], sensor: str, container: str) -> list[str] | None:
    """Return names of which x, y, z are called after a sensor, as where only its owner knows which it is.

    None where others name axes or a rotation or there are several x, or what holds them (a file's name) is
    called after something else.
    """
    bare = [name for name in names if name.strip().lower() in {"x", "y", "z"}]
    longer = [f"{sensor}.{name}" if name in bare else name for name in names]
    rotation = any((_OF_ROTATION | _ATTITUDE.keys()) & set(_words(name)[1]) for name in names)
    fits = len(bare) == 3 and not find_axes(names) and bool(find_axes(longer))
    return longer if fits and not called_otherwise(container, sensor) and not rotation else None


def called_otherwise(container: str, sensor: str) -> bool:
    """Whether what holds columns (a file's name) is called after something else than a sensor."""
    if _OTHER_VECTORS & set(split_words(container)):
        return True
    return not find_axes(qualified(("x", "y", "z"), f"{container}.{sensor}"))


def rates_alone(names: Sequence[str]) -> bool:
    """Whether columns hold a gyroscope and not even one axis of an accelerometer."""
    if any((axis := _axis_of(name)) and axis.sensor is Sensor.ACCELEROMETER for name in names):
        return False
    return {axes.sensor for axes in find_axes(names)} == {Sensor.GYROSCOPE}


def without_gravity(names: Sequence[str]) -> list[str]:
    """Return the columns that hold acceleration from which gravity was taken, as their names say."""
    words = {name: set(_words(name)[1]) for name in names}
    return [name for name, said in words.items() if said & _WITHOUT_GRAVITY and said & _ACCELERATION]


def unread_rates(names: Sequence[str]) -> list[str]:
    """Return the columns that are called after a gyroscope, where they name no axes that are known."""
    plain = SENSOR_WORDS[Sensor.GYROSCOPE] - {"w", "g"} | {"rotationrate"}
    found = [(name, split_words(name)) for name in names if not find_stamps([name])]
    return [
        name
        for name, words in found
        if plain & {*words, *map("".join, itertools.pairwise(words))} and not _NO_AXES & set(words)
    ]


def is_own(names: Sequence[str]) -> bool:
    """Whether columns are stillcal's own, in its units: none of their kind has a name of another make."""
    there = set(names)
    if not there >= OWN:
        return False
    rates = [a for a in find_axes(names) if a.sensor is Sensor.GYROSCOPE]
    thermometer = find_thermometer(names, "")
    return (not rates or set(_OWN_RATES) <= there) and (thermometer is None or "temperature" in there)


def is_unit(text: str) -> bool:
    """Whether a text is a unit of acceleration, rate, time or temperature."""
    word = text.lower()
    return word == "g" or _spelled(word) in _UNITS or word in _TIME_UNITS or _spelled(word) in _THERMOMETER


def is_rate_hz(name: str) -> bool:
    """Whether a single number of this name is a sampling rate in Hz."""
    words = _words(name)[1]
    return bool({"".join(words), *words} & _RATES_HZ)


def _axis_of(name: str) -> _Word | None:
    """Return which axis of which sensor a column is, None where it is none."""
    bracket, words = _words(name)
    spelled = _spelled(bracket)
    unit = _UNITS.get(spelled) or ("g" if bracket == "g" else None)
    by_unit = unit if _PER_TIME.search(bracket) or _GRAVITIES.search(name) else None
    axis, words = _split_axis(bracket, words)
    if axis is None:
        return None
    stated, words = _split_unit(words)
    kinds = set(words)
    if unit is None and _LIKE_A_UNIT.match(spelled):
        unit = bracket
    unit = unit or next(iter(_OTHER_UNITS & {bracket, *words}), None)
    acceleration = bool(kinds & _ACCELERATION) or by_unit in _FORCE
    rate = bool(kinds & _RATE) or {"ang", "vel"} <= kinds or by_unit in _TURNING
    attitude = bool(kinds & _VECTOR and kinds & _ROTATION)
    other = attitude or bool(kinds & _NO_AXES) or (acceleration and bool(kinds & _ANGULAR))
    if other or not (acceleration or rate):
        return None
    sensor = Sensor.ACCELEROMETER if acceleration else Sensor.GYROSCOPE
    unit = unit or stated or ("g" if kinds & {"gforce", "gf"} else None)
    if unit in KNOWN_UNITS and (unit in _FORCE) != acceleration:
        unit = None
    plain = _ACCELERATION | _RATE | FILLERS
    label, quantity = ("_".join(w for w in words if (w in plain) is said) for said in (False, True))
    return _Word(sensor, axis, label, unit, quantity)


def _words(name: str) -> tuple[str, list[str]]:
    """Return what stands in brackets and the words before, in small letters."""
    brackets = [b.strip().lower() for b in _BRACKETS.findall(name)]
    plain = _BRACKETS.sub(" ", name.lstrip("#"))
    plain = _WITH_GRAVITY.sub(" total", plain.replace("gF", "gf").replace("IMU", "imu"))
    return (brackets[-1] if brackets else ""), split_words(plain)


def split_words(text: str) -> list[str]:
    """Return the words of a text in small letters and without accents, those of camelCase apart."""
    plain = "".join(c for c in unicodedata.normalize("NFD", text) if not unicodedata.combining(c))
    return [word.lower() for word in _CAMEL.split(plain) if word]


def _spelled(unit: str) -> str:
    """Return a unit in small letters in the one spelling in which units are looked up."""
    for pattern, spelling in _SPELLINGS:
        unit = pattern.sub(spelling, unit)
    return unit


def _split_axis(bracket: str, words: list[str]) -> tuple[int | None, list[str]]:
    """Return the axis and the words without it."""
    for i in reversed(range(len(words))):
        if words[i] in ("x", "y", "z"):
            return _AXES[words[i]], words[:i] + words[i + 1 :]
        numbered = _NUMBERED.match("".join(words[max(i - 1, 0) : i + 1])) or _NUMBERED.match(words[i])
        if numbered:
            return _AXES[numbered[1]], words[: i if words[i][0].isalpha() else i - 1] + words[i + 1 :]
        turns = _TURN_IN_ONE.match(words[i])
        if turns or (words[i] in _ATTITUDE and _TURNS & set(words)):
            about = turns[1] if turns else words[i]
            return _ATTITUDE[about], [*words[:i], "bodyrate", *words[i + 1 :]]
        if words[i] in _BODY_RATES and len(words[i + 1 :]) <= 2:
            return _BODY_RATES[words[i]], [*words[:i], "bodyrate", *words[i + 1 :]]
        ends = _AXIS_AT_END.match(words[i])
        if ends and ends[1] in (_ACCELERATION | _RATE):
            return _AXES[ends[2]], [*words[:i], ends[1], *words[i + 1 :]]
    return (_AXES[bracket], words) if bracket in _AXES else (None, words)


def _split_unit(words: list[str]) -> tuple[str | None, list[str]]:
    """Return the unit that the last words are, and the words before."""
    for count in (3, 2, 1):
        tail = _spelled("".join(words[-count:])) if len(words) > count else ""
        if tail in _UNITS:
            return _UNITS[tail], words[:-count]
    if len(words) > 1 and words[-1] == "g" and set(words[:-1]) & _ACCELERATION:
        return "g", words[:-1]
    return None, words
