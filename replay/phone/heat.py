"""The phone's temperature: ambient, use and charging through two first-order lags."""

from __future__ import annotations

from dataclasses import dataclass

from stillcal.calib_core.arrays import Array
from stillcal.replay.phone.settings import HeatSettings
from stillcal.replay.phone.timeline import Lag, Steps


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What acts on the phone besides motion. ambient: degC; use: 0..1; charging: 0 or 1, all against s."""

    ambient: Steps
    use: Steps
    charging: Steps

    def heating(self) -> Steps:
        """Return use plus charging, the drive that warms the phone, as steps."""
        return Steps.of(self.use.t, self.use.value + self.charging.value)


class Heat:
    """Case temperature at any time, a pure function of the surroundings."""

    def __init__(self, settings: HeatSettings, surroundings: Surroundings) -> None:
        rise = settings.use_k * surroundings.use.value + settings.charge_k * surroundings.charging.value
        target = Steps.of(surroundings.use.t, surroundings.ambient.value + rise)
        initial = float(surroundings.ambient.value[0]) + settings.start_k
        self._share = settings.fast_share
        self._fast: Lag = target.lagged(settings.fast_tau_s, initial)
        self._slow: Lag = target.lagged(settings.slow_tau_s, initial)

    def at(self, t: Array) -> Array:
        """Return the temperature in degC at times (n,) s."""
        return self._share * self._fast.at(t) + (1.0 - self._share) * self._slow.at(t)
