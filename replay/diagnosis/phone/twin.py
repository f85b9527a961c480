"""The true input of a recording, and what the effects of a phone file add to it.

The phone's own forward equations (`stillcal.replay.phone`) are evaluated on the recorded
quantities: temperature, charging, attitude, rate, time since the start. Only the affine baseline is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.residuals import Baseline, fit_baseline
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone.effects.base import Circumstances, Effect, Moment
from stillcal.replay.phone.effects.registry import EFFECTS
from stillcal.replay.phone.heat import Surroundings
from stillcal.replay.phone.noise import seeded
from stillcal.replay.phone.timeline import Steps

UNPREDICTED = frozenset({"spikes", "vibration_tone", "tilt_creep"})
"""Effects that cannot be computed from a recording: random, of unknown phase, or true motion."""

ROUNDS = 2
"""Of the fit: effects follow the attitude, which the fit finds."""


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """The conditions of a recording. t_start: s, its first stamp; reference_c: degC, mean temperature.

    surroundings: charging and use (where it moved) by s since the start.
    """

    t_start: float
    reference_c: float
    surroundings: Surroundings


def conditions_of(bins: Bins) -> Conditions:
    """Return the conditions that the static bins and events show."""
    start = bins.span[0]
    reference = 25.0 if bins.temperature is None or len(bins) == 0 else float(bins.temperature.mean())
    active = np.flatnonzero(np.diff(bins.activity[:, 1], prepend=np.nan) != 0.0)
    t = bins.activity[active, 0] - start
    use, plug = Steps.of(t, bins.activity[active, 1]), _charger(bins)
    both = np.union1d(use.t, plug.t)
    steady = Steps.of(both, np.full(both.size, reference))
    return Conditions(start, reference, Surroundings(steady, Steps.of(both, use.at(both)), _on(both, plug)))


def _on(t: Array, steps: Steps) -> Steps:
    return Steps.of(t, steps.at(t))


def _charger(bins: Bins) -> Steps:
    if bins.charging_switches is None:
        return Steps.of([0.0], [0.0])
    return Steps.of(bins.charging_switches[:, 0] - bins.span[0], bins.charging_switches[:, 1])


def at_bins(bins: Bins, conditions: Conditions, up: Array, gravity: float = STANDARD) -> Moment:
    """Return the true input in the middle of every static bin. up: (n, 3) unit vector of gravity."""
    t, still = bins.t - conditions.t_start, np.zeros((len(bins), 3))
    warmth = np.zeros(len(bins)) if bins.temperature is None else bins.temperature - conditions.reference_c
    charging = conditions.surroundings.charging.at(t) if bins.charging is None else bins.charging
    return Moment(t, gravity * up, still, still, warmth, charging)


def observable(effect: Effect) -> bool:
    """Whether what an effect adds to the output can be computed from a recording."""
    kind = EFFECTS[effect.name]
    acts = kind.output_term is not Effect.output_term or kind.input_term is not Effect.input_term
    return acts and effect.name not in UNPREDICTED


def effects_output(
    effects: Sequence[Effect], sensor: Sensor, moment: Moment, conditions: Conditions, rate_hz: float
) -> Array:
    """Return what the observable effects add to a sensor's output, (n, 3), in its unit."""
    total = np.zeros_like(moment.force)
    for effect in effects:
        if not (observable(effect) and effect.concerns(sensor)):
            continue
        circumstances = Circumstances(rate_hz, conditions.surroundings, seeded(0, effect.name))
        terms = (effect.input_term(circumstances), effect.output_term(sensor, circumstances))
        total = sum((term(moment) for term in terms if term is not None), start=total)
    return total


def skew_of(effects: Sequence[Effect]) -> float:
    """Return by what part the device's clock is fast, by the effects found.

    A second of its stamps is 1 / (1 + skew) s of true time, so a rate is 1 + skew times what its angle and
    its stamps give.
    """
    return sum(float(getattr(e, "relative", 0.0)) for e in effects if e.name == "clock_skew")


@dataclass(frozen=True, slots=True, eq=False)
class AffinePhone:
    """The affine part of a phone. accel, gyro: (n, 3), what the effects add in each static bin.

    rate_mapping: (3, 3), true rate = rate_mapping @ (raw rate - rate_bias).
    """

    baseline: Baseline
    rate_bias: Array
    accel: Array
    gyro: Array
    rate_mapping: Array = field(default_factory=lambda: np.eye(3))

    def true_force(self, raw: Array) -> Array:
        """Return the specific force (n, 3) behind raw readings (n, 3), m/s^2."""
        return np.asarray((raw - self.baseline.bias) @ self.baseline.scale.T)

    def true_rate(self, raw: Array) -> Array:
        """Return the rate (n, 3) behind raw readings (n, 3), rad/s."""
        return np.asarray((raw - self.rate_bias) @ self.rate_mapping.T)


def fit_affine(bins: Bins, effects: Sequence[Effect], conditions: Conditions, gravity: float) -> AffinePhone:
    """Fit the affine phone to the static bins without the effects; an ideal phone where there are no bins."""
    accel = gyro = np.zeros_like(bins.force)
    if len(bins) == 0:
        faultless = Baseline(np.eye(3), np.zeros(3), np.empty((0, 3)), np.empty(0), np.empty((0, 9)))
        return AffinePhone(faultless, np.zeros(3), accel, gyro)
    for _ in range(ROUNDS):
        baseline = fit_baseline(bins.force - accel, bins.force_variance, bins.rest, gravity)
        moment = at_bins(bins, conditions, baseline.up, gravity)
        accel = effects_output(effects, Sensor.ACCELEROMETER, moment, conditions, 1.0 / 10.0)
        gyro = effects_output(effects, Sensor.GYROSCOPE, moment, conditions, 1.0 / 10.0)
    baseline = fit_baseline(bins.force - accel, bins.force_variance, bins.rest, gravity)
    return AffinePhone(baseline, _mean_rate(bins, gyro), accel, gyro)


def _mean_rate(bins: Bins, gyro: Array) -> Array:
    if bins.rate is None:
        return np.zeros(3)
    return np.asarray(np.average(bins.rate - gyro, axis=0, weights=bins.duration))
