"""A calibration applied to a recording, run by run, with what a user must know of it."""

from __future__ import annotations

from collections.abc import Iterable

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.terms import correct_both
from stillcal.calib_core.streams.beginning import Beginning
from stillcal.calib_core.streams.samples import Samples
from stillcal.calib_core.temperature.charger import Charger
from stillcal.calib_core.temperature.thermometer import Thermometer
from stillcal.replay.formats.claims import Event
from stillcal.replay.suitability import Suitability


class Corrector:
    """Corrects one recording.

    beginning: of the recording, also where only a part of it is read. on_for: s, how long the phone had been
    switched on then; None where nobody says, which counts as 0.
    """

    def __init__(self, record: CalibrationRecord, beginning: Beginning, on_for: float | None = None) -> None:
        self._record = record
        self._switched_on = beginning.t - (on_for or 0.0)
        self._suits = Suitability(record, start_is_known=on_for is not None)
        self._thermometer, self._charger = Thermometer(), Charger()

    def corrected(
        self, accelerometer: Samples, gyroscope: Samples | None, events: Iterable[Event]
    ) -> tuple[Samples, Samples | None]:
        """Return the next run of either sensor as true sensors would have given it. events: up to its end."""
        happened = tuple(events)
        self._charger = self._charger.with_events(happened)
        accel, gyro = correct_both(
            self._record,
            accelerometer,
            gyroscope,
            self._thermometer,
            self._charger,
            started=self._switched_on,
        )
        self._suits.see(accelerometer, accel, happened)
        if len(accel) and accel.temperature is not None:
            self._thermometer = self._thermometer.with_readings(accel.t, accel.temperature)
        return accel, gyro

    def warnings(self) -> list[str]:
        """Say what speaks against the calibration on this recording, or was assumed, a sentence each."""
        return self._suits.warnings()
