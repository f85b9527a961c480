"""What both baselines see of a recording: ten-second means of rests, affine error taken off, covariates.

Plain least squares on purpose: this is what a competent engineer would try first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.events import Charging
from stillcal.replay.formats.trace import Recording

Rows = NDArray[np.intp]

WINDOW_S = 10.0
TAUS_S = (100.0, 300.0, 1000.0)
STEPS = 15
"""Times at which a step is tried."""

LEAST_WINDOWS = 16


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Still windows. t: (m,) s. up: (m, 3). norm: (m,) m/s^2 over gravity. rate: (m, 3) rad/s or None.

    g: m/s^2. baseline: (m, 9) columns of bias, scale and misalignment in the norm. drivers: courses by name.
    """

    t: Array
    up: Array
    norm: Array
    rate: Array | None
    g: float
    baseline: Array
    drivers: dict[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A hypothesis: columns (m, k) of one sensor, and how its coefficients are told.

    own: sizes by which coefficients are multiplied to be the parameter; told: further fixed parameters.
    """

    effect: str
    sensor: str
    driver: str
    parameter: str
    unit: str
    columns: Array
    told: dict[str, float]


def seen(recording: Recording) -> Seen | None:
    """Return the still windows of a recording, None where there are too few."""
    accel, gyro = recording.accelerometer, recording.gyroscope
    window = np.floor(accel.t / WINDOW_S).astype(np.int64)
    kinds, first, counts = np.unique(window, return_index=True, return_counts=True)
    mean, spread = _moments(accel.xyz, first, counts)
    rate = _moments(gyro.xyz, first, counts)[0] if gyro is not None and len(gyro) == len(accel) else None
    still = (spread < 2.0 * np.quantile(spread, 0.2)) & (counts > 0.8 * np.median(counts))
    if still.sum() < LEAST_WINDOWS:
        return None
    t, mean = np.asarray(kinds[still] + 0.5, dtype=np.float64) * WINDOW_S, mean[still]
    g = recording.claims.gravity or 9.80665
    length = np.linalg.norm(mean, axis=1)
    up = mean / length[:, None]
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    baseline = np.column_stack([up, *(up[:, i] * up[:, j] for i, j in pairs)])
    warmth = None if accel.temperature is None else _moments(accel.temperature[:, None], first, counts)[0]
    temperature = None if warmth is None else warmth[still][:, 0]
    return Seen(
        t,
        up,
        length - g,
        None if rate is None else rate[still],
        g,
        baseline,
        _drivers(t, temperature, [e for e in recording.events if isinstance(e, Charging)]),
    )


def _moments(values: Array, first: Rows, counts: Rows) -> tuple[Array, Array]:
    """Return means (w, k) and the largest standard deviation (w,) of consecutive groups of rows."""
    mean = np.add.reduceat(values, first, axis=0) / counts[:, None]
    square = np.add.reduceat(values**2, first, axis=0) / counts[:, None]
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0)).max(axis=1)


def _drivers(t: Array, temperature: Array | None, charging: list[Charging]) -> dict[str, Array]:
    drivers = {"time": t, **{f"warmup {tau:g}": -np.expm1(-t / tau) for tau in TAUS_S}}
    if temperature is not None and np.ptp(temperature) > 0.2:
        drivers["temperature"] = temperature - temperature.mean()
    if charging:
        times, on = np.array([e.t for e in charging]), np.array([float(e.on) for e in charging])
        index = np.searchsorted(times, t, side="right") - 1
        drivers["charging"] = np.where(index >= 0, on[np.maximum(index, 0)], 1.0 - on[0])
    for at in np.quantile(t, np.linspace(0.1, 0.9, STEPS)):
        drivers[f"step {at:g}"] = (t >= at).astype(np.float64)
    return {name: course for name, course in drivers.items() if np.ptp(course) > 0.0}


_NAMES = {
    "temperature": ("bias_temperature", "slope", "/K"),
    "time": ("bias_drift", "rate", "/s"),
    "charging": ("charging_bias", "step", ""),
    "warmup": ("warmup", "amplitude", ""),
    "step": ("bias_step", "step", ""),
}


def candidates(view: Seen, sensor: str) -> list[Candidate]:
    """Return all hypotheses about a sensor; a gyroscope's columns are those of one axis."""
    unit = "m/s^2" if sensor == "accel" else "rad/s"
    found = []
    for driver, course in view.drivers.items():
        kind, _, shape = driver.partition(" ")
        name, parameter, per = _NAMES[kind]
        columns = view.up * course[:, None] if sensor == "accel" else course[:, None]
        told = (
            {"tau_s": float(shape)} if kind == "warmup" else {"at_s": float(shape)} if kind == "step" else {}
        )
        found.append(Candidate(f"{sensor}_{name}", sensor, kind, parameter, unit + per, columns, told))
    if sensor == "gyro":
        matrix = view.g * view.up
        return [
            *found,
            Candidate("gyro_g_sensitivity", "gyro", "gravity", "matrix", "(rad/s)/(m/s^2)", matrix, {}),
        ]
    if "temperature" in view.drivers:
        columns = view.g * view.up**2 * view.drivers["temperature"][:, None]
        found.append(
            Candidate("accel_scale_temperature", "accel", "temperature", "slope", "1/K", columns, {})
        )
    cube = view.up * (view.g * view.up) ** 2
    return [*found, Candidate("accel_nonlinearity", "accel", "gravity", "quadratic", "1/(m/s^2)", cube, {})]
