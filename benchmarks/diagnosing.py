"""Item 6: the diagnosis of an hour at 50 Hz, and how its time grows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from subject import day
from timing import Row, rounds

from stillcal.calib_core.misfit.diagnosis import diagnose

MINUTES = (15, 30, 60, 120)


def run(quick: bool) -> Iterator[Row]:
    """Yield the row of item 6."""
    subject = day()
    taken = {}
    for minutes in MINUTES[:3] if quick else MINUTES:
        part = [s.between(0.0, 60.0 * minutes) for s in (subject.accelerometer, subject.gyroscope)]
        timed = rounds({"ours": lambda p=part: diagnose(p[0], p[1])}, 1)["ours"]
        taken[minutes] = timed.best
    slope = np.polyfit(np.log(list(taken)), np.log(list(taken.values())), 1)[0]
    yield Row(
        "6",
        "diagnosis of 1 h at 50 Hz, both sensors",
        taken[60],
        "s",
        accuracy=f"grows as length to the {slope:.2f}",
        more={f"{m} min": s for m, s in taken.items()},
    )
