"""When samples are taken, their time stamps, and whether and when they arrive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.phone.noise import seeded
from stillcal.replay.phone.settings import ClockSettings

Flags = NDArray[np.bool_]

BLOCK_S = 60.0
"""Length of a block of simulated time, s: fixed, so that how a recording is cut changes nothing in it."""

MAX_JITTER = 0.45
"""A stamp is never off by more than this share of the sampling period, so that time never runs back."""


class Interval(NamedTuple):
    """A stretch of true time, s."""

    start: float
    end: float


@dataclass(frozen=True, slots=True)
class Load:
    """A processor so busy that sensors starve.

    Stisen et al. 2015, 3.3 and Fig. 2(b): the median interval rose from 5.2 to 9.7 ms and the longest were
    over 1 s. Here 40 % of intervals keep the period and the others double it, and stamps scatter by
    jitter periods: the median is then 2 - 0.97 sqrt(2) jitter = 1.87 periods. Outages come every
    outage_every_s on average and last outage_s.
    """

    single: float = 0.4
    jitter: float = 0.095
    outage_every_s: float = 45.0
    outage_s: tuple[float, float] = (1.0, 2.5)
    burst_fraction: float = 0.5


LOAD = Load()


@dataclass(frozen=True, slots=True, eq=False)
class Ticks:
    """Samples of one block. t, stamp, arrival: (n,) s of true time, the device's clock, the host's clock.

    rows: which of them are delivered, in order; doubled ones come twice.
    """

    t: Array
    stamp: Array
    arrival: Array
    rows: NDArray[np.int64]


def inside(t: Array, intervals: Sequence[Interval]) -> Flags:
    """Return whether each of the times (n,) lies within any of the disjoint, rising intervals."""
    if not intervals:
        return np.zeros(t.size, dtype=bool)
    edges = np.array(intervals).ravel()
    return np.asarray(np.searchsorted(edges, t, side="right") % 2 == 1)


class StreamClock:
    """The clock of one stream of samples; blocks are asked for in order.

    The host's clock is true time. The device's is fast by `skew` and also paces the sensor, so stamps are
    spaced by the nominal period while true intervals are shorter.
    """

    def __init__(
        self,
        clock: ClockSettings,
        rate_hz: float,
        stressed: Sequence[Interval],
        suspended: Sequence[Interval],
        *,
        seed: int,
        stream: str,
    ) -> None:
        self._clock, self._seed, self._stream = clock, seed, stream
        self._rate = rate_hz * (1.0 + clock.skew)
        self._stressed, self._suspended = stressed, suspended
        self._phase = 0.0 if clock.shared else float(seeded(seed, stream, "phase").random())
        self._last_arrival = -math.inf

    def block(self, index: int, end: float) -> Ticks:
        """Return the ticks of the index-th block of BLOCK_S, cut at `end` s."""
        rng = seeded(self._seed, self._stream, "clock", index)
        start, stop = index * BLOCK_S, min((index + 1) * BLOCK_S, end)
        first, last = (math.ceil(edge * self._rate - self._phase) for edge in (start, stop))
        t: Array = (np.arange(first, last, dtype=np.float64) + self._phase) / self._rate
        busy = inside(t, self._stressed)
        stamp = self._stamps(t, busy, rng)
        delivered = (
            self._delivered(t, busy, rng) & ~inside(t, self._suspended) & ~self._outages(t, busy, index)
        )
        arrival = self._arrivals(t, busy, delivered, rng)
        times = 1 + (rng.random(int(delivered.sum())) < self._clock.double_fraction)
        return Ticks(t, stamp, arrival, np.repeat(np.flatnonzero(delivered), times))

    def _stamps(self, t: Array, busy: Flags, rng: np.random.Generator) -> Array:
        period = 1.0 / self._rate
        sigma = np.hypot(self._clock.jitter_s, np.where(busy, LOAD.jitter * period, 0.0))
        off = 0.0 if not sigma.any() else sigma * rng.standard_normal(t.size)
        stamps: Array = (t + np.clip(off, -MAX_JITTER * period, MAX_JITTER * period)) * (
            1.0 + self._clock.skew
        )
        return stamps

    def _delivered(self, t: Array, busy: Flags, rng: np.random.Generator) -> Flags:
        delivered = np.ones(t.size, dtype=bool)
        if self._clock.drop_fraction > 0.0:
            delivered &= rng.random(t.size) >= self._clock.drop_fraction
        if busy.any():
            hops = np.cumsum(np.where(rng.random(t.size) < LOAD.single, 1, 2))
            served = np.zeros(t.size, dtype=bool)
            served[hops[hops < t.size]] = True
            delivered &= ~busy | served
        return delivered

    def _outages(self, t: Array, busy: Flags, index: int) -> Flags:
        """Return where nothing is sampled: the same for both streams, because the phone is to blame."""
        rng, start = seeded(self._seed, "outages", index), index * BLOCK_S
        now_and_then = drawn_outages(self._clock.gaps_per_hour / 3600.0, self._clock.gap_s, start, rng)
        starving = drawn_outages(1.0 / LOAD.outage_every_s, LOAD.outage_s, start, rng)
        return inside(t, now_and_then) | (busy & inside(t, starving))

    def _arrivals(self, t: Array, busy: Flags, delivered: Flags, rng: np.random.Generator) -> Array:
        clock = self._clock
        arrival = t + clock.latency_s
        if clock.latency_jitter_s > 0.0:
            arrival = arrival + rng.exponential(clock.latency_jitter_s, t.size)
        fraction = np.where(busy, max(LOAD.burst_fraction, clock.burst_fraction), clock.burst_fraction)
        if fraction.any():
            stall = np.floor(t / clock.burst_s).astype(np.int64)
            stalled = rng.random(int(np.ptp(stall)) + 1)[stall - stall[0]] < fraction
            arrival = np.where(
                stalled, np.maximum(arrival, (stall + 1) * clock.burst_s + clock.latency_s), arrival
            )
        arrival = np.maximum.accumulate(
            np.maximum(np.where(delivered, arrival, -math.inf), self._last_arrival)
        )
        self._last_arrival = float(arrival[-1]) if arrival.size else self._last_arrival
        return arrival


def drawn_outages(
    per_s: float, length: tuple[float, float], start: float, rng: np.random.Generator
) -> list[Interval]:
    """Draw disjoint outages in the block that begins at `start` s, `per_s` of them a second on average."""
    count = int(rng.poisson(per_s * BLOCK_S))
    begins = np.sort(rng.uniform(start, start + BLOCK_S, count))
    ends = np.minimum(begins + rng.uniform(*length, count), np.append(begins[1:], start + BLOCK_S))
    return [Interval(float(a), float(b)) for a, b in zip(begins, ends, strict=True)]
