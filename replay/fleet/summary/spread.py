"""How a fleet's phones differ: bias, scale and every effect found, by model."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.fleet.summary.devices import Devices

ALL = "all"


@dataclass(frozen=True, slots=True)
class Spread:
    """A quantity over the devices of one model: how many, median and middle half, in `unit`."""

    model: str
    quantity: str
    unit: str
    devices: int
    median: float
    low: float
    high: float

    @property
    def of_all_models(self) -> bool:
        """Whether this is the spread over the devices of all models."""
        return self.model == ALL


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect by model: in how many diagnosed recordings it was found, and how large.

    median, low, high: of the size of its first parameter, in `unit`; NaN where it has none. by_axis: median
    absolute values of the axes x, y, z, where the parameter has one number for each; else empty.
    """

    model: str
    effect: str
    sensor: str
    found: int
    diagnosed: int
    parameter: str
    unit: str
    median: float
    low: float
    high: float
    by_axis: tuple[float, ...] = ()


def spreads(devices: Devices) -> list[Spread]:
    """Return every quantity for all devices, then for each model."""
    quantities: list[tuple[str, str, Array]] = []
    for i, axis in enumerate("xyz"):
        quantities.append((f"accelerometer bias {axis}", "m/s^2", devices.values[:, i]))
    for i, axis in enumerate("xyz"):
        quantities.append((f"accelerometer scale error {axis}", "%", 100.0 * (devices.values[:, 3 + i] - 1)))
    known = np.diagonal(devices.covariances, axis1=1, axis2=2)[:, 6] < 1.0
    cross = np.where(known, np.abs(devices.values[:, 6:]).max(axis=1), np.nan)
    quantities.append(("accelerometer cross-axis, largest", "%", 100.0 * cross))
    for i, axis in enumerate("xyz"):
        quantities.append((f"gyroscope bias {axis}", "rad/s", devices.gyro_bias[:, i]))
    for i, axis in enumerate("xyz"):
        quantities.append((f"gyroscope scale error {axis}", "%", 100.0 * (devices.gyro_scale[:, i] - 1)))
    quantities.append(("norm at rest, rms", "m/s^2", devices.scatter))
    groups = [(ALL, np.ones(len(devices), dtype=bool))]
    groups += [(name, devices.model == k) for k, name in enumerate(devices.models)]
    rows = [_spread(model, *quantity, mask) for model, mask in groups for quantity in quantities]
    return [row for row in rows if row.devices]


def _spread(model: str, quantity: str, unit: str, values: Array, mask: Array) -> Spread:
    own = values[mask & np.isfinite(values)]
    low, median, high = np.quantile(own, (0.25, 0.5, 0.75)) if own.size else (np.nan, np.nan, np.nan)
    return Spread(model, quantity, unit, int(own.size), float(median), float(low), float(high))


def effects(rows: Sequence[dict[str, Any]], findings: Sequence[dict[str, Any]]) -> list[Effect]:
    """Return every effect that was found, for all models and for each, the most frequent first."""
    diagnosed: dict[str, int] = defaultdict(int)
    for row in rows:
        if row["findings"] is not None:
            diagnosed[row["model"]] += 1
            diagnosed[ALL] += 1
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = defaultdict(list)
    for finding in findings:
        for model in (ALL, finding["model"]):
            groups[model, finding["effect"], finding["sensor"]].append(finding)
    all_effects = [_effect(*key, group, diagnosed[key[0]]) for key, group in groups.items()]
    return sorted(all_effects, key=lambda e: (e.model != ALL, e.model, -e.found, e.effect))


def _effect(model: str, effect: str, sensor: str, group: list[dict[str, Any]], diagnosed: int) -> Effect:
    sizes = np.array([np.linalg.norm(f["value"]) for f in group if f["value"]])
    low, median, high = np.quantile(sizes, (0.25, 0.5, 0.75)) if sizes.size else (np.nan, np.nan, np.nan)
    axes = [f["value"] for f in group if f["value"] and len(f["value"]) == 3]
    by_axis = np.median(np.abs(axes), axis=0).tolist() if axes and len(axes) == sizes.size else []
    recordings = len({f["name"] for f in group})
    first = group[0]
    return Effect(
        model,
        effect,
        sensor,
        recordings,
        diagnosed,
        first["parameter"] or "",
        first["unit"] or "",
        float(median),
        float(low),
        float(high),
        tuple(by_axis),
    )
