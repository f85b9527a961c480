"""The still experiment of Stisen et al. 2015 with its stamps: one record a device and face."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array

FOLDER = "hhar_still"
REFERENCE = "Xsens-reference"
"""The model under which the reference unit is filed."""

DATA = "hhar_still: the still experiment's own recordings"


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """One device on one face. accel: (n, 3) raw m/s^2. arrival, creation: (n,) s from the first sample.

    face: the published folder's label, which calls two recordings of one face left and right on several
    phones. Creation is in seconds by what arrival says of its unit, which differs by device.
    """

    face: str
    device: str
    model: str
    accel: Array
    arrival: Array
    creation: Array

    @property
    def name(self) -> str:
        """Model and device."""
        return f"{self.model} {self.device}"

    @property
    def frozen(self) -> bool:
        """Whether the sensor holds one value throughout."""
        return bool((self.accel == self.accel[0]).all())

    @property
    def reference(self) -> bool:
        """Whether this is the reference unit."""
        return self.model == REFERENCE

    @property
    def norms(self) -> Array:
        """(n,) m/s^2."""
        return np.asarray(np.linalg.norm(self.accel, axis=1))


def read_still(data: Path) -> list[Still]:
    """Read every recording in `data`/hhar_still, in the index's order."""
    folder = data / FOLDER
    with np.load(folder / "still_accel.npz") as columns:
        accel, arrival, creation = columns["acc"], columns["arrival_ms"], columns["creation"]
    with (folder / "index.csv").open(newline="") as lines:
        return [_still(row, accel, arrival, creation) for row in csv.DictReader(lines)]


def _still(row: dict[str, str], accel: Array, arrival: Array, creation: Array) -> Still:
    part = slice(int(row["start"]), int(row["start"]) + int(row["count"]))
    came = 1e-3 * (arrival[part] - arrival[part][0])
    made = (creation[part] - creation[part][0]).astype(np.float64)
    return Still(
        face=row["position"].removeprefix("Phoneon"),
        device=row["device"],
        model=row["model"].removesuffix("_locked").removesuffix("_unlocked"),
        accel=accel[part].astype(np.float64),
        arrival=came,
        creation=made * stamp_unit(made, came),
    )


def stamp_unit(made: Array, came: Array) -> float:
    """Return the unit of creation stamps (n,) in s, a power of 1000, by their arrival (n,) in s.

    By the whole span, which a unit misses a thousandfold and an outage of the app by far less.
    """
    return float(10.0 ** (3 * round(np.log10(came[-1] / made[-1]) / 3)))


def by_device(recordings: list[Still]) -> dict[str, list[Still]]:
    """Group recordings by device, in order of first appearance."""
    found: dict[str, list[Still]] = {}
    for recording in recordings:
        found.setdefault(recording.name, []).append(recording)
    return found
