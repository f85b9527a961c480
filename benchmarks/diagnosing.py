"""Item 6: the diagnosis of an hour at 50 Hz, and how its time grows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from subject import day
from timing import Row, rounds

from stillcal.calib_core.diagnosis.diagnose import diagnose

MINUTES = (15, 30, 60, 120, 240)


def run(quick: bool) -> Iterator[Row]:
    """Yield the row of item 6."""
    subject = day()
    taken = {}
    for minutes in MINUTES[:3] if quick else MINUTES:
        part = [s.between(0.0, 60.0 * minutes) for s in (subject.accelerometer, subject.gyroscope)]
        count = 5 if minutes == 60 and not quick else 1
        taken[minutes] = rounds({"ours": lambda p=part: diagnose(p[0], p[1])}, count)["ours"]
    usual = [t.median for t in taken.values()]
    slope = np.polyfit(np.log(list(taken)), np.log(usual), 1)[0]
    yield Row(
        "6",
        "diagnosis of 1 h at 50 Hz, both sensors",
        taken[60].spread(1.0),
        "s",
        accuracy=f"grows as length to the {slope:.2f}",
        more={f"{m} min": {"seconds": s} for m, s in zip(taken, usual, strict=True)},
    )
