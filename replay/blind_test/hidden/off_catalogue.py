"""Real effects outside the diagnosis' catalogue: a right answer calls them unknown, and says where.

Each states its physics and where that is described. Sizes are those of parts in phones where a source gives
one; effects that are `sized` are drawn by how well they can be told from everything that has a name.
IEEE Std 528-2019 is the terminology of inertial sensors, IEEE Std 1293-2018 that of accelerometers' models.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.replay.blind_test.hidden.kind import (
    Altered,
    HiddenKind,
    a_while,
    one_axis,
    samples_of,
    whole,
    with_values,
)
from stillcal.replay.blind_test.power.sizing import Stage
from stillcal.replay.blind_test.world.noise import log_uniform
from stillcal.replay.blind_test.world.phones import MadeRecording

REFERENCE_C = 25.0
"""Temperature at which effects of temperature are zero, degC."""


def _acceleration_squared(stage: Stage) -> Array:
    """Return a rate that follows the square of the force along one axis, unlike g-sensitivity even in it.

    Acceleration-squared-sensitive drift rate (IEEE Std 528): the suspension yields unequally along its axes,
    so that the mass moves aside in proportion to the square of the load.
    """
    return np.asarray(stage.direction() * stage.world.force[:, one_axis(stage), None] ** 2)


def _cross_coupling(stage: Stage) -> Array:
    """Return a force on one axis that follows the product of the other two.

    Cross-coupling coefficients of the accelerometer's model equation (IEEE Std 1293): the mass that a load
    along one axis has moved aside feels that along another.
    """
    axis = one_axis(stage)
    out = np.zeros_like(stage.world.force)
    out[:, axis] = np.prod(np.delete(stage.world.force, axis, axis=1), axis=1)
    return out


def _alignment_temperature(stage: Stage) -> Array:
    """Return what a sensitive axis that turns as the package warms takes from the other two.

    A package bends as its layers expand unequally (Timoshenko 1925, J. Opt. Soc. Am. 11, 233), so its axes
    turn against each other. Scale against temperature keeps to an axis' own force.
    """
    axis = one_axis(stage)
    lean = stage.rng.standard_normal(3)
    lean[axis] = 0.0
    out = np.zeros_like(stage.world.force)
    out[:, axis] = (stage.world.temperature - REFERENCE_C) * (stage.world.force @ lean)
    return out


def _thermal_snap(stage: Stage) -> Array:
    """Return a bias that flips as it warms past one temperature, and back as it cools past a lower one.

    A stressed layer buckles and snaps back with hysteresis (Timoshenko 1925, J. Opt. Soc. Am. 11, 233).
    """
    warmth = stage.world.temperature
    low, span = float(warmth.min()), float(np.ptp(warmth))
    up, down = low + span * stage.rng.uniform(0.5, 0.7), low + span * stage.rng.uniform(0.3, 0.45)
    state = np.where(warmth > up, 1.0, np.where(warmth < down, 0.0, np.nan))
    known = np.maximum.accumulate(np.where(np.isnan(state), 0, np.arange(state.size)))
    return np.asarray(np.nan_to_num(state[known])[:, None] * stage.direction())


def _popcorn(stage: Stage) -> Array:
    """Return a bias that jumps between two levels at random, for half a minute or so at a time.

    Popcorn, or burst, noise of an amplifier: a single trap catches a carrier and lets it go
    (Kirton and Uren 1989, Advances in Physics 38, 367).
    """
    dwell = stage.rng.uniform(20.0, 60.0, 2)
    count = int(stage.world.duration / dwell.min()) + 4
    ends = np.cumsum(stage.rng.exponential(np.resize(dwell, count)))
    state = np.searchsorted(ends, stage.world.t) % 2
    return np.asarray(state[:, None] * stage.direction())


def _stairs(stage: Stage) -> Array:
    """Return what is left of a bias that a sensor hub halves every now and then.

    Hubs estimate the bias while the phone lies still and take it off in steps; Android asks vendors that
    the uncalibrated stream be free of such jumps (source.android.com, Sensor types), and not all heed it.
    """
    moments = np.sort(stage.rng.uniform(0.1, 0.9, int(stage.rng.integers(3, 7)))) * stage.world.duration
    return np.asarray(
        stage.rng.uniform(0.3, 0.6) ** np.searchsorted(moments, stage.world.t)[:, None] * stage.direction()
    )


def _common_noise(stage: Stage) -> Array:
    """Return noise that all axes share: it comes in by the reference voltage or the supply.

    Power-supply rejection of a converter with one reference for its channels is finite.
    """
    sigma = stage.sigma("accel") * stage.rng.uniform(0.7, 1.5)
    return np.asarray(
        sigma * stage.rng.standard_normal((stage.world.t.size, 1)) * stage.rng.choice([-1.0, 1.0], 3)
    )


def _range_register_reset(recording: MadeRecording, stage: Stage) -> Altered:
    """Double or halve all readings for a while: a brown-out has set the range register to its default.

    The driver goes on scaling by the range that it once set. Ranges of consumer parts are powers of two.
    """
    samples = samples_of(recording, "accel")
    begin, end = a_while(stage, 0.1, 0.3)
    inside = (samples.t >= begin) & (samples.t < end)
    factor = float(stage.rng.choice([0.5, 2.0]))
    values = np.where(inside[:, None], samples.xyz * factor, samples.xyz)
    return Altered(with_values(recording, "accel", values), begin, end)


def _torn_bytes(recording: MadeRecording, stage: Stage) -> Altered:
    """Take the high byte of a sample before and the low byte of this one, in 2 to 10 % of the samples.

    What happens where a part is read while it updates and its block data update is off (the BDU bit of ST's
    LIS3DH and its kin). The value is 256 counts off, and only where the high byte has just changed.
    """
    samples, step = samples_of(recording, "accel"), stage.phone.accel.lsb
    codes = np.round(samples.xyz / step).astype(np.int64)
    before = np.vstack([codes[:1], codes[:-1]])
    torn = stage.rng.random(codes.shape) < log_uniform(stage.rng, 0.02, 0.1)
    mixed = np.where(torn, before // 256 * 256 + codes % 256, codes)
    return Altered(with_values(recording, "accel", mixed * step), *whole(recording))


def _reversed_fifo(recording: MadeRecording, stage: Stage) -> Altered:
    """Reverse the order of samples in some of the batches of 8 to 32, under stamps that go on as ever.

    A driver that empties a FIFO as a stack. At rest nobody sees it; in a turn, time runs backwards.
    """
    samples = samples_of(recording, "accel")
    size = int(stage.rng.choice([8, 16, 32]))
    rows = np.arange(len(samples) // size * size).reshape(-1, size)
    chosen = stage.rng.random(len(rows)) < stage.rng.uniform(0.3, 1.0)
    order = np.where(chosen[:, None], rows[:, ::-1], rows).ravel()
    values = samples.xyz.copy()
    values[: order.size] = samples.xyz[order]
    return Altered(with_values(recording, "accel", values), *whole(recording))


def _axis_skew(stage: Stage) -> Array:
    """Return what each axis measures later than the one before it, by a fifth to two fifths of the period.

    One converter behind a multiplexer samples the axes in turn, as boards with analogue parts do; the stamp
    is that of the first.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - only recordings that are made need it

    t, late = stage.world.t, stage.rng.uniform(0.2, 0.4) / stage.phone.clock.rate_hz
    force = CubicSpline(t, stage.world.force)
    later = [force(np.minimum(t + i * late, t[-1]))[:, i] for i in range(3)]
    return np.asarray(np.column_stack(later) - stage.world.force)


def _dead_zone(recording: MadeRecording, stage: Stage) -> Altered:
    """Report no rate at all where it is smaller than one to two standard deviations of the noise.

    A dead band about the level at rest (IEEE Std 528): drivers gate the noise, so that a phone that lies
    still shows one value.
    """
    samples = samples_of(recording, "gyro")
    level = np.median(samples.xyz, axis=0)
    width = stage.sigma("gyro") * stage.rng.uniform(1.0, 2.0)
    values = np.where(np.abs(samples.xyz - level) < width, level, samples.xyz)
    return Altered(with_values(recording, "gyro", values), *whole(recording))


def with_stamps(recording: MadeRecording, t: Array) -> MadeRecording:
    """Return a recording with other stamps (n,) s of both sensors."""
    accel, gyro = samples_of(recording, "accel"), samples_of(recording, "gyro")
    return replace(
        recording, accelerometer=replace(accel, t=frozen(t)), gyroscope=replace(gyro, t=frozen(t.copy()))
    )


def _stamps_by_arrival(recording: MadeRecording, stage: Stage) -> Altered:
    """Spread the stamps of a batch evenly between its arrival and that of the batch before it.

    Batches of 10 to 25 samples arrive late by a tenth of their length, more or less, so that all of a batch
    come out too dense or too sparse together. A driver that stamps when it is scheduled, not when the part
    measures (Android's documentation of SensorEvent asks for the time of the measurement).
    """
    t = recording.accelerometer.t
    size = int(stage.rng.integers(10, 26))
    ends = np.append(np.arange(0, t.size - size, size), t.size - 1)
    length = size / stage.phone.clock.rate_hz
    late = np.minimum(stage.rng.uniform(0.05, 0.15) * stage.rng.exponential(1.0, ends.size), 0.6) * length
    stamps = np.interp(np.arange(t.size), ends, t[ends] + late)
    return Altered(with_stamps(recording, stamps), *whole(recording))


NOISE = ("noise_level", "noise_heavy_tailed")
"""Names of noise, which are true of whatever adds to it now and then."""

OFF_CATALOGUE: dict[str, HiddenKind] = {
    "acceleration_squared_drift": HiddenKind("gyro", _acceleration_squared, sized=True),
    "cross_coupling": HiddenKind("accel", _cross_coupling, sized=True),
    "alignment_temperature": HiddenKind("accel", _alignment_temperature, sized=True, thermometer=True),
    "thermal_snap": HiddenKind("accel", _thermal_snap, sized=True, thermometer=True),
    "popcorn_noise": HiddenKind("gyro", _popcorn, sized=True),
    "calibration_stairs": HiddenKind("gyro", _stairs, sized=True),
    "common_mode_noise": HiddenKind("accel", _common_noise, entailed=("noise_level",)),
    "range_register_reset": HiddenKind("accel", altered=_range_register_reset),
    "torn_bytes": HiddenKind("accel", altered=_torn_bytes, entailed=NOISE),
    "reversed_fifo": HiddenKind("accel", altered=_reversed_fifo),
    "axis_skew": HiddenKind("accel", _axis_skew, entailed=("accel_gyro_time_offset",)),
    "dead_zone": HiddenKind("gyro", altered=_dead_zone, entailed=(*NOISE, "held_samples")),
    "stamps_by_arrival": HiddenKind("timing", altered=_stamps_by_arrival, entailed=("timestamp_jitter",)),
}  # fmt: skip
"""Off-catalogue effects by name; only keys use these names."""
