"""Windows as devices recorded them, after a remedy, and how they are parted to train and to test.

Stisen et al. 2015, 5: calibration, clustering and interpolation to a common rate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.har.data import Windows
from stillcal.replay.studies.har.devices import Device
from stillcal.replay.studies.har.features import FAMILIES
from stillcal.replay.studies.stisen2015.families import COMMON_HZ
from stillcal.replay.studies.stisen2015.modes import Rows, Split, gathered, splits
from stillcal.replay.studies.stisen2015.recorded import METHODS, Recorded, resample

RATES_HZ = (25.0, 50.0, 100.0, 200.0)
SPLITS = ("model out", "user out", "device out", "device out, within cluster")
WAYS = ("raw", "calibrated", *METHODS, "calibrated and linear")


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """Windows as every device recorded them. clusters, recorded: of each device. seed: of its rests."""

    windows: Windows
    devices: list[Device]
    clusters: list[int]
    recorded: list[Recorded]
    seed: int

    def rows(self, way: str, rate: float = COMMON_HZ) -> Rows:
        """Return the features of the windows after the treatment `way`, one of WAYS."""
        samples = [self.handled(way, rate, k) for k in range(len(self.devices))]
        made = gathered(self.windows, self.devices, self.clusters, samples)
        return replace(made, features={name: made.features[name] for name in FAMILIES})

    def handled(self, way: str, rate: float, k: int) -> Array:
        """Return the k-th device's windows, (n, length, 3) m/s^2, after the treatment `way`, one of WAYS."""
        recorded = self.recorded[k]
        if way.startswith("calibrated"):
            model = self.devices[k].calibrated(self.seed + k)
            recorded = Recorded(model.apply(recorded.samples), recorded.stamps)
        method = way.removeprefix("calibrated and ")
        return resample(recorded, rate, method) if method in METHODS else recorded.samples


def parts(rows: Rows, split: str, seed: int) -> Iterator[Split]:
    """Yield what a split of SPLITS trains on and tests; user out leaves a fifth of the people out.

    Both device splits test the same devices, those whose cluster holds another one.
    """
    if split == "model out":
        yield from splits(rows, split, seed)
    elif split == "user out":
        yield from splits(rows, "fifth of users out", seed)
    else:
        for device in np.unique(rows.device):
            test = rows.device == device
            inside = rows.cluster == rows.cluster[test][0]
            if np.any(inside & ~test):
                yield ~test & (inside if "cluster" in split else True), test
