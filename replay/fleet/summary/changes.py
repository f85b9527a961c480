"""Which devices changed between their first and last recording, and which of them got worse.

A change is judged against the uncertainty of both calibrations and against how much the fleet's devices
ordinarily change, because temperature and age move every bias a little.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.calib_core.accelerometer.parameters import AXES
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.replay.fleet.worker import CALIBRATED

LEVEL = 0.01
"""Probability that a fleet in which nothing changed has any change named."""

LEAST = 5
"""Fewer devices with two recordings do not show how much devices ordinarily change."""

QUANTITIES = [
    *((f"accel_bias_{a}", f"accelerometer bias {a}", "m/s^2", 0.0) for a in AXES),
    *((f"accel_scale_{a}{a}", f"accelerometer scale {a}", "1", 1.0) for a in AXES),
    *((f"gyro_bias_{a}", f"gyroscope bias {a}", "rad/s", 0.0) for a in AXES),
]
"""Column, name, unit and the value of an ideal sensor."""


@dataclass(frozen=True, slots=True)
class Change:
    """A quantity that changed, from a device's first calibrated recording to its last, by their names.

    sds: by how many standard deviations. worse: whether it is farther from an ideal sensor than before.
    first_c, last_c: middle temperature of the two recordings, degC, None where there was no thermometer.
    """

    device: str
    model: str
    quantity: str
    unit: str
    first: float
    last: float
    sds: float
    worse: bool
    first_recording: str
    last_recording: str
    first_c: float | None
    last_c: float | None


def changes(rows: Sequence[dict[str, Any]], limits: list[str]) -> list[Change]:
    """Return what changed beyond chance, largest first, and those that got worse before the others."""
    from scipy.special import ndtri  # noqa: PLC0415 - only a fleet needs it

    pairs = list(first_and_last(rows))
    if not pairs:
        limits.append("no device has two calibrated recordings: changes cannot be judged")
        return []
    if len(pairs) < LEAST:
        limits.append(
            f"{len(pairs)} devices have two calibrated recordings: changes are judged by the calibrations'"
            f" uncertainty alone, not by what devices ordinarily change; that needs {LEAST} devices"
        )
    limit = -float(ndtri(LEVEL / 2 / (len(pairs) * len(QUANTITIES))))
    found = [c for quantity in QUANTITIES for c in _of_quantity(pairs, *quantity) if c.sds > limit]
    return sorted(found, key=lambda c: (not c.worse, -c.sds))


def first_and_last(rows: Sequence[dict[str, Any]]) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield the first and the last calibrated recording of each device that has several."""
    by_device: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        if row["status"] == CALIBRATED:
            by_device[row["device"]].append(row)
    for device in sorted(by_device):
        own = sorted(by_device[device], key=lambda row: str(row["name"]))
        if len(own) > 1:
            yield own[0], own[-1]


def _of_quantity(
    pairs: Sequence[tuple[dict[str, Any], dict[str, Any]]], column: str, name: str, unit: str, ideal: float
) -> Iterator[Change]:
    known = [p for p in pairs if all(row[column] is not None for row in p)]
    steps = np.array([last[column] - first[column] for first, last in known])
    ordinary = MAD_TO_SD * float(np.median(np.abs(steps))) if len(known) >= LEAST else 0.0
    for (first, last), step in zip(known, steps.tolist(), strict=True):
        own = [row[f"{column}_sd"] for row in (first, last)]
        if ordinary == 0.0 and None in own:
            continue
        sd = float(np.sqrt(ordinary**2 + sum(s**2 for s in own if s is not None)))
        yield Change(
            last["device"],
            last["model"],
            name,
            unit,
            first[column],
            last[column],
            abs(step) / sd if sd > 0.0 else 0.0,
            abs(last[column] - ideal) > abs(first[column] - ideal),
            first["name"],
            last["name"],
            _temperature(first),
            _temperature(last),
        )


def _temperature(row: dict[str, Any]) -> float | None:
    low, high = row["temperature_min"], row["temperature_max"]
    return None if low is None or high is None else (low + high) / 2
