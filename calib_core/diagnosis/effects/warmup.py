"""Heat after the start, and heat of charging and use that no thermometer recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.bias import SIZE, BiasEffect
from stillcal.calib_core.diagnosis.model.effect import Grid, Linear, on_axes
from stillcal.calib_core.diagnosis.model.moments import Moments, moves
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT

TAUS = (60.0, 120.0, 240.0, 480.0, 960.0, 1920.0)
"""s: phones warm up within 2 to 20 minutes."""

SETTLED = "settled"
"""1 in the grid of a settling whose amplitude counts up to the settled bias, not from that of the start."""

LATENT_TAUS = (90.0, 200.0, 450.0, 900.0, 1800.0)

NEAR = np.geomspace(0.25, 4.0, 17)
"""Time constants within a factor of four of the best one on the coarse grid."""

ROUGH = 0.25
"""How far heat is from a first-order response to charging and use, as a part of it."""


def nearby(grid: Grid) -> list[Grid]:
    """Return grid points with time constants within a factor of four of one."""
    return [grid | {"tau_s": float(tau)} for tau in grid["tau_s"] * NEAR]


def time_constants(moments: Moments) -> list[Grid]:
    """Return the time constants up to half the recording: of one that lasts days, also hours, as of a box."""
    start, end = moments.history.span
    longer = TAUS[-1] * 2.0 ** np.arange(1, np.log2(max((end - start) / TAUS[-1], 1.0)))
    return [{"tau_s": float(tau)} for tau in (*TAUS, *longer) if tau <= (end - start) / 2.0]


def relaxation(moments: Moments, tau: float) -> Array:
    """Return the mean of 1 - exp(-age / tau) over each moment, (n,)."""
    half = np.maximum(moments.duration / (2.0 * tau), 1e-9)
    return np.asarray(1.0 - np.exp(-moments.age / tau) * np.sinh(half) / half)


class Warmup(BiasEffect):
    """The bias settles after the start of the recording as a first-order system does."""

    kind = "warmup"
    says = "settles after the start of the recording"
    called_as = "settling of {bias} after the start"
    follows = "time since start"
    equation = "bias(t) = bias(0) + amplitude (1 - exp(-t / tau_s))"
    from_settled = "bias(t) = bias(settled) - amplitude exp(-t / tau_s)"
    remedy = "let the phone warm up, or leave out the first minutes"
    decides = "switch on cold once more, or record temperature"
    grid_units = {"tau_s": "s"}  # noqa: RUF012 - a constant of the class

    def __init__(self, sensor: str) -> None:
        super().__init__(sensor)
        self.parameters = (Linear("amplitude", UNIT[sensor], 3, SIZE[sensor]),)
        self.look_alikes = (f"{sensor}_bias_temperature", f"{sensor}_bias_drift", "thermal_latent")

    def equation_at(self, grid: Mapping[str, float]) -> str:
        """Return the formula from the bias on that the amplitude counts from."""
        return self.from_settled if grid.get(SETTLED) else self.equation

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return time constants up to half the recording."""
        return time_constants(moments)

    def finer(self, moments: Moments, grid: Grid) -> Sequence[Grid]:
        """Return time constants within a factor of four."""
        return nearby(grid)

    def curve(self, moments: Moments, grid: Grid) -> Array:
        """Return 1 - exp(-age / tau), less 1 where the settled bias is the one it counts from."""
        return relaxation(moments, grid["tau_s"]) - grid.get(SETTLED, 0.0)


class LatentHeat(BiasEffect):
    """The bias follows a temperature that was not recorded: first order in charging, use and the start.

    All sources share one time constant; their shares are gridded. The curve's unit is its own range.
    """

    says = "follows the heat of charging and use, which was not recorded,"
    called_as = "change of bias with heat from charging and use"
    kind = "latent"
    follows = "charging and use"
    equation = "tau_s z' = plug charging(t) + use active(t) - z, z(0) = start; bias = amplitude z / range(z)"
    remedy = "record the temperature, or calibrate at the temperature of use"
    decides = "record temperature, or let the phone cool unplugged"
    grid_units = {"tau_s": "s"}  # noqa: RUF012 - a constant of the class
    rough = ROUGH

    def __init__(self, sensor: str) -> None:
        super().__init__(sensor)
        self.name = "thermal_latent"
        self.parameters = (Linear("amplitude", UNIT[sensor], 3, SIZE[sensor]),)
        self.look_alikes = (f"{sensor}_warmup", f"{sensor}_charging_bias", f"{sensor}_bias_drift")

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return time constants and shares, only where no thermometer was recorded and the sources show.

        Without them a start off balance is a warm-up, which has its own name.
        """
        if moments.temperature is not None:
            return []
        shares = [(1.0, 0.0, 0.0), (1.0, 0.0, -0.7), (1.0, 0.0, 0.7), (1.0, 0.5, 0.0)]
        if not moments.history.charger_moved:
            shares = [(0.0, 1.0, 0.0), (0.0, 1.0, -0.7), (0.0, 1.0, 0.7)]
        grids = [
            {"tau_s": tau, "plug": plug, "use": use, "start": start}
            for tau, (plug, use, start) in product(LATENT_TAUS, shares)
        ]
        return [g for g in grids if moves(_heat(moments, g | {"start": 0.0}), 0.05)]

    def finer(self, moments: Moments, grid: Grid) -> Sequence[Grid]:
        """Return time constants within a factor of four."""
        return nearby(grid)

    def curve(self, moments: Moments, grid: Grid) -> Array:
        """Return the latent temperature, scaled to a range of one over the whole recording."""
        return np.asarray(_heat(moments, grid) / np.ptp(moments.history.heat_throughout(**grid)))

    def companions(self, moments: Moments) -> Sequence[Array]:
        """Return the slow and fast parts that heat of the same sources, and a start off balance, may have."""
        lags = (100.0, 600.0, 2400.0)
        sources = [(1.0, 0.0)] * moments.history.charger_moved + [(0.0, 1.0)]
        heat, t, length = moments.history.heat, moments.t, moments.duration
        curves = [heat(t, length, tau, plug, use, 0.0) for plug, use in sources for tau in lags]
        curves += [relaxation(moments, tau) for tau in (150.0, 900.0, 2400.0)]
        return [on_axes(c / np.ptp(c)) for c in curves if moves(c, 1e-3)]


def _heat(moments: Moments, grid: Grid) -> Array:
    plug, use, start = grid["plug"], grid["use"], grid["start"]
    return moments.history.heat(moments.t, moments.duration, grid["tau_s"], plug, use, start)
