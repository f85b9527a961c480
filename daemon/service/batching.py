"""Join small blocks of samples into large ones, because everything behind the wire costs time per block.

Pure. The engine gives the same result however its samples are cut. The phone's clock looks at the first
stamp of a block only, so that blocks are joined only where time goes on normally.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import TypeVar

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.service.phone_clock import BACK_S, LEAP_S

T = TypeVar("T")

MAX_JOIN_GAP_S = 1.0
"""Longest gap between joined blocks, s; blocks that overlap are not joined either."""

AHEAD_S = 60.0
"""The gyroscope comes before the accelerometer by so much at most, s: it must not seem to be alone."""


def join_blocks(records: Iterable[T]) -> Iterator[T | Samples]:
    """Join the blocks of each sensor between other records, the gyroscope's first.

    In this order the engine waits for neither. The order stays across a jump of the phone's clock, and from
    one AHEAD_S to the next. Blocks with a temperature or arrival stamps are not joined to blocks without.
    """
    for sampled, group in itertools.groupby(records, lambda record: isinstance(record, Samples)):
        if not sampled:
            yield from group
            continue
        for blocks in _in_parts(record for record in group if isinstance(record, Samples)):
            for sensor in (Sensor.GYROSCOPE, Sensor.ACCELEROMETER):
                yield from _joined(block for block in blocks if block.sensor is sensor)


def _in_parts(blocks: Iterable[Samples]) -> Iterator[list[Samples]]:
    """Yield runs of blocks in which no stream falls back, leaps (as PhoneClock tells it) or is long."""
    run: list[Samples] = []
    began: dict[Sensor, float] = {}
    last: dict[Sensor, float] = {}
    for block in blocks:
        t = float(block.t[0])
        jumps = not -BACK_S <= t - last.get(block.sensor, t) <= LEAP_S
        if jumps or t - began.get(block.sensor, t) > AHEAD_S:
            yield run
            run, began = [], {}
        run.append(block)
        began.setdefault(block.sensor, t)
        last[block.sensor] = float(block.t[-1])
    yield run


def _joined(blocks: Iterable[Samples]) -> Iterator[Samples]:
    run: list[Samples] = []
    for block in blocks:
        if run and not _continues(run[-1], block):
            yield Samples.joined(run)
            run = []
        run.append(block)
    if run:
        yield Samples.joined(run)


def _continues(last: Samples, block: Samples) -> bool:
    return (
        0.0 <= block.t[0] - last.t[-1] <= MAX_JOIN_GAP_S
        and (last.temperature is None) == (block.temperature is None)
        and (last.t_arrival is None) == (block.t_arrival is None)
    )
