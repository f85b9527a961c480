"""Biases that follow the clock or the plug: drift, step, charging."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.bias import SIZE, BiasEffect
from stillcal.calib_core.diagnosis.model.effect import BLOCKS_ACROSS, Dictionary, Grid, Linear
from stillcal.calib_core.diagnosis.model.moments import Moments, moves
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT

DRIFT_PENALTY = 1.5
"""A ramp is what a random walk looks like: steady drift must be thirty times less likely by chance."""

MOST_STEPS = 250
PARTS = 6
"""A step is tried after every sixth of a bin, of at most `MOST_STEPS` bins."""

FINE = 4 * PARTS
NEAR_BINS = 3


class Drift(BiasEffect):
    """The bias grows steadily with time."""

    kind = "bias_drift"
    says = "drifts steadily"
    called_as = "steady drift of {bias}"
    follows = "time"
    equation = "bias(t) = bias(0) + rate t"
    remedy = "calibrate more often"
    decides = "record for several times as long"
    prior_penalty = DRIFT_PENALTY

    def __init__(self, sensor: str) -> None:
        super().__init__(sensor)
        self.parameters = (Linear("rate", f"{UNIT[sensor]}/s", 3, SIZE[sensor] / 3600.0),)
        thermal, walk = f"{sensor}_bias_temperature", f"{sensor}_bias_random_walk"
        self.look_alikes = (f"{sensor}_warmup", thermal, walk)

    def curve(self, moments: Moments, grid: Grid) -> Array:
        """Return the time since the recording began, s."""
        return moments.age


class Charging(BiasEffect):
    """The bias is another while the phone is on the charger, at once."""

    kind = "charging_bias"
    says = "changes while charging"
    called_as = "change of {bias} while charging"
    follows = "charging"
    equation = "bias = bias(unplugged) + step charging(t)"
    remedy = "calibrate with and without the charger"
    decides = "plug in and out several times, some minutes apart"

    def __init__(self, sensor: str) -> None:
        super().__init__(sensor)
        self.parameters = (Linear("step", UNIT[sensor], 3, SIZE[sensor]),)
        self.look_alikes = (f"{sensor}_bias_temperature", f"{sensor}_bias_step", "thermal_latent")

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where rests on and off the charger were recorded."""
        return [{}] if moments.charging is not None and moves(moments.charging, 0.5) else []

    def curve(self, moments: Moments, grid: Grid) -> Array:
        """Return the part of each moment on the charger."""
        assert moments.charging is not None, "no grid points without charging events"
        return moments.charging


class Step(BiasEffect):
    """The bias jumps once, at a time that nobody told. A nudged phone steps across gravity too."""

    kind = "bias_step"
    says = "jumped"
    called_as = "step of {bias}"
    follows = "time"
    equation = "bias(t) = bias(0) + step (t >= t_start)"
    remedy = "calibrate more often"
    decides = "knock the phone again, or repeat with the plug untouched"
    grid_units = {"t_start": "s"}  # noqa: RUF012 - a constant of the class
    recurs = True
    blind = BLOCKS_ACROSS

    def __init__(self, sensor: str) -> None:
        super().__init__(sensor)
        self.parameters = (Linear("step", UNIT[sensor], 3, SIZE[sensor]),)
        self.look_alikes = (f"{sensor}_charging_bias", f"{sensor}_bias_random_walk")

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return none: the moments at which it may be are a dictionary."""
        return []

    def dictionary(self, moments: Moments) -> Dictionary | None:
        """Return steps within or between bins, two bins from either end."""
        if len(moments) < 6:
            return None
        inside = np.unique(np.linspace(2, len(moments) - 3, MOST_STEPS).round().astype(int))
        grids = [self._at(moments, int(i), part / PARTS) for i in inside for part in range(PARTS)]
        curves = np.array([self.curve(moments, g) for g in grids])[:, None]
        return Dictionary(grids, curves, 3 * inside.size)

    def finer(self, moments: Moments, grid: Grid) -> Sequence[Grid]:
        """Return steps within three bins, more finely."""
        middle = int(np.searchsorted(moments.t, grid["t_start"]))
        around = range(max(1, middle - NEAR_BINS), min(len(moments) - 1, middle + NEAR_BINS))
        return [self._at(moments, i, part / FINE) for i in around for part in range(FINE)]

    def curve(self, moments: Moments, grid: Grid) -> Array:
        """Return the part of each moment that lies after the step."""
        end = moments.t + moments.duration / 2.0
        length = np.maximum(moments.duration, 1e-9)
        return np.asarray(np.clip((end - grid["t_start"]) / length, 0.0, 1.0))

    def _at(self, moments: Moments, i: int, part: float) -> Grid:
        """Return a step after a part of the time from the end of bin i - 1 to that of bin i.

        In a pause between the two it is midway: a pause has as many points as it lasts, all of them alike.
        """
        start, end = moments.t - moments.duration / 2.0, moments.t + moments.duration / 2.0
        within = float(end[i - 1] + part * (end[i] - end[i - 1]))
        return {"t_start": moments.border(i) if within <= start[i] else within}
