"""Which source the settings mean: a phone on a serial line, or the machine itself."""

from __future__ import annotations

from typing import Literal

from stillcal.daemon.iio_source import IioSource
from stillcal.daemon.serial_source import SerialSource
from stillcal.daemon.source_base import SerialSettings, Source


def source_of(kind: Literal["serial", "iio"], settings: SerialSettings) -> Source:
    """Return a source of a kind, not yet entered."""
    return IioSource(settings) if kind == "iio" else SerialSource(settings)
