"""From rows of recordings to devices: one calibration each, in the parameters of a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer import prior as fleet_prior
from stillcal.calib_core.accelerometer.parameters import AXES
from stillcal.calib_core.arrays import Array
from stillcal.replay.fleet.worker import CALIBRATED

CROSS = ("xy", "xz", "yz")


@dataclass(frozen=True, slots=True, eq=False)
class Devices:
    """n calibrated devices. model: (n,) number in `models`.

    values: (n, 9), covariances: (n, 9, 9), m/s^2 and 1. scatter: (n,) m/s^2, rms of norms at rest. rate_hz,
    rate_jitter: (n,), of the accelerometer's stamps, NaN where not known. gyro_bias: (n, 3) rad/s,
    gyro_scale: (n, 3) diagonal, NaN without.
    """

    names: tuple[str, ...]
    models: tuple[str, ...]
    model: NDArray[np.intp]
    values: Array
    covariances: Array
    scatter: Array
    rate_hz: Array
    rate_jitter: Array
    gyro_bias: Array
    gyro_scale: Array

    def __len__(self) -> int:
        return len(self.names)


def devices(rows: Sequence[dict[str, Any]]) -> Devices:
    """Return for each device the calibrated recording with the most attitudes."""
    best: dict[str, dict[str, Any]] = {}
    for row in rows:
        usable = row["status"] == CALIBRATED and row["accel_covariance"]
        if usable and row["attitudes"] >= best.get(row["device"], {"attitudes": -1})["attitudes"]:
            best[row["device"]] = row
    chosen = [best[name] for name in sorted(best)]
    models = tuple(sorted({row["model"] for row in chosen}))
    pairs = [_nine(row) for row in chosen]
    return Devices(
        tuple(row["device"] for row in chosen),
        models,
        np.array([models.index(row["model"]) for row in chosen], dtype=np.intp),
        np.array([values for values, _ in pairs]).reshape(-1, 9),
        np.array([covariance for _, covariance in pairs]).reshape(-1, 9, 9),
        _column(chosen, ["accel_rms_residual"])[:, 0],
        _column(chosen, ["rate_hz"])[:, 0],
        _column(chosen, ["rate_jitter"])[:, 0],
        _column(chosen, [f"gyro_bias_{a}" for a in AXES]),
        _column(chosen, [f"gyro_scale_{a}{a}" for a in AXES]),
    )


def _nine(row: dict[str, Any]) -> tuple[Array, Array]:
    own = [row[f"accel_bias_{a}"] for a in AXES] + [row[f"accel_scale_{a}{a}"] for a in AXES]
    names = row["accel_names"]
    if len(names) != 6:
        own += [row[f"accel_scale_{pair}"] for pair in CROSS]
    covariance = np.reshape(row["accel_covariance"], (len(names), len(names)))
    return fleet_prior.expanded(own, covariance[: len(own), : len(own)])


def _column(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> Array:
    values = [[np.nan if row[name] is None else row[name] for name in names] for row in rows]
    return np.array(values, dtype=np.float64).reshape(-1, len(names))
