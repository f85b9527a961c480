"""Join small blocks of samples into large ones, because everything behind the wire costs time per block.

Pure. The engine gives the same result however its samples are cut. The phone's clock looks at the first
stamp of a block only, so that blocks are joined only where time goes on normally.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import TypeVar

from stillcal.calib_core.streams.samples import Samples, Sensor

T = TypeVar("T")

MAX_JOIN_GAP_S = 1.0
"""Longest gap between joined blocks, s; blocks that overlap are not joined either."""


def join_blocks(records: Iterable[T]) -> Iterator[T | Samples]:
    """Join the blocks of each sensor between other records, the gyroscope's first.

    In this order the engine waits for neither. Blocks with a temperature or arrival stamps are not joined to
    blocks without.
    """
    for sampled, group in itertools.groupby(records, lambda record: isinstance(record, Samples)):
        if not sampled:
            yield from group
            continue
        blocks = [record for record in group if isinstance(record, Samples)]
        for sensor in (Sensor.GYROSCOPE, Sensor.ACCELEROMETER):
            yield from _joined(block for block in blocks if block.sensor is sensor)


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
