"""Windows of how a phone moves, with their features: the simulated phone's and UCI HAR's.

Collin et al. 2019, 4.2; the features are those of `methods.motion_modes`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.phone import Scenario, Truth, load_phone, simulate
from stillcal.replay.phone.activities.carried import Carry, Drive, Stairs, Walk
from stillcal.replay.phone.activities.resting import Table
from stillcal.replay.studies.methods.motion_modes import features

MODES = ("walking", "driving", "stationary")
WINDOW_S = 5.0
CARRIES: tuple[Carry, ...] = ("pocket", "hand", "bag")
MODE_OF = {"walk": "walking", "stairs": "walking", "drive": "driving"}


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Windows with their modes. features: (n, 12), NAMES. mode: (n,) index into MODES. person: (n,).

    sd: (n,) standard deviation of the norm, m/s^2.
    """

    features: Array
    mode: NDArray[np.intp]
    person: NDArray[np.intp]
    sd: Array


def simulated(people: int, seed: int, minutes: float = 8.0) -> Motion:
    """Return windows of simulated people who walk, climb, drive and put the phone down."""
    parts = [_person(number, seed * 7907 + number, minutes) for number in range(people)]
    return Motion(*(np.concatenate([getattr(p, name) for p in parts]) for name in Motion.__slots__))


def ucihar(data: Path) -> Motion:
    """Return the windows of UCI HAR, walking and climbing against sitting, standing and lying."""
    with np.load(data / "ucihar" / "ucihar_subset.npz") as found:
        force, rates, label, person = (
            np.concatenate([found[f"{part}_{column}"] for part in ("train", "test")]).astype(np.float64)
            for column in ("total_acc", "body_gyro", "y", "subject")
        )
    norms = STANDARD * np.linalg.norm(force, axis=2)
    mode = np.where(label <= 3, MODES.index("walking"), MODES.index("stationary"))
    return Motion(features(norms, rates, 50.0), mode, person.astype(np.intp), norms.std(axis=1))


def _person(number: int, seed: int, minutes: float) -> Motion:
    span = 60.0 * minutes
    carry = CARRIES[number % len(CARRIES)]
    scenario = Scenario(
        segments=(
            Table(duration_s=span),
            Walk(duration_s=span, carry=carry),
            Stairs(duration_s=span / 4.0, carry=carry),
            Drive(duration_s=2.0 * span),
        )
    )
    simulation = simulate(scenario, load_phone("typical"), seed)
    whole = simulation.whole()
    assert whole.gyroscope is not None, "the typical phone has a gyroscope"
    norms, rates, mode = _windows(whole.accelerometer, whole.gyroscope, simulation.truth)
    return Motion(features(norms, rates, 100.0), mode, np.full(len(mode), number), norms.std(axis=1))


def _windows(accel: Samples, gyro: Samples, truth: Truth) -> tuple[Array, Array, NDArray[np.intp]]:
    """Cut whole windows out of every stretch of one mode."""
    size = int(WINDOW_S * 100)
    norms, rates, modes = [], [], []
    forces = np.linalg.norm(accel.xyz, axis=1)
    for mode, begin, end in _stretches(truth):
        first, last = np.searchsorted(accel.t, (begin, end))
        for row in range(int(first), int(last) - size, size):
            norms.append(forces[row : row + size])
            rates.append(gyro.xyz[row : row + size])
            modes.append(mode)
    return np.array(norms), np.array(rates), np.array(modes)


def _stretches(truth: Truth) -> list[tuple[int, float, float]]:
    """Return (mode, begin, end) of stretches of one mode; handling between them belongs to none."""
    found: list[tuple[int, float, float]] = []
    for interval in truth.intervals:
        name = "stationary" if interval.still else MODE_OF.get(interval.activity)
        if name is None:
            continue
        mode = MODES.index(name)
        if found and found[-1][0] == mode and found[-1][2] == interval.t_start:
            found[-1] = (mode, found[-1][1], interval.t_end)
        else:
            found.append((mode, interval.t_start, interval.t_end))
    return found
