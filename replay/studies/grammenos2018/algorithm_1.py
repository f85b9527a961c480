"""Algorithm 1 of Grammenos et al. 2018 exactly as printed, over arrays: the baseline to compare with.

Its weaknesses are kept on purpose: running minima that only fall, a start that either admits walking or
admits nothing, no look at gaps, repeats or drift. The detector in use is `calib_core.static`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.gather import uniform
from stillcal.calib_core.static.settings import DetectorSettings
from stillcal.calib_core.streams.samples import Samples


@dataclass(frozen=True, slots=True, eq=False)
class PaperState:
    """One stationary state (line 25): averages over [t_start, t_end), s, with the deviations judged."""

    t_start: float
    t_end: float
    specific_force: Array
    rate: Array | None
    sigma_accel: float
    sigma_gyro: float


@dataclass(frozen=True, slots=True, eq=False)
class PaperRun:
    """What the algorithm found, and where its running minima ended, m/s^2 and rad/s.

    probes: how often it looked. sensing_s: s for which it gathered measurements.
    """

    states: list[PaperState]
    sigma_accel_min: float
    sigma_gyro_min: float
    probes: int
    sensing_s: float


def algorithm_1(
    accel: Samples,
    gyro: Samples | None,
    *,
    states: int,
    sigma_accel_min: float = 9.80665,
    sigma_gyro_min: float = 0.01,
    settings: DetectorSettings | None = None,
) -> PaperRun:
    """Run Algorithm 1 over a recording until `states` states are found or it ends.

    sigma_accel_min, sigma_gyro_min: what the minima start from, "close to g" (line 3) and "near 0" (line 4).
    Factors, windows, pauses between probes (p) and seed come from `settings`. Without gyroscope its
    condition counts as met.
    """
    k = settings or DetectorSettings()
    found: list[PaperState] = []
    now, drawn, probes, sensing = float(accel.t[0]), 0, 0, 0.0
    while len(found) < states:
        now += k.probe_min_s + (k.probe_max_s - k.probe_min_s) * uniform(k.seed, drawn)
        w_max = k.w_min_s + k.w_spread_s * uniform(k.seed, drawn + 1)
        drawn += 2
        if now + w_max > accel.t[-1]:
            break
        probes += 1
        limits = (k.accel_factor * sigma_accel_min, k.gyro_factor * sigma_gyro_min)
        state = _window(accel, gyro, now, now + k.w_min_s)
        if _below(state, limits):
            state = _window(accel, gyro, now, now + w_max)
            if _below(state, limits):
                sigma_accel_min = min(sigma_accel_min, state.sigma_accel)
                if gyro is not None:
                    sigma_gyro_min = min(sigma_gyro_min, state.sigma_gyro)
                found.append(state)
        sensing += state.t_end - now
        now = state.t_end
    return PaperRun(found, sigma_accel_min, sigma_gyro_min, probes, sensing)


def _below(state: PaperState, limits: tuple[float, float]) -> bool:
    return state.sigma_accel < limits[0] and state.sigma_gyro < limits[1]


def _window(accel: Samples, gyro: Samples | None, t_start: float, t_end: float) -> PaperState:
    """Gather one window and its deviations: of the norm (lines 11, 15), of all gyroscope axes (12, 16)."""
    force = accel.between(t_start, t_end).xyz
    if force.shape[0] == 0:
        return PaperState(t_start, t_end, frozen(np.zeros(3)), None, np.inf, np.inf)
    sigma_accel = float(np.linalg.norm(force, axis=1).std())
    if gyro is None:
        return PaperState(t_start, t_end, frozen(force.mean(axis=0)), None, sigma_accel, -np.inf)
    rate = gyro.between(t_start, t_end).xyz
    if rate.shape[0] == 0:
        return PaperState(t_start, t_end, frozen(force.mean(axis=0)), None, sigma_accel, np.inf)
    sigma_gyro = float(np.sqrt(rate.var(axis=0).mean()))
    means = frozen(force.mean(axis=0)), frozen(rate.mean(axis=0))
    return PaperState(t_start, t_end, *means, sigma_accel, sigma_gyro)
