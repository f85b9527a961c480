"""Structure outside the catalogue: generic columns that compete under the name `unknown`.

They name no physics; where one of them wins, the answer says what is followed and stops there.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit.catalogue import drivers
from stillcal.calib_core.misfit.catalogue.bias import SIZE, UNIT
from stillcal.calib_core.misfit.catalogue.entry import (
    Entry,
    Hypothesis,
    Linear,
    Scene,
    bias_columns,
    curves,
    moves,
)
from stillcal.calib_core.misfit.catalogue.force import distinct
from stillcal.calib_core.samples import Array

PULSE_CUTS = 13
PERIODS = (1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)


def unit_range(curve: Array) -> Array:
    """Return a curve about its mean, scaled so that it spans one."""
    return np.asarray((curve - curve.mean()) / max(float(np.ptp(curve)), 1e-12))


def _temperature_curvature(scene: Scene) -> list[drivers.Driver]:
    return [({}, unit_range(c**2)) for _, c in drivers.temperature(scene)]


def _temperature_rate(scene: Scene) -> list[drivers.Driver]:
    return [
        ({}, unit_range(np.gradient(c, scene.bins.t))) for _, c in drivers.temperature(scene) if len(c) > 3
    ]


def _vibration(scene: Scene) -> list[drivers.Driver]:
    power = scene.bins.vibration
    size = float(np.median(power)) if power.size else 1.0
    return [({}, unit_range(power))] if moves(power / size, 1.0) else []


def _pulses(scene: Scene) -> list[drivers.Driver]:
    """One between two of `PULSE_CUTS` times and nothing outside."""
    start, end = scene.bins.span
    cuts = np.linspace(start, end, PULSE_CUTS)[1:-1]
    t = scene.bins.t
    pairs = [(a, b) for i, a in enumerate(cuts) for b in cuts[i + 1 :]]
    return [({"t_start": float(a), "t_end": float(b)}, ((t >= a) & (t < b)).astype(float)) for a, b in pairs]


def _kinks(scene: Scene) -> list[drivers.Driver]:
    """Return ramps that begin at a time."""
    start, end = scene.bins.span
    return [
        ({"t_start": float(a)}, np.maximum(scene.bins.t - a, 0.0) / (end - start))
        for a in np.linspace(start, end, 10)[1:-1]
    ]


def _periodic(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """Sine and cosine of a period, on each axis."""
    span = scene.bins.span[1] - scene.bins.span[0]
    found = []
    for cycles in PERIODS:
        phase = 2.0 * np.pi * cycles * (scene.bins.t - scene.bins.span[0]) / span
        both = [bias_columns(scene, wave(phase)) for wave in (np.sin, np.cos)]
        columns = tuple(np.concatenate(c, axis=2) for c in zip(*both, strict=True))
        found.append(Hypothesis(entry, {"period_s": span / cycles}, columns))
    return found


def _gravity_squared(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """Rate by squares and products of gravity's components, the same five on each axis."""
    if scene.up is None or scene.sensor != "gyro" or distinct(scene.up) < 8:
        return []
    u = scene.up
    terms = np.stack(
        [u[:, 0] ** 2, u[:, 1] ** 2, u[:, 0] * u[:, 1], u[:, 0] * u[:, 2], u[:, 1] * u[:, 2]], axis=1
    )
    return [Hypothesis(entry, {}, tuple(_outer(v.project, terms[v.bins]) for v in scene.views))]


def _outer(project: Array, terms: Array) -> Array:
    both = project[:, :, :, None] * terms[None, :, None, :]
    return np.asarray(both.reshape(*both.shape[:2], -1))


def entries(sensor: str) -> list[Entry]:
    """Return the generic entries of one sensor."""
    unit = UNIT[sensor]
    say = "Something outside the catalogue moves the bias on {axes}: it follows "
    table = [
        ("curvature in temperature", curves(_temperature_curvature), "amplitude", 3),
        ("rate of temperature", curves(_temperature_rate), "amplitude", 3),
        ("vibration power", curves(_vibration), "amplitude", 3),
        ("a stretch of time", curves(_pulses), "amplitude", 3),
        ("time from a moment on", curves(_kinks), "amplitude", 3),
        ("a period in time", _periodic, "amplitude", 6),
        ("attitude, nonlinearly", _gravity_squared, "amplitude", 15),
    ]
    grid = {"t_start": "s", "t_end": "s", "period_s": "s"}
    return [
        Entry(
            "unknown",
            sensor,
            f,
            propose,
            (Linear(name, unit, k, SIZE[sensor]),),
            say + f + ".",
            grid_units=grid,
        )
        for f, propose, name, k in table
    ]
