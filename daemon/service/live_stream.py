"""Corrected samples as they come: each block is corrected once, for all who listen.

Nothing is computed while nobody listens. A listener says how long samples may gather before it gets them, and
the phone's line is read as often as the most impatient one wants.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import CalibrationRecord, NotCalibratedError
from stillcal.calib_core.calibration.terms import correct, interpolated
from stillcal.calib_core.streams.samples import Samples, Sensor, warmed
from stillcal.calib_core.temperature.charger import Charger
from stillcal.calib_core.temperature.thermometer import Thermometer
from stillcal.daemon.service.batching import join_blocks
from stillcal.daemon.service.subscribers import Subscriber, Subscribers

BLOCK_ROWS = 200
"""Most samples of one block: it then takes some 20 kB as JSON, which any client can hold."""


@dataclass(frozen=True, slots=True, eq=False)
class LiveBlock:
    """Samples of one sensor. record: the calibration that they are corrected by; None where they are raw.

    host_s: CLOCK_BOOTTIME of this computer when they were read, s.
    """

    samples: Samples
    record: CalibrationRecord | None
    host_s: float

    @property
    def calibrated(self) -> bool:
        """Whether the samples are corrected."""
        return self.record is not None


@dataclass(frozen=True, slots=True, eq=False)
class Interruption:
    """Why samples before and after this do not belong together, such as a phone that was pulled out."""

    reason: str


Live = LiveBlock | Interruption


class LiveStream:
    """All listeners to corrected samples."""

    def __init__(self) -> None:
        self._listeners = Subscribers[Live]()
        self._patience: dict[Subscriber[Live], float] = {}
        self._force: Samples | None = None
        self._accelerometer: Samples | None = None

    def __len__(self) -> int:
        return len(self._listeners)

    @property
    def patience_s(self) -> float:
        """How long samples may gather before they are sent, s; inf while nobody listens."""
        return min(self._patience.values(), default=math.inf)

    def subscribe(self, patience_s: float) -> tuple[Subscriber[Live], Callable[[], None]]:
        """Subscribe; the second value is a function that unsubscribes."""
        listener, unsubscribe = self._listeners.subscribe()
        self._patience[listener] = patience_s

        def leave() -> None:
            unsubscribe()
            self._patience.pop(listener, None)

        return listener, leave

    def take(
        self,
        blocks: Sequence[Samples],
        record: CalibrationRecord | None,
        host_s: float,
        thermometer: Thermometer,
        charger: Charger,
    ) -> None:
        """Correct the samples of one reading, the accelerometer's first, and send them on.

        thermometer: its readings before them. charger: its changes of late.
        """
        if not len(self):
            self._force = self._accelerometer = None
            return
        gyroscope_first = list(join_blocks(blocks))
        for block in sorted(gyroscope_first, key=lambda block: block.sensor):
            corrected = self._corrected(block, record, thermometer, charger)
            shown, by = (block, None) if corrected is None else (corrected, record)
            for first in range(0, len(shown), BLOCK_ROWS):
                self._listeners.notify(LiveBlock(shown[first : first + BLOCK_ROWS], by, host_s))
        if self._force is not None:
            self._force = self._force[-1:]

    def interrupt(self, reason: str) -> None:
        """Tell all listeners that the samples do not continue."""
        self._force = self._accelerometer = None
        self._listeners.notify(Interruption(reason))

    def _corrected(
        self, block: Samples, record: CalibrationRecord | None, thermometer: Thermometer, charger: Charger
    ) -> Samples | None:
        """Return corrected samples; None without a calibration of their sensor."""
        if block.sensor is Sensor.ACCELEROMETER:
            self._accelerometer = block
        if record is None:
            return None
        try:
            if block.sensor is Sensor.GYROSCOPE:
                warm = block if self._accelerometer is None else warmed(block, self._accelerometer)
                corrected = correct(record, warm, self._force_at(block.t), thermometer, charger)
                return replace(corrected, temperature=block.temperature)
            force = correct(record, block, None, thermometer, charger)
        except NotCalibratedError:
            return None
        bare = Samples(force.sensor, force.t, force.xyz)
        self._force = bare if self._force is None else Samples.joined([self._force, bare])
        return force

    def _force_at(self, t: Array) -> Array | None:
        """Return the newest corrected specific force at times t (n,), s; held where it has not come yet."""
        return None if self._force is None else interpolated(self._force, t)
