"""Activities of thirty people (UCI HAR, Anguita et al. 2013), and a study without recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.studies.claim import Claim, Evidence, Study, Verdict

RATE_HZ = 50.0
ACTIVITIES = ("walk", "stairs up", "stairs down", "sit", "stand", "lie")
"""By the data's own numbers, 1 to 6."""

MOVING = ACTIVITIES[:3]

DATA = "ucihar: 3350 windows of 2.56 s, 30 people, one Galaxy S II at the waist"


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Windows of activity. accel: (n, 128, 3) m/s^2 with gravity, at 50 Hz.

    label: (n,) index into ACTIVITIES. person: (n,).
    """

    accel: Array
    label: NDArray[np.intp]
    person: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.label)

    def only(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Windows:
        """Return the windows of an index or a mask."""
        return Windows(self.accel[rows], self.label[rows], self.person[rows])

    def of(self, *activities: str) -> Windows:
        """Return the windows of some activities."""
        return self.only(np.isin(self.label, [ACTIVITIES.index(a) for a in activities]))

    @property
    def people(self) -> NDArray[np.intp]:
        """Everybody's number, once."""
        return np.unique(self.person)


def read_windows(data: Path) -> Windows:
    """Read the windows of both official parts as one set, sorted by person, then in recorded order."""
    with np.load(data / "ucihar" / "ucihar_subset.npz") as found:
        parts = [
            [found[f"{part}_{column}"] for part in ("train", "test")]
            for column in ("total_acc", "y", "subject", "official_row")
        ]
    accel, label, person, row = (np.concatenate(part) for part in parts)
    order = np.lexsort((row, person))
    return Windows(
        STANDARD * accel[order].astype(np.float64),
        label[order].astype(np.intp) - 1,
        person[order].astype(np.intp),
    )


def read_rates(data: Path) -> tuple[Windows, Array]:
    """Read the windows as `read_windows` does, and their angular rates, (n, 128, 3) rad/s."""
    with np.load(data / "ucihar" / "ucihar_subset.npz") as found:
        rates, person, row = (
            np.concatenate([found[f"{part}_{column}"] for part in ("train", "test")])
            for column in ("body_gyro", "subject", "official_row")
        )
    return read_windows(data), rates[np.lexsort((row, person))].astype(np.float64)


def without_recordings(
    name: str, title: str, claims: Sequence[tuple[str, str, str, str]], seed: int
) -> Study:
    """Return a study of claims (paper, where, claim, published figure) that no recordings were given for."""
    because = "the real recordings are not here (--data)"
    untested = tuple(
        Claim(*claim, "", "", Verdict.UNTESTED, because, evidence=Evidence.NONE) for claim in claims
    )
    return Study(name, title, untested, "Real recordings were not given (`--data`).", seed=seed)
