"""Files that belong together: an accelerometer's, and one beside it that is called after the gyroscope."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.formats.recognition.names.vocabulary import FILLERS, SENSOR_WORDS
from stillcal.replay.formats.recognition.names.words import split_words

_SHORTEST = 3
"""Letters of a word that is a sensor's also within another word, as in `myacc1`."""

_SAYS_NOTHING = FILLERS | {"total"}


def rates_file(path: Path) -> Path | None:
    """Return the file beside an accelerometer's whose name is the same with a gyroscope's word; None if none.

    Words that say nothing of the sensor may differ, as in `total_acceleration` and `angular_velocity`. Of
    several files, one with no other word is taken first, then one with a word about as long: `acc` goes with
    `gyr`, `accelerometer` with `gyroscope`.
    """
    own = list(_marked(path.name, Sensor.ACCELEROMETER))
    found = []
    for other in path.parent.iterdir() if own else ():
        for word, rest in _marked(other.name, Sensor.GYROSCOPE):
            for own_word, own_rest in own:
                if _said(rest) == _said(own_rest):
                    likeness = (rest.lower() != own_rest.lower(), abs(len(word) - len(own_word)))
                    found.append((*likeness, other))
    return next((other for *_, other in sorted(found) if other.is_file()), None)


def _marked(name: str, sensor: Sensor) -> Iterator[tuple[str, str]]:
    """Yield each of the sensor's words in a file's name, and the name with a mark in its place, or places."""
    for word in SENSOR_WORDS[sensor]:
        places = [found.start() for found in re.finditer(word, name.lower()) if len(word) >= _SHORTEST]
        if places:
            yield word, re.sub(word, "*", name, flags=re.IGNORECASE)
        for place in places:
            yield word, f"{name[:place]}*{name[place + len(word) :]}"


def _said(marked: str) -> list[str]:
    """Return the words of a marked name, without the mark and those that say nothing."""
    return [word for word in split_words(marked) if word not in _SAYS_NOTHING]
