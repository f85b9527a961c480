"""What a hidden kind is, and what the kinds share: who makes it, how it is sized, and where it lies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.blind_test.power.sizing import Stage
from stillcal.replay.blind_test.world.phones import MadeRecording


class Altered(NamedTuple):
    """A recording with its readings or stamps changed, and when, s."""

    recording: MadeRecording
    t_start: float
    t_end: float


@dataclass(frozen=True, slots=True)
class HiddenKind:
    """A real effect that the catalogue has no name for, or has only almost.

    sensor: accel, gyro or timing. added: what it adds to the sensor's readings before they are rounded,
    (n, 3) at the world's times; of one that is `sized`, at unit size. altered: what it makes of a finished
    recording. sized: by what every named effect leaves of it, as d'; others come in their usual size.
    vivid: only a phone that is shaken and spun shows it. thermometer: whether the phone must have one, None
    for either. entailed: names that are true beside it. nearest: names of which it is almost one.
    """

    sensor: str
    added: Callable[[Stage], Array] | None = None
    altered: Callable[[MadeRecording, Stage], Altered] | None = None
    sized: bool = False
    vivid: bool = False
    thermometer: bool | None = None
    entailed: tuple[str, ...] = ()
    nearest: tuple[str, ...] = ()


def one_axis(stage: Stage) -> int:
    """Draw an axis."""
    return int(stage.rng.integers(3))


def signed(stage: Stage, low: float, high: float) -> float:
    """Draw a number of either sign, its size evenly between two."""
    return float(stage.rng.uniform(low, high) * stage.rng.choice([-1.0, 1.0]))


def since_move(stage: Stage) -> Array:
    """Return the time since the rest began, or since the last one did where the phone is moved, (n,) s."""
    world = stage.world
    index = np.clip(np.searchsorted(world.rests[:, 0], world.t, side="right") - 1, 0, None)
    return np.asarray(world.t - world.rests[index, 0])


def a_while(stage: Stage, least: float, most: float) -> tuple[float, float]:
    """Draw a span, s, inside the recording, of a share of it between two."""
    duration = stage.world.duration
    length = stage.rng.uniform(least, most) * duration
    begin = stage.rng.uniform(0.1, 0.9 - length / duration) * duration
    return float(begin), float(begin + length)


def samples_of(recording: MadeRecording, sensor: str) -> Samples:
    """Return one sensor's samples."""
    samples = recording.gyroscope if sensor == "gyro" else recording.accelerometer
    assert samples is not None, "every phone of the examiner has a gyroscope"
    return samples


def with_values(recording: MadeRecording, sensor: str, values: Array) -> MadeRecording:
    """Return a recording with other readings (n, 3) of one sensor."""
    samples = replace(samples_of(recording, sensor), xyz=frozen(values))
    if sensor == "gyro":
        return replace(recording, gyroscope=samples)
    return replace(recording, accelerometer=samples)


def whole(recording: MadeRecording) -> tuple[float, float]:
    """Return the first and the last stamp of a recording, s."""
    t = recording.accelerometer.t
    return float(t[0]), float(t[-1])
