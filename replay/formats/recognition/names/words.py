"""A column's name is cut into words: what stands in brackets, and the words before."""

from __future__ import annotations

import re
import unicodedata

from stillcal.replay.formats.recognition.names.vocabulary import ACCELERATION, RATE

_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[^A-Za-z0-9°µ²^']+")
_LONG_WORD = re.compile(
    rf"({'|'.join(sorted((w for w in ACCELERATION | RATE if len(w) > 8), key=len, reverse=True))})",
    re.IGNORECASE,
)
_WITH_GRAVITY = re.compile(r"_?(?:including|incl|with)[_ ]?g(?:ravity)?(?![a-z])", re.IGNORECASE)
"""As browsers call what an accelerometer reads: accelerationIncludingGravity (W3C, Device Orientation)."""


def cut(name: str) -> tuple[str, list[str]]:
    """Return what stands in brackets and the words before, in small letters."""
    brackets = [b.strip().lower() for b in _BRACKETS.findall(name)]
    plain = _BRACKETS.sub(" ", name.lstrip("#"))
    plain = _WITH_GRAVITY.sub(" total", plain.replace("gF", "gf").replace("IMU", "imu"))
    return (brackets[-1] if brackets else ""), split_words(plain)


def split_words(text: str) -> list[str]:
    """Return the words of a text in small letters and without accents, those of camelCase apart."""
    plain = "".join(c for c in unicodedata.normalize("NFD", text) if not unicodedata.combining(c))
    return [word.lower() for word in _CAMEL.split(plain) if word]


def spaced(text: str) -> str:
    """Return a text with the sensors' long words apart from others, as in `totalacceleration`."""

    def apart(found: re.Match[str]) -> str:
        before, after = text[: found.start()][-1:], text[found.end() :][:1]
        return f"{' ' * before.isalnum()}{found[0]}{' ' * after.isalnum()}"

    return _LONG_WORD.sub(apart, text)
