"""Runs of samples of one sensor, as checked arrays.

One `Samples` is of one sensor, because a phone delivers accelerometer and gyroscope as separate streams with
their own time stamps. Values are SI and read-only; other units are converted where recordings are read.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.limits import READING, STAMP_S, usable


class Sensor(StrEnum):
    """The sensor that a stream comes from."""

    ACCELEROMETER = "accelerometer"
    GYROSCOPE = "gyroscope"


class SampleError(UserError):
    """A sample that cannot be used.

    row: its index in the block. reason: why it cannot be used.
    """

    def __init__(self, row: int, reason: str) -> None:
        super().__init__(f"sample {row}: {reason}")
        self.row = row
        self.reason = reason


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """A run of samples of one sensor, in time order.

    t: (n,) s, the sensor's own stamp, never decreasing. xyz: (n, 3) raw m/s^2 (specific force) or
    rad/s, in body axes. temperature: (n,) degC or None. t_arrival: (n,) s on the host's clock or None.
    """

    sensor: Sensor
    t: Array
    xyz: Array
    temperature: Array | None = None
    t_arrival: Array | None = None

    @classmethod
    def checked(
        cls,
        sensor: Sensor,
        t: ArrayLike,
        xyz: ArrayLike,
        temperature: ArrayLike | None = None,
        t_arrival: ArrayLike | None = None,
    ) -> Samples:
        """Build from untrusted arrays.

        Raises SampleError on a wrong shape, a number that is none or beyond its limits (streams/limits.py),
        and time running back.

        >>> samples = Samples.checked(Sensor.ACCELEROMETER, t=[0.0, 0.1], xyz=[[0, 0, 9.8], [0, 0, 9.9]])
        >>> len(samples), samples.between(0.05, 1.0).xyz.tolist()
        (2, [[0.0, 0.0, 9.9]])
        >>> Samples.checked(Sensor.GYROSCOPE, t=[0.1, 0.0], xyz=np.zeros((2, 3)))  # doctest: +ELLIPSIS
        Traceback (most recent call last):
            ...
        stillcal.calib_core.streams.samples.SampleError: sample 1: time runs backwards, from 0.1...
        """
        block = cls(
            sensor,
            frozen(t),
            frozen(xyz),
            None if temperature is None else frozen(temperature),
            None if t_arrival is None else frozen(t_arrival),
        )
        block._check()
        return block

    @classmethod
    def empty(cls, sensor: Sensor) -> Samples:
        """Return a run of no samples."""
        return cls(sensor, frozen(np.empty(0)), frozen(np.empty((0, 3))))

    @classmethod
    def joined(cls, blocks: Iterable[Samples]) -> Samples:
        """Join runs of one sensor end to end; an optional column is kept only where all runs have it."""
        parts = list(blocks)
        if len(parts) == 1:
            return parts[0]

        def column(name: str) -> Array | None:
            columns = [getattr(p, name) for p in parts]
            return None if any(c is None for c in columns) else frozen(np.concatenate(columns))

        return cls(
            parts[0].sensor,
            frozen(np.concatenate([p.t for p in parts])),
            frozen(np.concatenate([p.xyz for p in parts])),
            column("temperature"),
            column("t_arrival"),
        )

    def __len__(self) -> int:
        return int(self.t.size)

    def __getitem__(self, rows: slice) -> Samples:
        return Samples(
            self.sensor,
            self.t[rows],
            self.xyz[rows],
            None if self.temperature is None else self.temperature[rows],
            None if self.t_arrival is None else self.t_arrival[rows],
        )

    def where(self, kept: NDArray[np.bool_]) -> Samples:
        """Return the samples that are `kept`, (n,)."""
        columns = (self.temperature, self.t_arrival)
        temperature, arrival = (None if c is None else frozen(c[kept]) for c in columns)
        return Samples(self.sensor, frozen(self.t[kept]), frozen(self.xyz[kept]), temperature, arrival)

    def between(self, t_start: float, t_end: float) -> Samples:
        """Return the samples with t_start <= t < t_end."""
        first, last = np.searchsorted(self.t, (t_start, t_end), side="left")
        return self[int(first) : int(last)]

    def _check(self) -> None:
        n = self.t.size
        if self.t.shape != (n,) or self.xyz.shape != (n, 3):
            raise SampleError(0, f"shapes {self.t.shape} and {self.xyz.shape}, expected (n,) and (n, 3)")
        for name, column in (("temperature", self.temperature), ("t_arrival", self.t_arrival)):
            if column is not None and column.shape != (n,):
                raise SampleError(0, f"{name} has shape {column.shape}, expected ({n},)")
        bad = ~usable(self.t, self.xyz)
        if bad.any():
            row = int(bad.argmax())
            raise SampleError(row, _unusable(float(self.t[row]), self.xyz[row]))
        backwards = np.diff(self.t) < 0
        if backwards.any():
            row = int(backwards.argmax()) + 1
            raise SampleError(row, f"time runs backwards, from {self.t[row - 1]:.6f} to {self.t[row]:.6f} s")


def warmed(gyroscope: Samples, accelerometer: Samples) -> Samples:
    """Return the gyroscope's samples with the temperature of the accelerometer's last one, as in a file.

    They stay as they are where they have a temperature of their own, or the accelerometer has none.
    """
    if accelerometer.temperature is None or gyroscope.temperature is not None or not len(gyroscope):
        return gyroscope
    last = np.searchsorted(accelerometer.t, gyroscope.t, side="right") - 1
    return replace(gyroscope, temperature=frozen(accelerometer.temperature[np.maximum(last, 0)]))


def _unusable(t: float, xyz: Array) -> str:
    """Say what is wrong with a sample at t (s) with readings (3,)."""
    if not (np.isfinite(t) and np.isfinite(xyz).all()):
        return "not a finite number"
    if abs(t) > STAMP_S:
        return f"time {t:g} s is out of range (at most {STAMP_S:g} s); stamps must be in seconds"
    return (
        f"reading {np.abs(xyz).max():g} is out of range (at most {READING:g}); readings must be in SI units"
    )
