"""When a recording begins, whatever part of it is read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from stillcal.calib_core.streams.samples import Samples

ROWS = 64
"""Samples of a sensor that are read for it."""


@dataclass(frozen=True, slots=True)
class Beginning:
    """The beginning of a recording. t: s, of its first sample."""

    t: float

    @classmethod
    def of(cls, runs: Iterable[Samples]) -> Beginning:
        """Return that of a recording whose first runs, one of each sensor, are given."""
        return cls(min((float(run.t[0]) for run in runs if len(run)), default=0.0))
