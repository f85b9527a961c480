"""What the names of all columns together say: stillcal's own, rates alone, acceleration without gravity."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.formats.recognition.names.axes import axis_of, find_axes
from stillcal.replay.formats.recognition.names.stamps import find_stamps, find_thermometer
from stillcal.replay.formats.recognition.names.vocabulary import (
    ACCELERATION,
    NO_AXES,
    OWN,
    OWN_RATES,
    RATES_HZ,
    SENSOR_WORDS,
    WITHOUT_GRAVITY,
)
from stillcal.replay.formats.recognition.names.words import cut, split_words


def is_own(names: Sequence[str]) -> bool:
    """Whether columns are stillcal's own, in its units: none of their kind has a name of another make."""
    there = set(names)
    if not there >= OWN:
        return False
    rates = [a for a in find_axes(names) if a.sensor is Sensor.GYROSCOPE]
    thermometer = find_thermometer(names, "")
    return (not rates or there >= OWN_RATES) and (thermometer is None or "temperature" in there)


def rates_alone(names: Sequence[str]) -> bool:
    """Whether columns hold a gyroscope and not even one axis of an accelerometer."""
    if any((axis := axis_of(name)) and axis.sensor is Sensor.ACCELEROMETER for name in names):
        return False
    return {axes.sensor for axes in find_axes(names)} == {Sensor.GYROSCOPE}


def without_gravity(names: Sequence[str]) -> list[str]:
    """Return the columns that hold acceleration from which gravity was taken, as their names say."""
    words = {name: set(cut(name)[1]) for name in names}
    return [name for name, said in words.items() if said & WITHOUT_GRAVITY and said & ACCELERATION]


def unread_rates(names: Sequence[str]) -> list[str]:
    """Return the columns that are called after a gyroscope, where they name no axes that are known."""
    plain = SENSOR_WORDS[Sensor.GYROSCOPE] - {"w", "g", "gy"} | {"rotationrate"}
    found = [(name, split_words(name)) for name in names if not find_stamps([name])]
    return [
        name
        for name, words in found
        if plain & {*words, *map("".join, itertools.pairwise(words))} and not NO_AXES & set(words)
    ]


def is_rate_hz(name: str) -> bool:
    """Whether a single number of this name is a sampling rate in Hz."""
    words = cut(name)[1]
    return bool({"".join(words), *words} & RATES_HZ)
