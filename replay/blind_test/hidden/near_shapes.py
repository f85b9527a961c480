"""Effects that are almost a named one: the name fits, its pure form does not.

A right answer gives the name and says that something is left (`partly_identified`, or an unknown beside it),
or calls all of it unknown. Wrong is the pure form alone, stated as the whole of it. Sizes are drawn by what
the best pure form leaves, as d'.
"""

from __future__ import annotations

import math

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.hidden.kind import (
    Altered,
    HiddenKind,
    one_axis,
    samples_of,
    signed,
    whole,
    with_values,
)
from stillcal.replay.blind_test.hidden.off_catalogue import with_stamps
from stillcal.replay.blind_test.power.sizing import Stage
from stillcal.replay.blind_test.world.noise import log_uniform
from stillcal.replay.blind_test.world.phones import MadeRecording


def _two_constants(stage: Stage) -> Array:
    """Return a warm-up with two time constants: the die's package and the phone about it.

    A chain of two thermal masses answers a step of power with two exponentials (Incropera, Fundamentals of
    Heat and Mass Transfer, lumped capacitance).
    """
    fast = log_uniform(stage.rng, 25.0, 60.0)
    slow = fast * stage.rng.uniform(8.0, 15.0)
    share = stage.rng.uniform(0.4, 0.6)
    t = stage.world.t
    course = share * -np.expm1(-t / fast) + (1.0 - share) * -np.expm1(-t / slow)
    return np.asarray(course[:, None] * stage.direction())


def _thermal_course(stage: Stage) -> Array:
    """Return the temperature within its span, 0 to 1."""
    warmth = stage.world.temperature
    return np.asarray((warmth - warmth.min()) / max(float(np.ptp(warmth)), 1e-9))


def _saturating(stage: Stage) -> Array:
    """Return a bias that rises with temperature ever more slowly, as where a trim runs out of range."""
    rise = np.tanh(stage.rng.uniform(2.0, 3.5) * _thermal_course(stage))
    return np.asarray(rise[:, None] * stage.direction())


def _kinked(stage: Stage) -> Array:
    """Return a bias that follows temperature only above a point.

    Piecewise linear compensation in the part's logic: segments meet at trimming temperatures.
    """
    kink = stage.rng.uniform(0.35, 0.65)
    return np.asarray(np.maximum(_thermal_course(stage) - kink, 0.0)[:, None] * stage.direction())


def _settling_step(stage: Stage) -> Array:
    """Return a step of which half relaxes within minutes, as stress does after a knock."""
    at = stage.rng.uniform(0.25, 0.6) * stage.world.duration
    since = np.maximum(stage.world.t - at, 0.0)
    tau = log_uniform(stage.rng, 60.0, 0.2 * stage.world.duration)
    left = stage.rng.uniform(0.3, 0.6)
    course = np.where(stage.world.t >= at, left + (1.0 - left) * np.exp(-since / tau), 0.0)
    return np.asarray(course[:, None] * stage.direction())


def _g_and_square(stage: Stage) -> Array:
    """Return g-sensitivity with a part that goes with the square of the force (IEEE Std 528 names both)."""
    force = stage.world.force
    matrix = stage.rng.standard_normal((3, 3)) * (stage.rng.random((3, 3)) < 0.4) + np.diag(stage.direction())
    square = stage.direction() * force[:, one_axis(stage), None] ** 2 / 9.8
    return np.asarray(force @ matrix.T + stage.rng.uniform(0.7, 1.5) * square)


def _scale_asymmetry(stage: Stage) -> Array:
    """Return a force on whose positive side the scale is another than on its negative one.

    Scale factor asymmetry (IEEE Std 528): even in the force like a square, but with a kink at zero.
    """
    return np.asarray(np.abs(stage.world.force) * stage.direction())


def _relaxing_charge(stage: Stage) -> Array:
    """Return a bias that follows the battery's voltage: a step at the plug, and what relaxes after it.

    Two time constants of a lithium cell (Chen and Rincon-Mora 2006, IEEE Trans. Energy Convers. 21, 504):
    the voltage rises at once by the resistance, then over a minute or some, and falls as it rose.
    """
    tau, step = log_uniform(stage.rng, 60.0, 200.0), 10.0
    coarse = np.arange(0.0, stage.world.duration + step, step)
    plug = np.interp(coarse, stage.world.t, stage.world.charging)
    slow = np.zeros(coarse.size)
    for i in range(1, coarse.size):
        slow[i] = plug[i] + (slow[i - 1] - plug[i]) * math.exp(-step / tau)
    share = stage.rng.uniform(0.5, 0.8)
    course = (1.0 - share) * stage.world.charging + share * np.interp(stage.world.t, coarse, slow)
    return np.asarray(course[:, None] * stage.direction())


def _log_drift(stage: Stage) -> Array:
    """Return a drift with the logarithm of time, as charge creeps into the dielectrics of a capacitive part.

    Charging of dielectrics in MEMS (Wibbeler, Pfeifer and Hietschold 1998, Sens. Actuators A 71, 74).
    """
    since = np.log1p(stage.world.t / log_uniform(stage.rng, 2.0, 20.0))
    return np.asarray(since[:, None] * stage.direction())


def _growing_delay(stage: Stage) -> Array:
    """Return what a gyroscope measures late by a delay that grows from nothing to 10 to 40 ms.

    Two sensors stamped by counters of their own that drift apart by some ppm to tens of ppm.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - only recordings that are made need it

    t, rate = stage.world.t, stage.world.rate
    delay = signed(stage, 0.01, 0.04) * t / t[-1]
    return np.asarray(CubicSpline(t, rate)(np.clip(t - delay, t[0], t[-1])) - rate)


def _changing_skew(recording: MadeRecording, stage: Stage) -> Altered:
    """Let the clock run fast by 0.2 to 1 % in one half of the recording and slow by half of it in the other.

    A part's own RC oscillator, good to a per cent or so, whose trim the host writes anew.
    """
    t = recording.accelerometer.t
    middle, fast = t[-1] * stage.rng.uniform(0.4, 0.6), signed(stage, 0.002, 0.01)
    moved = np.where(t < middle, t * (1.0 + fast), middle * (1.0 + fast) + (t - middle) * (1.0 - fast / 2.0))
    return Altered(with_stamps(recording, moved), *whole(recording))


def _sweeping_tone(recording: MadeRecording, stage: Stage) -> Altered:
    """Add a tone to one sensor that sweeps through a fifth to two fifths of the band in the recording.

    Sound near a gyroscope's resonance aliases into its output, and the pitch of the alias goes with the
    part's clock and temperature (Son et al. 2015, Rocking Drones, USENIX Security).
    """
    samples, rate = samples_of(recording, "gyro"), stage.phone.clock.rate_hz
    first, width = stage.rng.uniform(0.1, 0.2) * rate, stage.rng.uniform(0.1, 0.2) * rate
    t = samples.t
    phase = 2.0 * math.pi * (first * t + width * t**2 / (2.0 * t[-1]))
    values, step = samples.xyz.copy(), stage.phone.gyro.lsb
    size = stage.sigma("gyro") * log_uniform(stage.rng, 0.5, 2.0)
    values[:, one_axis(stage)] += np.round(size * np.sin(phase) / step) * step
    return Altered(with_values(recording, "gyro", values), *whole(recording))


NEAR_SHAPES: dict[str, HiddenKind] = {
    "two_time_constants": HiddenKind("gyro", _two_constants, sized=True, nearest=("gyro_warmup",)),
    "saturating_temperature": HiddenKind(
        "accel", _saturating, sized=True, thermometer=True, nearest=("accel_bias_temperature",)
    ),
    "kinked_temperature": HiddenKind(
        "gyro", _kinked, sized=True, thermometer=True, nearest=("gyro_bias_temperature",)
    ),
    "settling_step": HiddenKind("accel", _settling_step, sized=True, nearest=("accel_bias_step",)),
    "g_and_square": HiddenKind("gyro", _g_and_square, sized=True, nearest=("gyro_g_sensitivity",)),
    "scale_asymmetry": HiddenKind("accel", _scale_asymmetry, sized=True, nearest=("accel_nonlinearity",)),
    "relaxing_charge": HiddenKind("accel", _relaxing_charge, sized=True, nearest=("accel_charging_bias",)),
    "logarithmic_drift": HiddenKind(
        "gyro", _log_drift, sized=True, nearest=("gyro_bias_drift", "gyro_warmup")
    ),
    "growing_delay": HiddenKind("gyro", _growing_delay, nearest=("accel_gyro_time_offset",)),
    "changing_skew": HiddenKind("timing", altered=_changing_skew, nearest=("clock_skew",)),
    "sweeping_tone": HiddenKind("gyro", altered=_sweeping_tone, nearest=("vibration_tone",)),
}
"""Near-shapes by name; only keys use these names."""
