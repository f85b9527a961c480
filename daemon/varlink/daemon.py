"""What the socket needs of the daemon."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.daemon.service.engine_thread import View
from stillcal.daemon.service.sample_readers import SampleReaders
from stillcal.daemon.service.saved_state import SavedState
from stillcal.daemon.service.subscribers import CalibrationSubscribers
from stillcal.daemon.sources.base import Source
from stillcal.daemon.store.document import StoreDocument


class Daemon(Protocol):
    """The daemon as the socket sees it."""

    saved: SavedState
    subscribers: CalibrationSubscribers
    readers: SampleReaders

    @property
    def view(self) -> View:
        """The engine's view."""

    @property
    def document(self) -> StoreDocument:
        """The contents of the store."""

    @property
    def source(self) -> Source:
        """The source of samples."""

    @property
    def trouble(self) -> str:
        """Why the last write failed; empty after one that succeeded."""

    @property
    def store_name(self) -> str:
        """The store's path."""

    @property
    def seed(self) -> int:
        """The seed of the random pauses between probes."""

    @property
    def claims(self) -> Mapping[str, Any]:
        """What the phone's maker claims of it."""

    @property
    def uptime_s(self) -> float:
        """Time since the daemon started, s."""

    @property
    def now(self) -> float | None:
        """The engine's time, s; None before the first sample."""

    async def rollback(self, target: int | str) -> CalibrationRecord | None:
        """Make an earlier calibration current. Raises ValueError."""

    async def calibrate(self) -> CalibrationRecord:
        """Try a full calibration now. Raises ValueError with the reason where there is no better one."""

    async def zero(self) -> CalibrationRecord:
        """Measure the gyroscope's bias now. Raises ValueError where there is no recent rest."""

    async def lay_faces(self, stop: bool) -> None:
        """Have the phone laid on its six faces, or stop that."""

    async def reload(self) -> str:
        """Read the settings again; return why they were refused, or an empty string."""
