"""When a recording begins, whatever part of it is read, and which recording it is."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

from stillcal.calib_core.streams.samples import Samples

ROWS = 64
"""Samples of a sensor that a beginning is told by: noise makes no two of them alike."""


@dataclass(frozen=True, slots=True)
class Beginning:
    """The beginning of a recording. t: s, of its first sample. digest: of its first samples, in hex.

    Two recordings with the same beginning began at the same moment of the same phone, whatever they are
    called and wherever they end.
    """

    t: float
    digest: str

    @classmethod
    def of(cls, runs: Iterable[Samples]) -> Beginning:
        """Return that of a recording whose first runs, one of each sensor, are given."""
        held = [run for run in runs if len(run)]
        digest = hashlib.sha256()
        for run in held:
            for values in (run.t, run.xyz):
                digest.update(values.astype("<f8").tobytes())
        return cls(min((float(run.t[0]) for run in held), default=0.0), digest.hexdigest()[:16])
