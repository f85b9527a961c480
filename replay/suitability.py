"""Whether a calibration suits a recording that it is applied to: temperature, charger, start, raw samples."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.catalogue import (
    follows_charger,
    follows_start,
    follows_temperature,
)
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.streams.events import Event
from stillcal.calib_core.streams.samples import Samples
from stillcal.calib_core.temperature.charger import Charger

WINDOW = 50
"""Samples whose scatter is looked at together."""

STILL = 0.05
"""m/s^2: a window whose force scatters by less on every axis is taken for rest."""

MOST_WINDOWS = 10_000
LEAST_WINDOWS = 5
WORSE = 3.0
"""A calibration that leaves gravity so many times worse at rest does not belong to these samples."""

SLACK_C = 1.0
"""degC beyond the temperatures of the calibration that are not worth a word."""


class Suitability:
    """Looks at a recording while a calibration is applied to it.

    start_is_known: whether somebody said how long the phone had been on when the recording began.
    """

    def __init__(self, record: CalibrationRecord, *, start_is_known: bool = False) -> None:
        self._record = record
        self._start_is_known = start_is_known
        self._norms: list[Array] = []
        self._coldest, self._hottest = np.inf, -np.inf
        self._charger = Charger()

    def see(self, raw: Samples, corrected: Samples, events: Iterable[Event] = ()) -> None:
        """Take events, and a run of the accelerometer's samples before and after they are corrected."""
        self._charger = self._charger.with_events(events)
        if raw.temperature is not None and np.isfinite(raw.temperature).any():
            self._coldest = min(self._coldest, float(np.nanmin(raw.temperature)))
            self._hottest = max(self._hottest, float(np.nanmax(raw.temperature)))
        before, after = (
            samples.xyz[: len(raw) // WINDOW * WINDOW].reshape(-1, WINDOW, 3) for samples in (raw, corrected)
        )
        still = (before.std(axis=1) < STILL).all(axis=1)
        norms = (np.linalg.norm(windows[still].mean(axis=1), axis=1) for windows in (before, after))
        self._norms += list(np.column_stack([*norms])[: MOST_WINDOWS - len(self._norms)])

    def warnings(self) -> list[str]:
        """Say what speaks against the calibration, or was assumed, a sentence each."""
        checks = (self._lacking, self._temperature, self._charging, self._start, self._corrected_already)
        return [text for check in checks if (text := check())]

    def _lacking(self) -> str:
        if self._record.accelerometer is not None:
            return ""
        return "the calibration is of the gyroscope alone: the accelerometer's samples stay as they are"

    def _temperature(self) -> str:
        valid = self._record.validity
        if self._coldest > self._hottest:
            effects = " and ".join(t.effect for t in self._record.terms if follows_temperature(t))
            return f"{effects}: not corrected, the recording has no temperature" if effects else ""
        if valid.temperature_min is None or valid.temperature_max is None:
            return ""
        low, high = valid.temperature_min - SLACK_C, valid.temperature_max + SLACK_C
        if low <= self._coldest and self._hottest <= high:
            return ""
        measured = f"{valid.temperature_min:.1f} to {valid.temperature_max:.1f} °C"
        return (
            f"the calibration was measured at {measured}, the recording goes from {self._coldest:.1f} to "
            f"{self._hottest:.1f} °C: outside, the calibration is extrapolated"
        )

    def _charging(self) -> str:
        if len(self._charger.t) or not any(map(follows_charger, self._record.terms)):
            return ""
        return (
            "the bias follows the charger, and the recording does not say when the phone was on it "
            "(charging events): corrected as off the charger"
        )

    def _start(self) -> str:
        effects = [term.effect for term in self._record.terms if follows_start(term)]
        if self._start_is_known or not effects:
            return ""
        return (
            f"{' and '.join(effects)}: corrected as if the phone was switched on when the recording began;"
            " if it was on before, say for how long (--on-for SECONDS, in Python on_for=)"
        )

    def _corrected_already(self) -> str:
        """Compare gravity at rest before and after: only samples that were corrected before get worse."""
        part = self._record.accelerometer
        if part is None or len(self._norms) < LEAST_WINDOWS:
            return ""
        before, after = (rms(norms - part.gravity) for norms in np.transpose(self._norms))
        if after <= WORSE * before or after <= STILL:
            return ""
        return (
            f"gravity at rest is {1000 * before / STANDARD:.2g} mg off before the correction and "
            f"{1000 * after / STANDARD:.2g} mg after: the samples are corrected already, or another phone's"
        )
