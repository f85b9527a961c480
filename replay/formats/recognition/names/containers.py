"""Columns `x`, `y`, `z`: what holds them, a file or a group, or their owner says of which sensor they are."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from stillcal.replay.formats.recognition.names.axes import find_axes, split_axis
from stillcal.replay.formats.recognition.names.vocabulary import (
    ATTITUDE,
    OF_AXES,
    OF_ROTATION,
    OTHER_VECTORS,
)
from stillcal.replay.formats.recognition.names.words import cut, spaced, split_words


def qualified(names: Sequence[str], container: str) -> list[str]:
    """Return names, those of axes with what holds them (a file's or a group's name) where that tells more.

    `x`, `data[0]` of a file or a group `accel` are `accel.x`, `accel.data[0]`.
    """
    if find_axes(names):
        return list(names)
    longer = [name if split_axis(*cut(name))[0] is None else f"{container}.{name}" for name in names]
    return longer if find_axes(longer) else list(names)


def named_after(names: Sequence[str], sensor: str, container: str) -> list[str] | None:
    """Return names of which x, y, z are called after a sensor, as where only its owner knows which it is.

    None where others name axes or a rotation or there are several x, or what holds them (a file's name) is
    called after something else.
    """
    bare = bare_axes(names)
    longer = [f"{sensor}.{name}" if name in bare else name for name in names]
    rotation = any((OF_ROTATION | ATTITUDE.keys()) & set(cut(name)[1]) for name in names)
    fits = len(bare) == 3 and not find_axes(names) and bool(find_axes(longer))
    return longer if fits and not called_otherwise(container, sensor) and not rotation else None


def bare_axes(names: Sequence[str]) -> list[str]:
    """Return the names that say an axis and not of what: `x`, `x-axis`, `axis_x`, `x_value`."""
    found = []
    for name in names:
        axis, words = split_axis(*cut(name))
        if axis is not None and set(words) <= OF_AXES:
            found.append(name)
    return found


def name_sensors(texts: Collection[str], names: Sequence[str] = ("x", "y", "z")) -> bool:
    """Whether the texts of a column say of which sensor each row is; names: of the table's columns.

    Letters do (A, G, M) where there are no others: labels may be letters too.
    """
    sensors = [text.strip() for text in texts if find_axes(qualified(names, spaced(text)))]
    others = {text.strip().lower() for text in texts} - {text.lower() for text in sensors}
    return any(len(text) > 1 for text in sensors) or (len(sensors) > 1 and others <= {"m"})


def called_otherwise(container: str, sensor: str) -> bool:
    """Whether what holds columns (a file's name) is called after something else than a sensor."""
    if OTHER_VECTORS & set(split_words(container)):
        return True
    return not find_axes(qualified(("x", "y", "z"), f"{container}.{sensor}"))
