"""Samples of both sensors, whole and cut into the chunks that a phone's stream is made of."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.streams.events import Charging, Location
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.serial_phone.stream import PhoneEvent
from tests.support.wire_said import A, G


@dataclass(frozen=True)
class Piece:
    """A chunk as the simulated phone and recordings have them."""

    accelerometer: Samples
    gyroscope: Samples | None
    events: tuple[PhoneEvent, ...] = ()


def whole(seconds: float, seed: int = 1) -> tuple[Samples, Samples]:
    """Both sensors at their own rates, with stamps of all 53 bits."""
    rng = np.random.default_rng(seed)

    def sensor(which: Sensor, rate: float) -> Samples:
        n = int(seconds * rate)
        t = (np.arange(n) + rng.uniform(0.1, 0.9, n)) / rate
        warm = rng.normal(30, 1, n) if which is A else None
        return Samples.checked(which, t, rng.normal(0, 9, (n, 3)), warm, t + 0.01)

    return sensor(A, 100.0), sensor(G, 80.0)


EVENTS: tuple[PhoneEvent, ...] = (Location(0.5, 52.2, 0.1), Charging(7.25, True), Charging(7.25, False))


def pieces(
    a: Samples, g: Samples, cuts: Iterable[float], events: Iterable[PhoneEvent] = EVENTS
) -> list[Piece]:
    edges = [-math.inf, *sorted(cuts), math.inf]
    return [
        Piece(a.between(lo, hi), g.between(lo, hi), tuple(e for e in events if lo <= e.t < hi))
        for lo, hi in itertools.pairwise(edges)
    ]
