"""Columns `x`, `y`, `z`: what holds them, a file or a group, or their owner says of which sensor they are."""

from __future__ import annotations

from collections.abc import Sequence

from stillcal.replay.formats.recognition.names.axes import find_axes, split_axis
from stillcal.replay.formats.recognition.names.vocabulary import ATTITUDE, OF_ROTATION, OTHER_VECTORS
from stillcal.replay.formats.recognition.names.words import cut, split_words


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
    bare = [name for name in names if name.strip().lower() in {"x", "y", "z"}]
    longer = [f"{sensor}.{name}" if name in bare else name for name in names]
    rotation = any((OF_ROTATION | ATTITUDE.keys()) & set(cut(name)[1]) for name in names)
    fits = len(bare) == 3 and not find_axes(names) and bool(find_axes(longer))
    return longer if fits and not called_otherwise(container, sensor) and not rotation else None


def called_otherwise(container: str, sensor: str) -> bool:
    """Whether what holds columns (a file's name) is called after something else than a sensor."""
    if OTHER_VECTORS & set(split_words(container)):
        return True
    return not find_axes(qualified(("x", "y", "z"), f"{container}.{sensor}"))
