"""What the daemon asks of a phone's source, whichever kind it is: a serial line or the machine itself."""

from __future__ import annotations

from types import TracebackType
from typing import Literal, Protocol, Self

from stillcal.daemon.iio_source import IioSource
from stillcal.daemon.serial_source import LinkCounters, Record, SerialSettings, SerialSource
from stillcal.daemon.wire import Command, WireCounters


class Source(Protocol):
    """Entered once, then taken from by one task until it is closed; it finds its phone again by itself."""

    link: LinkCounters

    async def __aenter__(self) -> Self:
        """Begin to look for the phone."""

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""

    @property
    def connected(self) -> bool:
        """Whether a phone is there now."""

    @property
    def device(self) -> str:
        """Its path, "" where none is."""

    @property
    def wire(self) -> WireCounters:
        """A copy of what was counted."""

    async def take(self) -> list[Record]:
        """Wait until there is something and return all of it; an empty list once the source is closed."""

    def send(self, command: Command) -> bool:
        """Tell the phone something; say whether it is on its way."""

    def close(self) -> None:
        """Let go of the phone for good; what was read before can still be taken."""


def source_of(kind: Literal["serial", "iio"], settings: SerialSettings) -> Source:
    """Return a source of a kind, not yet entered."""
    return IioSource(settings) if kind == "iio" else SerialSource(settings)
