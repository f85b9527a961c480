"""Keep the calibration in the chip's own registers (IIO), so that every program that reads it profits.

It is written when it changes, when the bias has moved with temperature, and when the chip has lost it. When
the daemon stops, the registers get back what they held before.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.terms import bias_terms
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.service.subscribers import CalibrationSubscribers
from stillcal.daemon.sources.base import Source
from stillcal.daemon.sources.chip_correction import put_back
from stillcal.daemon.sources.iio import IioSource
from stillcal.daemon.system.log import say

LOOK_S = 60.0
"""Time between two looks at the registers, s: a deep sleep resets them, and the bias follows warmth."""


def memory_path(store: Path) -> Path:
    """Return where the registers' values of before are kept: beside the store."""
    return store.with_name(f"{store.stem}.chip.json")


async def keeping_chip(
    source: Callable[[], Source],
    record: Callable[[], CalibrationRecord | None],
    changes: CalibrationSubscribers,
    memory: Path,
) -> None:
    """Keep the current calibration in the chip until cancelled; then put back what it held."""
    listener, unsubscribe = changes.subscribe()
    said = ""
    try:
        while True:
            trouble = _written(source(), record(), memory)
            if trouble and trouble != said:
                say("warning", "chip", trouble)
            said = trouble
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    await listener.queue.get()
    finally:
        unsubscribe()
        try:
            if files := put_back(memory):
                say("info", "chip", "its registers hold again what they did before", files=len(files))
        except OSError as error:
            say("warning", "chip", f"its registers keep the calibration: {error.strerror or error}")


def _written(source: Source, record: CalibrationRecord | None, memory: Path) -> str:
    """Write the calibration where it is not in the chip yet; return why that cannot be, or nothing."""
    if not isinstance(source, IioSource) or not source.connected or record is None:
        return ""
    try:
        models = {Sensor.ACCELEROMETER: record.accelerometer, Sensor.GYROSCOPE: record.gyroscope}
        for sensor, model in models.items():
            if model is not None:
                bias = model.bias + _by_temperature(record, sensor, source.celsius)
                if source.correct_chip(sensor, bias, model.scale, memory):
                    say("info", "chip", f"corrects the {sensor} itself", calibration=record.id)
    except ValueError as error:  # also of a file that holds no number
        return str(error)
    except OSError as error:
        return f"{error.filename or source.device}: {error.strerror or error}: let the daemon's user write it"
    return ""


def _by_temperature(record: CalibrationRecord, sensor: Sensor, celsius: float | None) -> Array:
    return np.ravel(bias_terms(record, sensor, None if celsius is None else np.array([celsius])))
