"""How far an effect is from everything that has a name: what the best named effect leaves of it, as d'."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.power import detectability as power
from stillcal.replay.blind_test.world.day import Bins
from stillcal.replay.blind_test.world.forward_model import FORWARD, played, sensor_of

TAUS, PARTS = 40, 6
"""Number of time constants that a named effect is fitted with, and of times of a step within each bin: at d'
of 50 a step that is off by half a bin leaves d' of several."""

CURVES = ("slope", "quadratic", "cubic", "rate")
"""Parameters of a temperature effect: the pure form is the first."""


def left_by_names(
    bins: Bins, sensor: str, weight: Array, delta: Array, names: tuple[str, ...] | None = None
) -> float:
    """Return d' of what is left of bins' values (m, 3) once the best single named effect is fitted to them.

    names: of the effects that are tried, in their pure form; None for all of the sensor's, temperature
    effects with a curve and with the rate of warming. weight: the inverse covariance of the bins.
    """
    best = power.form(weight, delta)
    flat = delta.T.ravel()
    for columns in _designs(bins, sensor, names):
        projected = weight @ columns
        normal = columns.T @ projected
        fitted = np.linalg.lstsq(normal, projected.T @ flat, rcond=1e-10)[0]
        best = min(best, power.form(weight, delta - (columns @ fitted).reshape(3, -1).T))
    return math.sqrt(best)


def _designs(bins: Bins, sensor: str, names: tuple[str, ...] | None) -> Iterator[Array]:
    """Yield the columns (3m, k) of each named effect, for each of its shapes."""
    chosen = names or tuple(n for n in FORWARD if sensor_of(n, sensor) == sensor)
    for name in chosen:
        if name not in FORWARD:
            continue
        for shape in _shapes(bins, name):
            columns = [
                played(bins, name, {**shape, **unit}).T.ravel() for unit in _units(name, names is None)
            ]
            yield np.stack(columns, axis=1)


def _shapes(bins: Bins, name: str) -> list[dict[str, float]]:
    duration = float(bins.t[-1])
    if name.endswith("_warmup"):
        return [{"tau_s": tau} for tau in np.geomspace(20.0, duration, TAUS)]
    if name == "thermal_latent":
        return [{"tau_s": tau} for tau in np.geomspace(60.0, 1200.0, TAUS)]
    if name.endswith("_bias_step"):
        within = bins.width * (np.arange(PARTS) / PARTS - 0.5)
        return [{"at_s": float(at)} for at in (bins.t[:, None] + within).ravel()]
    return [{}]


def _units(name: str, curved: bool) -> list[dict[str, list[float] | list[list[float]]]]:
    """Return the parameters that are linear, one at a time."""
    if name == "gyro_g_sensitivity":
        return [{"matrix": np.eye(9)[i].reshape(3, 3).tolist()} for i in range(9)]
    if name.endswith("_nonlinearity"):
        sizes: tuple[str, ...] = ("quadratic", "cubic")
    elif name.endswith("_bias_temperature"):
        sizes = CURVES if curved else CURVES[:1]
    else:
        sizes = (
            "slope" if name.endswith("_temperature")
            else "step" if name.endswith(("_step", "_charging_bias"))
            else "rate" if name.endswith("_drift")
            else "amplitude",
        )  # fmt: skip
    zero = [0.0, 0.0, 0.0]
    return [
        {size: np.eye(3)[axis].tolist(), **({"slope": zero} if size in CURVES[1:] and "temp" in name else {})}
        for size in sizes
        for axis in range(3)
    ]
