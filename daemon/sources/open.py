"""Choose the source that the settings name: a phone on a serial line, or the machine's own sensors."""

from __future__ import annotations

from typing import Literal

from stillcal.daemon.sources.base import SerialSettings, Source
from stillcal.daemon.sources.iio import IioSource
from stillcal.daemon.sources.serial import SerialSource


def source_of(kind: Literal["serial", "iio"], settings: SerialSettings) -> Source:
    """Return a source of a kind, not yet entered."""
    return IioSource(settings) if kind == "iio" else SerialSource(settings)
