"""Windows as devices recorded them, after a remedy.

Stisen et al. 2015, 5: calibration, clustering and interpolation to a common rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.har.data import Windows
from stillcal.replay.studies.har.devices import Device
from stillcal.replay.studies.har.features import frequency_magnitudes
from stillcal.replay.studies.stisen2015.families import COMMON_HZ
from stillcal.replay.studies.stisen2015.modes.rows import Rows, gathered
from stillcal.replay.studies.stisen2015.recorded import METHODS, Recorded, resample

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
        return gathered(self.windows, self.devices, self.clusters, samples)

    def magnitudes(self, way: str) -> Rows:
        """Return the windows after the treatment `way` with frequency features as magnitudes alone."""
        samples = [self.handled(way, COMMON_HZ, k) for k in range(len(self.devices))]
        features = {"frequency": np.concatenate([frequency_magnitudes(own) for own in samples])}
        return replace(gathered(self.windows, self.devices, self.clusters, samples), features=features)

    def handled(self, way: str, rate: float, k: int) -> Array:
        """Return the k-th device's windows, (n, length, 3) m/s^2, after the treatment `way`, one of WAYS."""
        recorded = self.recorded[k]
        if way.startswith("calibrated"):
            model = self.devices[k].calibrated(self.seed + k)
            recorded = Recorded(model.apply(recorded.samples), recorded.stamps)
        method = way.removeprefix("calibrated and ")
        return resample(recorded, rate, method) if method in METHODS else recorded.samples
