"""Small blocks of samples joined to large ones, for everything behind the wire takes its time by the block.

Pure. The engine gives the same however its samples are cut; what else looks at a block looks at its first
stamp, so that only blocks are joined between which time goes on as it should.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import TypeVar

from stillcal.calib_core.streams.samples import Samples, Sensor

T = TypeVar("T")

MAX_JOIN_GAP_S = 1.0
"""A block that begins so much later than the last one ended, s, or before it, is not joined to it."""


def join_blocks(records: Iterable[T]) -> Iterator[T | Samples]:
    """Join the blocks of each sensor as far as nothing else lies between them, the gyroscope's first.

    So the engine waits for neither. Blocks that bring a temperature or arrival stamps are not joined to
    those that bring none.
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
