"""Recordings of HHAR hold some samples in the order in which they arrived, which is not always their own."""

from __future__ import annotations

import csv
import gzip
from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.sequence.order import Misplaced, misplaced

STREAMS = [f"{on}_{what}.csv.gz" for on in ("Phones", "Watch") for what in ("accelerometer", "gyroscope")]
"""Of one device each."""


def as_written(path: Path) -> tuple[Array, Array]:
    """Return the sensor's own stamps (n,) and values (n, 3) of a file, row by row."""
    with gzip.open(path, "rt") as lines:
        rows = [row[2:6] for row in csv.reader(lines)]
    numbers = np.array(rows, dtype=np.float64)
    return numbers[:, 0], numbers[:, 1:]


def late(t: Array, place: Misplaced) -> bool:
    """Whether the sensor's own stamps run backwards at a place."""
    return bool((np.diff(t[place.first : place.last]) < 0.0).any())


@pytest.mark.parametrize("name", STREAMS)
def test_places_are_those_where_stamps_run_backwards(data_dir: Path, name: str) -> None:
    """Values alone tell; the stamps, which the search does not see, say whether they are right."""
    t, xyz = as_written(data_dir / "hhar" / name)
    found = misplaced(xyz)
    assert all(late(t, place) for place in found)
    assert misplaced(xyz[np.argsort(t, kind="stable")]) == []
    if name.endswith("gyroscope.csv.gz"):
        assert found
